"""The text form: it says what is there, answers are read or refused in words, and what is forbidden has a reason."""

import doctest
import re

import numpy as np
import pytest

from craftsim.discrete.kinds import Action
from craftsim.envs import parallel_env, text
from craftsim.envs.observations import Images
from craftsim.envs.planner import PlannerPolicy
from craftsim.envs.text import (
    TextConstruction,
    action_words,
    answer_text,
    converse,
    offered,
    read_answer,
)
from craftsim.errors import InputError
from craftsim.tasks import TASK_NAMES, make_task

AGENTS = ("car_0", "car_1")


def test_an_action_that_is_written_is_read_again():
    for action in Action:
        assert read_answer(answer_text({"car_0": action}), 2) == [action, Action.STOP]
        assert read_answer(f"1: {action.name}", 2) == [Action.STOP, action]


def test_an_answer_that_cannot_be_read_is_refused_and_nothing_happens():
    for answer, words in [
        ("", "names no action"),
        ("I would lift it", "is no 'car: action'"),
        ("car_0: lift it", "unknown action 'lift it'; did you mean 'lift'"),
        ("car_2: lift", "no car_2; the cars are car_0, car_1"),
        ("car_0: lift; car_0: drop", "car_0 is named twice"),
        ("car_0: lift" + " " * 100_000, "allowed: 100000"),
        (None, "not a NoneType"),
    ]:
        env = TextConstruction("strip", backend="grid")
        env.reset(seed=0)
        before = env.grid
        with pytest.raises(InputError, match=re.escape(words)):
            env.step(answer)
        assert env.grid.same_visible(before)
        assert "After tick 1 " in env.step("car_0: stop")[0]


@pytest.mark.parametrize("task", TASK_NAMES)
def test_the_legal_actions_that_are_listed_are_those_of_the_masks(task):
    env = TextConstruction(task, backend="grid")
    text, _ = env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(8):
        listed = text.split("Legal actions:\n")[1].splitlines()
        for car, line in enumerate(listed):
            name, _, actions = line.strip().partition(": ")
            words = [action.split(" (")[0] for action in actions.split("; ")]
            assert name == f"car_{car}"
            assert words == [action_words(a) for a in np.flatnonzero(env.core.masks[car])]
            assert set(words) <= set(offered())
        chosen = {
            name: int(rng.choice(np.flatnonzero(env.core.masks[i])))
            for i, name in enumerate(AGENTS)
        }
        text = env.step(answer_text(chosen))[0]
        assert env.observation_space.contains(text)


def test_the_text_form_plays_the_same_episode_as_the_parallel_form():
    env, twin = TextConstruction("strip", backend="grid"), parallel_env("strip", "grid")
    env.reset(seed=3)
    twin.reset(seed=3)
    rng = np.random.default_rng(0)
    while twin.agents:
        chosen = {agent: int(rng.integers(15)) for agent in AGENTS}
        _, reward, terminated, truncated, info = env.step(answer_text(chosen))
        _, rewards, ends, cuts, infos = twin.step(chosen)
        assert env.grid.same_visible(twin.grid)
        assert (reward, terminated, truncated) == tuple(
            one["car_0"] for one in (rewards, ends, cuts)
        )
        told = [feedback.result == "forbidden" for feedback in info["feedback"]]
        assert told == [infos[agent]["illegal"] for agent in AGENTS]
        assert all(feedback.done or feedback.why for feedback in info["feedback"])


def test_who_acts_second_is_refused_for_what_the_first_one_did():
    env = TextConstruction("strip", backend="grid")
    env.reset(seed=0)
    grid = env.grid
    grid.cars[:, :4] = [[0, 0, 1, 0], [2, 0, 1, 0]]
    grid.derive_marks()
    reasons = set()
    for seed in range(8):
        env.reset(seed=seed, options={"grid": grid})
        feedback = env.step("car_0: move right; car_1: move left")[4]["feedback"]
        assert sorted(one.result for one in feedback) == ["as predicted", "forbidden"]
        reasons |= {str(one) for one in feedback if not one.done}
    assert reasons == {
        "car_0: move right: forbidden: car 1 is in (1, 0, 1)",
        "car_1: move left: forbidden: car 0 is in (1, 0, 1)",
    }


