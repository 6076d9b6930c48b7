"""On a real Ray cluster a batch in physics gives the same as on this machine."""

import os
import signal
from contextlib import closing
from functools import partial
from importlib.util import find_spec

import numpy as np
import pytest

from craftsim.envs import vector_env
from craftsim.errors import CraftsimError, InputError
from craftsim.tasks import make_task

pytestmark = pytest.mark.skipif(not find_spec("ray"), reason="the extra 'ray' is not installed")
TICKS = 2
TASK = make_task("strip", max_steps=0)


def _played(envs):
    picks = np.random.default_rng(0).integers(0, 15, (TICKS, 3, 2))
    seen = [envs.reset(seed=1)[0]["observation"]]
    for tick in range(TICKS):
        envs.send(picks[tick])
        observation, rewards, *_, infos = envs.recv(3)
        assert infos["env_id"].tolist() == [0, 1, 2]
        seen += [observation["observation"], rewards, infos["car_error_m"], infos["duration_s"]]
    return seen


def _leave(mark, physics):
    if mark.exists():
        os.kill(os.getpid(), signal.SIGKILL)


def test_worlds_in_actors_are_those_of_local_processes_and_a_dead_actor_is_one_clear_error(
    ray_cluster, tmp_path
):
    with closing(vector_env(TASK, 3, "physics", workers=1)) as envs:
        expected = _played(envs)
    mark = tmp_path / "leave"
    with closing(
        vector_env(TASK, 3, "physics", engine="ray", observers=[partial(_leave, mark)])
    ) as envs:
        assert envs.workers == 2
        for mine, other in zip(_played(envs), expected, strict=True):
            np.testing.assert_array_equal(mine, other)
        mark.touch()
        with pytest.raises(CraftsimError, match=r"worlds [\d, to]+ is lost to the Ray cluster"):
            envs.step(np.full((3, 2), 4))
        with pytest.raises(InputError, match="closed"):
            envs.step(np.full((3, 2), 4))


def test_a_cluster_that_nobody_runs_is_refused(monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:9")
    with pytest.raises(
        InputError, match=r"no Ray cluster answers at 127\.0\.0\.1:9 .*make the environment anew"
    ):
        vector_env(TASK, 1, "physics", engine="ray")
