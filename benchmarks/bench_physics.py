"""What a joint step in physics costs: by cars and blocks, beside MuJoCo's own steps; resets; many worlds."""

import os
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from benches import ToAndFro, yard

from craftsim.discrete.kinds import Action
from craftsim.envs.central import CentralConstruction
from craftsim.mjcf.parameters import DRIVES

GROWING = [(2, 0), (4, 0), (8, 0), (16, 0), (32, 0), (4, 8), (4, 32), (4, 128)]
"""Cars that drive to and fro, and blocks at rest."""


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("what", ["play", "replay", "reset"])
@pytest.mark.parametrize(("cars", "blocks"), GROWING)
def test_two_joint_steps(benchmark, drive, what, cars, blocks):
    """``play`` is the environment, ``replay`` the same physics by ``mj_step`` alone, ``reset`` back to the start."""
    episode = ToAndFro(yard(cars, blocks), drive=drive)
    setup = None if what == "reset" else episode.reset
    benchmark.pedantic(getattr(episode, what), setup=setup, rounds=3)


@pytest.mark.parametrize("drive", DRIVES)
def test_the_memory_of_a_world(benchmark, drive):
    """The figure is ``mib_a_world``: what each world beyond the first adds."""
    worlds = []

    def another():
        env = CentralConstruction("simple_two_story", drive=drive)
        env.reset(seed=0)
        env.step(np.full(env.core.n_cars, Action.STOP))
        worlds.append((env, _resident_mib()))

    benchmark.pedantic(another, rounds=8)
    benchmark.extra_info["mib_a_world"] = (worlds[-1][1] - worlds[0][1]) / (len(worlds) - 1)
    for env, _ in worlds:
        with closing(env):
            pass


def _resident_mib():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
