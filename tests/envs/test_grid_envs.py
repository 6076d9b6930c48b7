"""The environments on the grid: the interfaces, equal episodes from equal seeds, sound masks, rewards and ends."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from platforms import platform

from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.files.shipped import shipped_blueprint, shipped_plan
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.tasks import TASK_NAMES, make_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.envs import GYMNASIUM_IDS, parallel_env
from craftsim.errors import InputError
from craftsim.testing import check_api, check_deterministic, check_masks, random_policy

STOP = int(Action.STOP)


@pytest.mark.parametrize("helper_depth", [None, 10])
@pytest.mark.parametrize("task", TASK_NAMES)
def test_the_tasks_pass_the_tests_of_interface_and_determinism(task, helper_depth):
    def make():
        return parallel_env(task, "grid", helper_depth=helper_depth)

    check_api(make)
    check_deterministic(make, episodes=3)


def test_masks_are_sound_on_all_tasks():
    for task in TASK_NAMES:
        check_masks(parallel_env(task, "grid"), states=5)


@pytest.mark.parametrize("cars", [1, 3, 8])
def test_any_number_of_cars_passes_all_tests(cars):
    def make():
        return parallel_env(platform(cars), "grid")

    check_api(make)
    check_deterministic(make, episodes=3)
    check_masks(make(), states=10)


def test_gymnasium_makes_and_accepts_the_central_form():
    for task in TASK_NAMES:
        check_env(gymnasium.make(GYMNASIUM_IDS[task], backend="grid").unwrapped)


def _play_plan(env, task, seed=0):
    """Play the shipped plan in acting order, one action a tick, and return the last step."""
    env.reset(seed=seed)
    result = None
    for joint in read_plan(shipped_plan(task), len(env.possible_agents)).ticks:
        for car, action in joint:
            result = env.step(dict.fromkeys(env.agents, STOP) | {f"car_{car}": int(action)})
            if not env.agents:
                return result
    return result


def test_a_finished_building_terminates_and_does_not_truncate():
    for task in TASK_NAMES:
        env = parallel_env(make_task(task, max_steps=500), "grid")
        _, _, terminated, truncated, infos = _play_plan(env, task)
        assert set(terminated.values()) == {True}
        assert set(truncated.values()) == {False}
        assert infos["car_0"]["success"]
        assert env.agents == []
        with pytest.raises(InputError, match=r"reset\(\)"):
            env.step({})


def test_an_episode_that_takes_too_long_truncates_and_does_not_terminate():
    env = parallel_env("strip", "grid")
    env.reset(seed=0)
    for tick in range(20):
        _, _, terminated, truncated, _ = env.step(dict.fromkeys(env.agents, STOP))
        assert set(terminated.values()) == {False}
        assert set(truncated.values()) == {tick == 19}


def test_rewards_observations_and_masks_are_those_of_an_episode_of_the_task():
    env = parallel_env("simple_two_story", "grid")
    episode = Episodes(make_task("simple_two_story"), np.random.default_rng(0))
    act = random_policy(np.random.default_rng(0))
    observations, _ = env.reset(seed=5)
    while env.agents:
        np.testing.assert_array_equal([o["observation"] for o in observations.values()], episode.vectors()[0])
        np.testing.assert_array_equal([o["action_mask"] for o in observations.values()], episode.legal()[0])
        actions = act(observations)
        before = env.grid
        agents = list(env.agents)
        observations, rewards, *_ = env.step(actions)
        told = [actions[agent] for agent in agents]
        # The order of the cars is drawn; find the one that explains what happened.
        for order in ((0, 1), (1, 0)):
            assert episode.grid(0).same_visible(before)
            tried = Episodes(make_task("simple_two_story"), np.random.default_rng(0))
            tried.put(0, before)
            tried.potential, tried.t = episode.potential, episode.t
            step = tried.step([told], [order])
            if tried.grid(0).same_visible(env.grid):
                break
        assert tried.grid(0).same_visible(env.grid)
        assert set(rewards.values()) == {step.reward[0]}
        episode = tried


def test_an_illegal_action_counts_as_stop_and_is_flagged():
    env = parallel_env("strip", "grid")
    env.reset(seed=0)
    before = env.grid
    _, _, _, _, infos = env.step({"car_0": int(Action.DROP), "car_1": STOP})
    assert env.grid.same_visible(before)
    assert [infos[agent]["illegal"] for agent in ("car_0", "car_1")] == [True, False]


def _stuck_on_a_ramp():
    """Return a world of the simple two-story task whose car 0 stands on the foot of a ramp with both ways blocked."""
    grid = make_task("simple_two_story").draw(np.random.default_rng(0))
    grid.kind[:, :, 1:] = Kind.AIR
    grid.yaw[:] = 0
    for cell, kind in (((2, 2, 1), Kind.BODY), ((2, 1, 1), Kind.FOOT)):
        grid.kind[cell], grid.yaw[cell] = kind, 3
    grid.kind[2, 0, 1] = grid.kind[2, 3, 1] = Kind.BLOCK
    grid.cars[0, : CarField.YAW + 1] = 2, 1, 1, 1
    grid.cars[0, CarField.SLOPE] = 1
    grid.cars[1, : CarField.YAW + 1] = 2, 2, 2, 1
    grid.cars[1, CarField.SLOPE] = 2
    grid.derive_marks()
    return grid


def test_a_car_without_any_legal_action_is_offered_stop_which_does_nothing():
    env = parallel_env("simple_two_story", "grid")
    observations, infos = env.reset(seed=0, options={"grid": _stuck_on_a_ramp()})
    assert not env.core.rules.mask(env.grid)[0].any(), "the car is meant to be stuck"
    mask = observations["car_0"]["action_mask"]
    np.testing.assert_array_equal(np.flatnonzero(mask), [Action.STOP])
    np.testing.assert_array_equal(infos["car_0"]["action_mask"], mask)
    before = env.grid
    infos = env.step({"car_0": STOP, "car_1": STOP})[4]
    assert not infos["car_0"]["illegal"]
    assert env.grid.same_visible(before)


def test_a_start_may_be_given_as_a_grid_or_as_a_blueprint(tmp_path):
    env = parallel_env("strip", "grid")
    grid = make_task("strip").draw(np.random.default_rng(0))
    grid.cars[0, [CarField.X, CarField.Y]] = 3, 0
    grid.derive_marks()
    env.reset(options={"grid": grid})
    assert env.grid.same_visible(grid)
    text = shipped_blueprint("strip").read_text(encoding="utf-8")
    path = tmp_path / "own.yaml"
    path.write_text(text.replace("yaw: 0", "yaw: 2"), encoding="utf-8")
    env.reset(options={"blueprint": path})
    assert set(env.grid.cars[:, CarField.YAW]) == {2}
    env.reset()
    assert set(env.grid.cars[:, CarField.YAW]) == {0}, "an option holds for one episode"


def test_time_costs_what_its_weight_says_and_the_slowest_car_counts():
    plain, weighted = (parallel_env("strip", "grid", time_weight=w) for w in (0.0, 2.0))
    for env in (plain, weighted):
        env.reset(seed=0)
    actions = {"car_0": int(Action.MOVE_LEFT), "car_1": STOP}
    _, free, _, _, infos = plain.step(actions)
    _, paid, _, _, _ = weighted.step(actions)
    assert 0.5 < infos["car_1"]["duration_s"] < 2.0
    assert paid["car_0"] == pytest.approx(free["car_0"] - 2.0 * infos["car_0"]["duration_s"])


def test_pictures_and_text_show_the_world(capsys):
    env = parallel_env("strip", "grid", render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape[2] == 3
    env = parallel_env("strip", "grid", render_mode="ansi")
    env.reset(seed=0)
    assert "level 1" in env.render()
    assert capsys.readouterr().out == ""
    env = parallel_env("strip", "grid", render_mode="human")
    env.reset(seed=0)
    assert env.render() is None
    assert "level 1" in capsys.readouterr().out
