"""What has several forms says the same in all: in ticks and asynchronous, grid and physics, one world and many."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import craftsim
from craftsim.checking.setup import RANDOMIZE
from craftsim.discrete.kinds import Action
from craftsim.envs.central import CentralConstruction
from craftsim.skills.outcome import Reason
from craftsim.skills.skill import Command, Skill
from craftsim.tasks import make_task
from craftsim.tasks.asynchronous import AsynchronousEpisodes, Timing
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.rewards import Reward, failures

STOP = int(Action.STOP)
RIGHT = int(Action.MOVE_RIGHT)
LEFT = int(Action.MOVE_LEFT)
LIFT = int(Action.LIFT)


class Refuses(Skill):
    """Fail after 0.2 s."""

    def step(self, now):
        if self.elapsed_s > 0.2:
            self.fail(Reason.BLOCKED, "enough")
        return Command()


def careful(tick):
    """Return minus the time, and minus 5 for each action that did not go as predicted."""
    return -tick.duration_s - 5.0 * failures(tick)


class Watch:
    """A term that keeps the transitions."""

    def __init__(self):
        self.transitions = []

    def __call__(self, tick):
        self.transitions.append(tick)
        return careful(tick)


def _task(reward, **changes):
    return replace(make_task("strip"), name="own_strip", reward=Reward({reward: 1.0}), **changes)


@pytest.mark.parametrize("execution", ["synchronous", "asynchronous"])
@pytest.mark.parametrize("form", ["parallel", "central"])
def test_a_reward_sees_that_actions_failed_however_they_are_executed(execution, form):
    watch = Watch()
    options = {
        "execution": execution,
        "skills": {Action.MOVE_RIGHT: Refuses},
        "check_contacts": True,
    }
    if form == "parallel":
        env = craftsim.parallel_env(_task(watch), "physics", **options)
        env.reset(seed=0)
        actions = {"car_0": RIGHT, "car_1": RIGHT}
    else:
        env = CentralConstruction(_task(watch), **options)
        env.reset(seed=0)
        actions = np.array([RIGHT, RIGHT])
    with closing(env):
        _, reward, *_ = env.step(actions)
    (tick,) = watch.transitions
    assert tick.verdicts.tolist() == [["failed", "failed"]]
    assert [attempt.action for attempt in tick.attempts[0]] == ["MOVE_RIGHT", "MOVE_RIGHT"]
    assert tick.actions.tolist() == [[Action.MOVE_RIGHT, Action.MOVE_RIGHT]]
    assert tick.applied.tolist() == [[True, True]]
    assert tick.durations_s[0].tolist() == [attempt.duration_s for attempt in tick.attempts[0]]
    touched = {name for contact in tick.contacts[0] for name in (contact.first, contact.second)}
    assert {"car 0", "car 1", "ground"} <= touched
    earned = reward["car_0"] if form == "parallel" else reward
    assert earned == pytest.approx(-tick.duration_s - 10.0)


def test_a_reward_sees_forbidden_actions_and_one_car_s_end_at_a_time():
    watch = Watch()
    env = craftsim.parallel_env(
        _task(watch), "physics", execution="asynchronous", check_contacts=True
    )
    with closing(env):
        env.reset(seed=0)
        _, _, _, _, infos = env.step({"car_0": LIFT, "car_1": STOP})
        forbidden = watch.transitions[-1]
        assert forbidden.actions.tolist() == [[Action.LIFT, Action.STOP]]
        assert forbidden.applied.tolist() == [[False, True]]
        assert forbidden.verdicts.tolist() == [["failed", None]]
        assert infos["car_0"]["outcome"] == "not performed"
        assert infos["car_0"]["reason"].startswith("the rules forbid it: there is nothing to lift")
        assert "result" not in infos["car_1"]
        # The second car is there first.
        env.step({"car_0": RIGHT, "car_1": LEFT})
        first = watch.transitions[-1]
        env.step({"car_0": STOP, "car_1": STOP})
        second = watch.transitions[-1]
    cars = [attempt is not None for attempt in first.attempts[0]]
    assert sorted(cars) == [False, True]
    ended = cars.index(True)
    assert first.verdicts[0, ended] == "as predicted"
    assert first.actions[0, 1 - ended] == Action.STOP
    names = {name for contact in first.contacts[0] for name in (contact.first, contact.second)}
    assert names == {f"car {ended}", "ground"}
    assert second.verdicts[0, 1 - ended] == "as predicted"
    assert second.verdicts[0, ended] is None


@pytest.mark.parametrize("helper_depth", [None, 10])
def test_a_reward_sees_the_same_in_ticks_and_in_events_of_equal_durations(helper_depth):
    in_ticks = Watch()
    in_events = Watch()
    n_worlds = 40
    rng = np.random.default_rng(0)
    task = make_task("simple_two_story")
    starts = task.draw_starts(rng, n_worlds)
    arguments = rng, n_worlds, "physical", helper_depth, starts
    ticks = Episodes(replace(task, reward=Reward({in_ticks: 1.0})), *arguments)
    events = AsynchronousEpisodes(
        replace(task, reward=Reward({in_events: 1.0})), *arguments, timing=Timing(equal=True)
    )
    same = np.ones(n_worlds, np.bool_)
    compared = 0
    forbidden = 0
    for _ in range(12):
        actions = rng.integers(0, len(Action), (n_worlds, 2))
        order = ticks.draw_order()
        event = events.step(actions, order)
        ticks.step(actions, order)
        for world in range(n_worlds):
            # In ticks an action that a claim blocks is carried out.
            if (event.outcome[world] == craftsim.tasks.asynchronous.BLOCKED).any():
                same[world] = False
            if not same[world]:
                continue
            tick = in_ticks.transitions[-1]
            at_once = in_events.transitions[-1]
            for name in ("actions", "applied", "t", "designs", "verdicts"):
                assert np.array_equal(getattr(at_once, name)[world], getattr(tick, name)[world])
            assert at_once.before[world].same_visible(tick.before[world])
            assert at_once.after[world].same_visible(tick.after[world])
            compared += 1
            forbidden += not tick.applied[world].all()
    assert compared > 200
    assert forbidden > 50


def _plain(value, key=""):
    """Return an info of a world as nested lists; a batch says of a deadlock whether there is one."""
    if key == "deadlock":
        return value is not None
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, tuple | list):
        return [_plain(part) for part in value]
    return value


@pytest.mark.parametrize("execution", ["synchronous", "asynchronous"])
def test_a_batch_in_physics_is_its_worlds_one_by_one_though_their_cars_end_at_different_times(
    execution,
):
    task = _task(careful, max_steps=1)
    options = {"execution": execution, "randomization": RANDOMIZE["mild"]}
    # In each step one world's cars move, and the other's wait.
    moves = [[[STOP, STOP], [RIGHT, LEFT]], [[RIGHT, LIFT], [STOP, STOP]]]
    steps = np.array([*moves, *[[[STOP, STOP]] * 2] * 4])
    with closing(craftsim.vector_env(task, 2, "physics", workers=1, **options)) as envs:
        envs.reset(seed=3)
        batch = [envs.step(actions) for actions in steps]
    for world in range(2):
        with closing(CentralConstruction(task, **options)) as env:
            env.reset(seed=3 + world)
            for actions, (_, rewards, terminated, truncated, infos) in zip(
                steps, batch, strict=True
            ):
                _, reward, *ends, info = env.step(actions[world])
                assert reward == rewards[world]
                assert ends == [terminated[world], truncated[world]]
                if any(ends):
                    infos = infos["final_info"]
                    env.reset()
                if not any(ends):
                    del info["action_mask"]  # the observation has it
                for key, value in info.items():
                    assert _plain(infos[key][world]) == _plain(value, key), key


@pytest.mark.parametrize("execution", ["synchronous", "asynchronous"])
@pytest.mark.parametrize("backend", ["grid", "physics"])
def test_ended_episodes_are_reported_as_by_gymnasium_s_own_batches(backend, execution):
    task = make_task("strip", max_steps=0)
    options = {"backend": backend, "execution": execution}
    workers = {"workers": 1} if backend == "physics" else {}
    steps = [np.full((3, 2), STOP)] * 5
    makers = [lambda: CentralConstruction(task, **options)] * 3
    theirs = SyncVectorEnv(makers, autoreset_mode=AutoresetMode.SAME_STEP)
    ended = 0
    with closing(theirs), closing(craftsim.vector_env(task, 3, **options, **workers)) as ours:
        _, expected = theirs.reset(seed=0)
        _, infos = ours.reset(seed=0)
        if execution == "asynchronous":
            assert infos["decides"].tolist() == [list(decides) for decides in expected["decides"]]
        for actions in steps:
            *_, truncated, expected = theirs.step(actions)
            *_, truncated_here, infos = ours.step(actions)
            np.testing.assert_array_equal(truncated_here, truncated)
            assert ("final_info" in infos) == ("final_info" in expected) == bool(truncated.any())
            if not truncated.any():
                continue
            ended += 1
            for key in ("_final_obs", "_final_info"):
                np.testing.assert_array_equal(infos[key], expected[key])
            for world in range(3):
                for key, value in expected["final_obs"][world].items():
                    np.testing.assert_array_equal(infos["final_obs"][world][key], value)
            last = infos["final_info"]
            # A grid is always readable, and a batch of grids does not say so.
            assert expected["final_info"].keys() - last.keys() <= {"problems", "_problems"}
            for key, column in last.items():
                values = expected["final_info"][key]
                for world in range(3):
                    assert _plain(column[world]) == _plain(values[world], key), key
    assert ended == 2


def test_infos_of_worlds_that_go_on_are_left_out_of_those_that_have_ended():
    envs = craftsim.vector_env(
        make_task("strip", max_steps=3), 2, execution="asynchronous", jitter=0.5
    )
    envs.reset(seed=0)
    for _ in range(60):
        *_, truncated, infos = envs.step(np.array([[STOP, STOP], [RIGHT, LEFT]]))
        if truncated.any():
            np.testing.assert_array_equal(infos["_final_info"], truncated)
            last = infos["final_info"]
            assert not last["action_mask"][~truncated].any()
            assert last["action_mask"][truncated].any(-1).all()
            np.testing.assert_array_equal(
                last["duration_s"][truncated], infos["duration_s"][truncated]
            )
            assert not last["duration_s"][~truncated].any()
