"""Batches in physics: the same worlds as one by one at any number of workers, at their own pace, and sure to end."""

import math
import os
import signal
import subprocess
import sys
import time
from contextlib import closing

import gymnasium
import numpy as np
import pytest

from craftsim.checking.setup import RANDOMIZE
from craftsim.discrete.kinds import Action
from craftsim.envs import TASK_IDS, vector_env
from craftsim.envs.central import CentralConstruction
from craftsim.envs.physics_vector import PhysicsVectorEnv
from craftsim.envs.vector import GridVectorEnv
from craftsim.errors import CraftsimError, InputError
from craftsim.models.randomization import DomainRandomization
from craftsim.tasks import make_task

NOISY = RANDOMIZE["strong"].sensors

SHORT = make_task("strip", max_steps=0)
"""Two ticks an episode."""
IMPERFECT = {"noise": NOISY, "randomization": DomainRandomization()}
TICKS = 3


def _picks(seed):
    """Return actions of three worlds, those of a world the same whatever becomes of the others."""
    return np.random.default_rng(seed).integers(0, 15, (TICKS, 3, 2))


def _one_by_one():
    """Return what three single environments come to, by world and tick, resets included."""
    episodes = []
    for world in range(3):
        env, ticks = CentralConstruction(SHORT, **IMPERFECT), []
        env.reset(seed=7 + world)
        for actions in _picks(0)[:, world]:
            seen, reward, terminated, truncated, info = env.step(actions)
            last, done = seen, terminated or truncated
            if done:
                seen = env.reset()[0]
            ticks.append((seen, reward, terminated, truncated, info, last if done else None))
        episodes.append(ticks)
    return episodes


def _check(batch, row, expected):
    seen, rewards, terminated, truncated, infos = batch
    now, reward, ended, over, info, last = expected
    for key, value in now.items():
        np.testing.assert_array_equal(seen[key][row], value)
    assert (rewards[row], terminated[row], truncated[row]) == (reward, ended, over)
    for key in info.keys() - {"action_mask"}:
        found = infos[key][row]
        assert (found.tolist() if isinstance(found, np.ndarray) else found) == (
            list(info[key]) if isinstance(found, np.ndarray) else info[key]
        ), key
    if last is None:
        assert "final_obs" not in infos or infos["final_obs"][row] is None
    else:
        assert infos["_final_obs"][row]
        for key, value in last.items():
            np.testing.assert_array_equal(infos["final_obs"][row][key], value)


def test_worlds_are_those_of_single_environments_bit_for_bit_with_one_worker_and_with_two_in_step_and_at_their_pace():
    expected = _one_by_one()
    for workers in (1, 2):
        with closing(vector_env(SHORT, 3, "physics", workers=workers, **IMPERFECT)) as envs:
            observations, infos = envs.reset(seed=7)
            assert envs.observation_space.contains(observations)
            assert infos == {}
            for tick in range(TICKS):
                batch = envs.step(_picks(0)[tick])
                for world in range(3):
                    _check(batch, world, expected[world][tick])
            layout = SHORT.layout
            assert envs.car_vectors().shape == (3, layout.n_cars, layout.vector_length)
            np.testing.assert_array_equal(
                envs.car_vectors()[:, 0, 13:], batch[0]["observation"].reshape(3, -1)
            )

            envs.reset(seed=7)
            ticks = np.zeros(3, int)
            envs.send(_picks(0)[0])
            while (ticks < TICKS).any():
                batch = envs.recv()
                ids = batch[4]["env_id"]
                for row, world in enumerate(ids):
                    _check(batch, row, expected[world][ticks[world]])
                ticks[ids] += 1
                again = ids[ticks[ids] < TICKS]
                envs.send(_picks(0)[ticks[again], again], again)