def test_in_physics_the_refusal_is_in_the_same_words_and_a_skill_that_fails_says_what_happened():
    said = []
    for backend in ("grid", "physics"):
        env = TextConstruction("strip", backend=backend)
        env.reset(seed=0)
        said.append([str(one) for one in env.step("car_0: lift; car_1: unfold")[4]["feedback"]])
    assert said[0] == said[1]
    assert all(": forbidden: there is no" in line for line in said[0])
    physics = env.core.backend.judge.physics
    weak = physics.baseline.copy()
    weak.actuator_forcerange[physics.cars[0].wheel_actuators] = 0.0
    physics.set_baseline(weak)
    text, *_, info = env.step("car_0: move left; car_1: stop")
    first, second = info["feedback"]
    assert [(one.result, one.done) for one in (first, second)] == [
        ("failed", False),
        ("as predicted", True),
    ]
    assert f"  car_0: move left: failed: {first.why}\n  car_1: stop: done\n" in text
    assert first.why.startswith(("blocked", "slipped"))
    physics.data.qpos[physics.blocks[0].qpos] += 0.06  # what no skill would do
    text, reward, terminated, truncated, info = env.step("car_0: move left")
    assert (reward, terminated, truncated) == (0.0, False, True)
    assert f"The world cannot be read any more: {'; '.join(info['problems'])}." in text
    assert "The episode is over; the goal is not reached." in text


@pytest.mark.parametrize("task", ["strip", "simple_two_story", "breaking_barrier"])
def test_a_planner_that_speaks_builds(task):
    env = TextConstruction(task, backend="grid")
    policy = PlannerPolicy(env, rounds=8)
    texts = []

    def answer(instructions, text):
        assert instructions == env.instructions
        texts.append(text)
        return answer_text(policy(dict.fromkeys(AGENTS)))

    talk = converse(env, answer, seed=0)
    assert talk.success
    assert (talk.unreadable, talk.forbidden, talk.failed) == (0, 0, 0)
    assert [turn.text for turn in talk.turns] == texts
    assert all(text.count("Legal actions:") == 1 for text in texts)


def test_an_answer_that_cannot_be_read_costs_the_tick_and_is_told():
    env = TextConstruction("strip", backend="grid")
    answers = iter(["car_0: jump", "car_0: lift; car_1: stop"])
    talk = converse(env, lambda instructions, text: next(answers, "car_0: stop"), seed=0)
    first, second, *rest = talk.turns
    assert "unknown action 'jump'" in first.unreadable
    assert second.text.startswith(
        f"Your answer could not be read, and all cars stopped: {first.unreadable}\nWhat happened:\n"
    )
    assert len(rest) == 18
    assert (talk.unreadable, talk.forbidden, talk.failed, talk.success) == (1, 1, 0, False)


def test_the_instructions_name_every_cell_of_the_design():
    task = make_task("complex_two_story")
    told = TextConstruction(task, backend="grid").instructions
    for target in task.design.targets:
        assert f" at {target.cell}" in told
    assert "the flag is at (" in TextConstruction("breaking_barrier", backend="grid").instructions
    assert "one platform" in TextConstruction("free_building", backend="grid").instructions


@pytest.mark.parametrize(
    "option", [{"images": Images()}, {"helper_depth": 8}, {"execution": "asynchronous"}], ids=str
)
def test_an_option_that_texts_have_no_place_for_is_refused(option):
    with pytest.raises(
        InputError, match=f"the text form knows no '{next(iter(option))}'; leave it out"
    ):
        TextConstruction("strip", **option)


def test_the_examples_in_docstrings_hold():
    assert doctest.testmod(text).failed == 0
