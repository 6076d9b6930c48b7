"""The environments on the grid, single and in batches: interfaces, seeds, masks, rewards and ends."""

from contextlib import closing

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from tasks.platforms import platform

from craftsim.discrete.files.shipped import shipped_blueprint
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.envs import TASK_IDS, parallel_env, vector_env
from craftsim.envs import env as turns_env
from craftsim.envs.planner import PlanPolicy
from craftsim.envs.vector import GridVectorEnv
from craftsim.errors import InputError
from craftsim.planning.plan_file import read_plan
from craftsim.tasks import TASK_NAMES, as_task, make_task
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.registry import VARIED_NAMES
from craftsim.tasks.starts import load_starts, save_starts
from craftsim.testing import check_api, check_deterministic, check_masks, random_policy

STOP = int(Action.STOP)


@pytest.mark.parametrize("task", [*TASK_NAMES, 1, 3, 8])
def test_tasks_with_any_number_of_cars_pass_the_tests_of_interface_determinism_and_masks(task):
    task = platform(task) if isinstance(task, int) else task
    for helper_depth in (
        (None, 10) if task in ("complex_two_story", "breaking_barrier") else (None,)
    ):

        def make(helper_depth=helper_depth):
            return parallel_env(task, "grid", helper_depth=helper_depth)

        check_api(make, cycles=30)
        check_deterministic(make, episodes=2)
    check_masks(parallel_env(task, "grid"), states=5)


@pytest.mark.parametrize("task", [*TASK_NAMES, "random_strip", "designs"])
def test_gymnasium_makes_the_central_form_and_batches_that_keep_to_their_spaces(task):
    check_env(gymnasium.make(TASK_IDS[task], backend="grid").unwrapped)
    envs = gymnasium.make_vec(TASK_IDS[task], num_envs=7, vectorization_mode="vector_entry_point")
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observations, _ = envs.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(25):
        assert envs.observation_space.contains(observations)
        actions = _pick(rng, observations["action_mask"])
        assert envs.action_space.contains(actions)
        observations, *_ = envs.step(actions)


@pytest.mark.parametrize("task", [*TASK_NAMES, *VARIED_NAMES])
def test_pettingzoo_makes_every_task_in_both_of_its_forms(task):
    task_id = TASK_IDS[task]
    cars = pettingzoo.make("parallel", task_id, backend="grid").possible_agents
    turns = pettingzoo.make("aec", task_id, backend="grid")
    turns.reset(seed=0)
    assert (turns.possible_agents, turns.agent_selection) == (cars, "car_0")
    assert pettingzoo.spec("aec", task_id.removesuffix("-v0")).id == task_id


def test_an_environment_of_pettingzoos_registry_is_the_one_of_the_constructor():
    made = pettingzoo.make("parallel", "craftsim/Strip-v0", backend="grid", n_blocks=5)
    constructed = parallel_env("strip", "grid", n_blocks=5)
    states = []
    for env in (made, constructed):
        env.reset(seed=5)
        states.append(env.state())
    assert np.array_equal(*states)


@pytest.mark.parametrize("task", TASK_NAMES)
def test_a_finished_building_terminates_and_does_not_truncate(task):
    env = parallel_env(make_task(task, max_steps=500), "grid")
    act = PlanPolicy(env, read_plan(task, env.core.n_cars))
    observations, _ = env.reset(seed=0)
    while env.agents:
        observations, _, terminated, truncated, infos = env.step(act(observations))
    assert (set(terminated.values()), set(truncated.values())) == ({True}, {False})
    assert infos["car_0"]["success"]


def test_an_episode_that_takes_too_long_truncates_and_does_not_terminate():
    env = parallel_env("strip", "grid")
    env.reset(seed=0)
    for tick in range(20):
        _, _, terminated, truncated, _ = env.step(dict.fromkeys(env.agents, STOP))
        assert set(terminated.values()) == {False}
        assert set(truncated.values()) == {tick == 19}


def test_rewards_observations_and_masks_are_those_of_an_episode_of_the_task():
    env, task = parallel_env("simple_two_story", "grid"), make_task("simple_two_story")
    episode, act = Episodes(task, np.random.default_rng(0)), random_policy(np.random.default_rng(0))
    observations, _ = env.reset(seed=5)
    running = True
    while running:
        np.testing.assert_array_equal(
            [o["observation"] for o in observations.values()], episode.vectors()[0]
        )
        np.testing.assert_array_equal(
            [o["action_mask"] for o in observations.values()], episode.legal()[0]
        )
        actions = [*act(observations).values()]
        reward, terminated, truncated, _ = env.core.step(actions)
        step = episode.step([actions], env.core.order[None])
        assert episode.grid(0).same_visible(env.grid)
        assert (reward, terminated | truncated) == (step.reward[0], step.done[0])
        observations, running = env.observe_all(), not step.done[0]


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
    actions = {"car_0": int(Action.MOVE_LEFT), "car_1": int(Action.DROP)}
    _, free, _, _, infos = plain.step(actions)
    assert [info["illegal"] for info in infos.values()] == [False, True]
    _, paid, _, _, _ = weighted.step(actions)
    assert 0.5 < infos["car_1"]["duration_s"] < 2.0
    assert paid["car_0"] == pytest.approx(free["car_0"] - 2.0 * infos["car_0"]["duration_s"])


def _pick(rng, mask):
    return (rng.random(mask.shape) * mask).argmax(-1)