def test_a_batch_in_physics_has_the_form_of_one_on_the_grid_and_is_made_by_gymnasium_too():
    grid = GridVectorEnv("strip", 2)
    grid_seen, _ = grid.reset(seed=0)
    still = np.full((2, 2), Action.STOP)
    of_grid = grid.step(still)
    options = {"backend": "physics", "workers": 1, "render_mode": "ansi"}
    with closing(gymnasium.make_vec(TASK_IDS["strip"], 2, **options)) as envs:
        assert isinstance(envs, PhysicsVectorEnv)
        assert (envs.observation_space, envs.action_space) == (
            grid.observation_space,
            grid.action_space,
        )
        with pytest.raises(InputError, match=r"reset\(\)"):
            envs.step(still)
        seen, _ = envs.reset(seed=0)
        batch = envs.step(still)
        for mine, other in ((seen, grid_seen), (batch[0], of_grid[0]), (batch[4], of_grid[4])):
            shared = other.keys()
            assert {key: (mine[key].shape, mine[key].dtype) for key in shared} == {
                key: (other[key].shape, other[key].dtype) for key in shared
            }
        for mine, other in zip(batch[1:4], of_grid[1:4], strict=True):
            assert (mine.shape, mine.dtype) == (other.shape, other.dtype)

        assert [type(picture) for picture in envs.render()] == [str, str]

        for act, words in (
            (lambda: envs.recv(), "no world is acting"),
            (lambda: envs.send(still, [0, 0]), "different whole numbers from 0 to 1"),
            (lambda: envs.send(still, [0, 2]), "different whole numbers from 0 to 1"),
            (lambda: envs.send(still, [1]), r"shape \(1, 2\)"),
            (lambda: envs.step(still + 15), "0 to 14"),
            (lambda: envs.reset(seed=[1]), "2 of them"),
            (lambda: envs.reset(seed=-1), "the seed is -1"),
            (lambda: envs.reset(options={"blueprint": 3}), "must be a path"),
        ):
            with pytest.raises(InputError, match=words):
                act()
        envs.send(still[:1], [1])
        for act, words in (
            (lambda: envs.send(still), r"worlds \[1\] are acting"),
            (lambda: envs.step(still), r"worlds \[1\] are acting"),
            (lambda: envs.reset(), r"worlds \[1\] are acting"),
            (lambda: envs.recv(0), "at_least is 0"),
        ):
            with pytest.raises(InputError, match=words):
                act()
        assert envs.recv(5)[4]["env_id"].tolist() == [1]


def _ended(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_a_killed_worker_is_one_clear_error_and_nothing_is_left_running():
    envs = vector_env("strip", 4, "physics", workers=2)
    envs.reset(seed=0)
    pids = envs.pids
    assert len(pids) == 2
    os.kill(pids[1], signal.SIGKILL)
    with pytest.raises(CraftsimError, match=r"the worlds 1, 3 was killed by signal 9 \(SIGKILL\)"):
        envs.step(np.full((4, 2), Action.STOP))
    assert all(map(_ended, pids))
    with pytest.raises(InputError, match="closed"):
        envs.step(np.full((4, 2), Action.STOP))
    envs.close()


def test_what_breaks_in_a_world_is_told_here_and_closing_in_the_middle_of_a_step_ends_all_processes():
    with closing(vector_env("strip", 2, "physics", workers=1, observers=[math.sqrt])) as envs:
        envs.reset(seed=0)
        with pytest.raises(CraftsimError, match="TypeError: must be real number, not PhysicsWorld"):
            envs.step(np.full((2, 2), Action.ROTATE_LEFT))
    envs = vector_env("strip", 2, "physics", workers=1)
    envs.reset(seed=0)
    pids = envs.pids
    envs.send(np.full((2, 2), Action.ROTATE_LEFT))
    envs.close()
    assert all(map(_ended, pids))


def test_what_is_recorded_of_an_unfinished_episode_is_written_when_the_worlds_are_closed(tmp_path):
    with closing(vector_env("strip", 2, "physics", workers=2, record=tmp_path)) as envs:
        envs.reset(seed=0)
        envs.step(np.full((2, 2), Action.STOP))
        assert not list(tmp_path.rglob("*.npz"))
    assert len(list(tmp_path.rglob("*.npz"))) == 2


ABANDONING = """
import os
import craftsim
if __name__ == "__main__":
    envs = craftsim.vector_env("strip", 2, "physics", workers=2)
    envs.reset(seed=0)
    print(*envs.pids, flush=True)
    os._exit(1)
"""


def test_processes_end_when_the_one_that_started_them_is_gone(tmp_path):
    script = tmp_path / "abandoning.py"
    script.write_text(ABANDONING)
    run = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60)
    pids = [int(word) for word in run.stdout.split()]
    assert len(pids) == 2
    deadline = time.monotonic() + 60
    while not all(map(_ended, pids)):
        assert time.monotonic() < deadline
        time.sleep(0.05)
