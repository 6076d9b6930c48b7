"""What a joint step in physics costs: by cars and blocks, beside MuJoCo's own steps; resets; many worlds."""

import os
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from benches import ToAndFro, yard

import craftsim
from craftsim.cli.bench import pick
from craftsim.discrete.kinds import Action
from craftsim.envs.central import CentralConstruction
from craftsim.mjcf.drives import DRIVES

GROWING = [(2, 0), (4, 0), (8, 0), (16, 0), (32, 0), (4, 8), (4, 32), (4, 128), (4, 512)]
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


@pytest.mark.parametrize(
    ("task", "cars"), [("strip", 2), ("simple_two_story", 4), ("complex_two_story", 4)]
)
def test_simulated_time_of_asynchronous_execution(benchmark, task, cars):
    """A call is a minute of asynchronous masked random play, in turn with a synchronous one.

    The figures are simulated seconds, actions other than STOP, and the seconds that these take, a CPU second;
    ``ratio``, ``ratio_of_actions`` and ``ratio_of_acting`` are asynchronous by synchronous. Cars that do not wait do
    more in a simulated second, and a physics step costs more the more cars move.
    """
    minutes = {name: _Minutes(task, cars, name) for name in ("synchronous", "asynchronous")}
    benchmark.pedantic(
        minutes["asynchronous"].play, setup=minutes["synchronous"].play, rounds=5, warmup_rounds=1
    )
    found = np.array([np.sum(one.found[1:], axis=0) for one in minutes.values()])
    figures = (
        ("simulated_s", "ratio"),
        ("actions", "ratio_of_actions"),
        ("acting_s", "ratio_of_acting"),
    )
    for column, (what, ratio) in enumerate(figures):
        rates = (found[:, column] / found[:, 3]).tolist()
        names = [f"{name}_{what}_a_second" for name in minutes]
        benchmark.extra_info |= dict(zip(names, rates, strict=True)) | {ratio: rates[1] / rates[0]}


class _Minutes:
    """Masked random play of an environment in physics; by minute: simulated seconds, actions, their seconds, CPU's."""

    def __init__(self, task, cars, execution):
        self.env = craftsim.parallel_env(craftsim.make_task(task, n_cars=cars), execution=execution)
        self.rng, self.found = np.random.default_rng(0), []
        self.seen, _ = self.env.reset(seed=0)

    def play(self):
        simulated_s, acting_s, cpu_s, n_actions = 0.0, 0.0, 0.0, 0
        while simulated_s < 60:
            masks = np.stack([one["action_mask"] for one in self.seen.values()])
            actions = dict(zip(self.seen, pick(self.rng, masks).tolist(), strict=True))
            backend = self.env.core.backend
            n_ticks, began_s = len(backend.ticks), backend.judge.physics.time_s
            cpu_began_s = time.process_time()
            self.seen = self.env.step(actions)[0]
            cpu_s += time.process_time() - cpu_began_s
            simulated_s += backend.judge.physics.time_s - began_s
            done = [
                one.duration_s
                for tick in backend.ticks[n_ticks:]
                for one in tick
                if one.verb != "STOP"
            ]
            n_actions, acting_s = n_actions + len(done), acting_s + sum(done)
            if not self.env.agents:
                self.seen, _ = self.env.reset()
        self.found.append((simulated_s, n_actions, acting_s, cpu_s))
