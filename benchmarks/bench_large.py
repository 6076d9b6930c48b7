"""The large tasks: plans for the tower, random play on the grid, and MAPPO's rollout and update with 64 worlds."""

import math
import time

import numpy as np
import pytest

from craftsim.cli.bench import pick
from craftsim.planning import NoPlanError, plan_building
from craftsim.tasks import as_task
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.random_tasks import LARGE_NAMES

WORLDS = 64
ATTEMPTS = 8
TOWERS = [name for name in LARGE_NAMES if "tower" in name]


@pytest.mark.parametrize("start", range(10))
@pytest.mark.parametrize("name", TOWERS)
def test_a_plan(benchmark, name, start):
    """The best of eight attempts from a held-out start; ``first_s`` is when the first plan was found."""
    task = as_task(f"{name}@test")
    grid = task.draw(np.random.default_rng(start))
    begun, found = time.process_time(), []

    def note(number, best):
        if best is not None:
            found.append(time.process_time() - begun)

    def plan():
        return plan_building(grid, task, rounds=ATTEMPTS, time_s=math.inf, report=note)

    try:
        planned = benchmark.pedantic(plan, rounds=1)
    except NoPlanError as error:
        pytest.skip(f"no plan: {error}")
    benchmark.extra_info.update(
        first_s=found[0],
        ticks=len(planned.ticks),
        makespan_s=planned.makespan_s,
        bound_s=planned.bound_s,
    )


@pytest.mark.parametrize("name", LARGE_NAMES)
def test_random_play(benchmark, name):
    """An episode of 64 worlds on the grid, with masks and observations; ``steps_per_s`` are ticks of one world."""
    task, rng = as_task(name), np.random.default_rng(0)
    episodes = Episodes(task, rng, WORLDS)
    returns = []

    def play():
        episodes.reset()
        earned = np.zeros(WORLDS)
        for _ in range(task.max_steps + 2):
            earned += episodes.step(pick(rng, episodes.offered())).reward
            episodes.vectors()
        returns.append(earned.mean())

    benchmark.pedantic(play, rounds=5, warmup_rounds=1)
    steps = WORLDS * (task.max_steps + 2)
    benchmark.extra_info["steps_per_s"] = steps / benchmark.stats.stats.median
    benchmark.extra_info["mean_return"] = np.mean(returns)


@pytest.mark.parametrize("what", ["rollout", "update"])
@pytest.mark.parametrize("name", LARGE_NAMES)
def test_mappo(benchmark, name, what):
    """An episode of 64 worlds, and learning from it; ``steps_per_s`` are ticks of one world."""
    torch = pytest.importorskip("torch")
    from craftsim.learning.config import TrainConfig
    from craftsim.learning.trainer import Trainer

    torch.set_num_threads(1)
    trainer = Trainer(TrainConfig(name, "mappo", worlds=WORLDS))
    rollout = trainer.play(0)
    work = {"rollout": lambda: trainer.play(1), "update": lambda: trainer.learner.update(rollout)}[
        what
    ]
    benchmark.pedantic(work, rounds=1)
    benchmark.extra_info["steps_per_s"] = trainer.steps_an_iteration / benchmark.stats.stats.median
