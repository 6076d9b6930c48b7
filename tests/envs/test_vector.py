"""Batches of grid worlds: the same episodes as one by one, resets in the same step, starts from a file."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from craftsim.discrete.kinds import Action
from craftsim.discrete.tasks import TASK_NAMES, make_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.starts import load_starts, save_starts
from craftsim.envs import GYMNASIUM_IDS, parallel_env
from craftsim.envs.datasets import reached_worlds
from craftsim.envs.vector import GridVectorEnv
from craftsim.errors import InputError
from craftsim.testing import random_policy

STOP = int(Action.STOP)


def _pick(rng, mask):
    return (rng.random(mask.shape) * mask).argmax(-1)


@pytest.mark.parametrize("task", TASK_NAMES)
def test_gymnasium_makes_batches_that_keep_to_their_spaces(task):
    envs = gymnasium.make_vec(GYMNASIUM_IDS[task], num_envs=7, vectorization_mode="vector_entry_point")
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    observations, _ = envs.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(25):
        assert envs.observation_space.contains(observations)
        actions = _pick(rng, observations["action_mask"])
        assert envs.action_space.contains(actions)
        observations, *_ = envs.step(actions)


@pytest.mark.parametrize("helper_depth", [None, 10])
def test_a_batch_is_the_episodes_of_its_task_and_tells_the_last_observation_before_a_reset(helper_depth):
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
            np.testing.assert_array_equal(last["observation"], episodes.entity_rows()[steps.done][0].ravel())
            n_ended += int(steps.done.sum())
            episodes.reset(steps.done.nonzero()[0])
    assert n_ended >= 100


def test_equal_seeds_give_equal_batches_and_the_generator_goes_on_without_one():
    def play(envs, seed):
        observations, _ = envs.reset(seed=seed)
        picks = np.random.default_rng(0)
        seen = []
        for _ in range(30):
            observations, reward, *_ = envs.step(_pick(picks, observations["action_mask"]))
            seen.append((observations["observation"].copy(), reward))
        return seen

    one, two = GridVectorEnv("free_building", 20), GridVectorEnv("free_building", 20)
    first = play(one, 1)
    for (a, ra), (b, rb) in zip(first, play(two, 1), strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(ra, rb)
    again = play(one, None)
    assert any((a[0] != b[0]).any() for a, b in zip(first, again, strict=True))


def test_what_is_forbidden_is_flagged_and_changes_nothing():
    envs = GridVectorEnv("strip", 3)
    before, _ = envs.reset(seed=0)
    after, _, _, _, infos = envs.step(np.full((3, 2), int(Action.DROP)))
    np.testing.assert_array_equal(infos["illegal"], np.ones((3, 2), bool))
    np.testing.assert_array_equal(before["observation"], after["observation"])


def test_worlds_that_were_reached_are_kept_in_a_file_and_are_the_starts_of_training(tmp_path):
    env = parallel_env("strip", "grid")
    worlds = reached_worlds(env, random_policy(np.random.default_rng(0)), 60, seed=0)
    assert len(worlds) > 20
    save_starts(tmp_path / "starts.npz", worlds)
    loaded = load_starts(tmp_path / "starts.npz")
    assert all(a.same_visible(b) and a.same_marks(b) for a, b in zip(worlds, loaded, strict=True))
    task = make_task("strip").starting_from(loaded)
    envs = GridVectorEnv(task, 200)
    envs.reset(seed=0)
    starts = {world.cars.tobytes() + world.kind.tobytes() for world in worlds}
    drawn = {envs.episodes.grid(i).cars.tobytes() + envs.episodes.grid(i).kind.tobytes() for i in range(200)}
    assert drawn <= starts
    assert len(drawn) > len(starts) / 2
    env.reset(options={"grid": loaded[-1]})
    assert env.grid.same_visible(worlds[-1])


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