@pytest.mark.parametrize("helper_depth", [None, 10])
def test_a_batch_is_the_episodes_of_its_task_and_tells_the_last_observation_before_a_reset(
    helper_depth,
):
    envs = GridVectorEnv("simple_two_story", 50, helper_depth=helper_depth, time_weight=0.5)
    observations, _ = envs.reset(seed=3)
    rng = np.random.default_rng(3)
    episodes = Episodes(make_task("simple_two_story"), rng, 50, helper_depth=helper_depth)
    picks = np.random.default_rng(0)
    n_ended = 0
    for _ in range(45):
        mask = episodes.legal() if helper_depth is None else episodes.reachable()
        mask[..., STOP] |= ~mask.any(-1)
        np.testing.assert_array_equal(observations["action_mask"], mask)
        np.testing.assert_array_equal(envs.car_vectors(), episodes.vectors())
        actions = _pick(picks, mask)
        observations, reward, terminated, truncated, infos = envs.step(actions)
        steps = episodes.step(actions)
        np.testing.assert_allclose(reward, steps.reward - 0.5 * infos["duration_s"])
        np.testing.assert_array_equal(terminated | truncated, steps.done)
        np.testing.assert_array_equal(terminated, steps.success)
        if steps.done.any():
            np.testing.assert_array_equal(infos["_final_obs"], steps.done)
            last = infos["final_obs"][steps.done][0]
            np.testing.assert_array_equal(
                last["observation"], episodes.entity_rows()[steps.done][0].ravel()
            )
            n_ended += int(steps.done.sum())
            episodes.reset(steps.done.nonzero()[0])
    assert n_ended >= 100


def test_worlds_that_were_reached_are_kept_in_a_file_and_are_the_starts_of_training(tmp_path):
    env, act, worlds = parallel_env("strip", "grid"), random_policy(np.random.default_rng(0)), []
    observations, _ = env.reset(seed=0)
    while env.agents:
        worlds.append(env.grid)
        observations = env.step(act(observations))[0]
    save_starts(tmp_path / "starts.npz", worlds)
    loaded = load_starts(tmp_path / "starts.npz")
    assert all(a.same_visible(b) and a.same_marks(b) for a, b in zip(worlds, loaded, strict=True))
    envs = GridVectorEnv(make_task("strip").starting_from(loaded), 200)
    envs.reset(seed=0)
    starts, drawn = (
        {grid.cars.tobytes() + grid.kind.tobytes() for grid in grids}
        for grids in (worlds, [envs.episodes.grid(i) for i in range(200)])
    )
    assert drawn <= starts
    assert len(drawn) > len(starts) / 2


def test_files_that_hold_no_starts_and_starts_that_do_not_fit_are_refused(tmp_path):
    path = tmp_path / "starts.npz"
    with pytest.raises(InputError, match="no such file"):
        load_starts(path)
    for text in ("no archive", ""):
        path.write_text(text)
        with pytest.raises(InputError, match="not an archive of arrays"):
            load_starts(path)
    np.savez(path, kind=np.zeros(3))
    with pytest.raises(InputError, match="save_starts"):
        load_starts(path)
    strip, complex_ = (
        make_task(name).draw(np.random.default_rng(0)) for name in ("strip", "complex_two_story")
    )
    with pytest.raises(InputError, match="one size"):
        save_starts(path, [strip, complex_])
    with pytest.raises(InputError, match="4 cars"):
        make_task("strip").starting_from([complex_])
    with pytest.raises(InputError, match="at least one"):
        make_task("strip").starting_from([])


@pytest.mark.parametrize("task", ["random_strip@test", "designs@test"])
def test_one_episode_starts_as_another_and_the_same_seed_as_before(task):
    one, other = parallel_env(task, "grid"), parallel_env(task, "grid")
    starts = [one.reset(seed=seed)[0]["car_0"]["observation"] for seed in (0, 1, 0)]
    assert np.array_equal(starts[0], starts[2])
    assert not np.array_equal(starts[0], starts[1])
    assert np.array_equal(other.reset(seed=0)[0]["car_0"]["observation"], starts[0])
    turns = turns_env(task, "grid")
    turns.reset(seed=0)
    assert np.array_equal(turns.observe("car_0")["observation"], starts[0])


def test_a_batch_of_worlds_varies_and_goes_on_with_other_starts():
    envs = vector_env("designs", 6)
    first = envs.reset(seed=0)[0]["observation"]
    assert len({row.tobytes() for row in first}) == 6
    designs = envs.episodes.designs.copy()
    for _ in range(envs.task.max_steps + 2):
        envs.step(np.full((6, 2), 14))
    assert not np.array_equal(envs.episodes.designs, designs)


def test_an_episode_shows_its_own_design_and_a_given_start_needs_one():
    made = parallel_env("designs", "grid")
    made.reset(seed=0)
    first, played = made.core.episodes.designs.copy(), made.core.played
    assert first.shape == (1, 8, 5)
    grid, design = made.core.grid, played.design
    made.reset(seed=1)
    assert not np.array_equal(first, made.core.episodes.designs)
    made.reset(options={"grid": grid, "design": design})
    assert np.array_equal(first, made.core.episodes.designs)
    with pytest.raises(InputError, match="give the option 'design'"):
        made.reset(options={"grid": grid})
    with pytest.raises(InputError, match="has its own goal"):
        parallel_env("strip", "grid").reset(
            options={"grid": as_task("strip").draw(np.random.default_rng(0)), "design": design}
        )


def test_physics_starts_as_the_grid_does_and_marks_the_design_of_the_episode():
    with closing(parallel_env("designs", "physics")) as real:
        grid = parallel_env("designs", "grid")
        for seed in (0, 1):
            real.reset(seed=seed)
            grid.reset(seed=seed)
            assert real.core.grid.same_visible(grid.core.grid)
            assert real.core.backend.recipe.goals == tuple(real.core.played.goal_cells)
        *_, infos = real.step(dict.fromkeys(real.agents, 14))
        assert not any(info["problems"] for info in infos.values())
