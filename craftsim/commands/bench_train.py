"""Measure how fast PPO learns on the grid: what ``craftsim bench train`` prints."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from craftsim.commands.bench_cells import Cells, show
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.training.extra import need_torch

if TYPE_CHECKING:
    from rich.console import Console

TASKS: Final = ("strip", "simple_two_story")


def bench_train(console: Console, runs: int, seed: int, out: Path | None) -> dict[str, Any]:
    """Print steps a CPU second of IPPO with its shipped settings, on one thread, and return the figures by task.

    A step is one tick of one world. ``grid`` is the worlds alone with random actions, ``rollout`` playing with the
    policy, ``learning`` the updates, ``all`` both together; evaluations have no part in it.

    Args:
        console: where to print.
        runs: rollouts, each with its update; one more before them is not timed.
        seed: of networks, worlds and actions.
        out: folder for the table in Markdown, if there is to be one.
    """
    need_torch()
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        figures = {task: _rates(task, runs, seed) for task in TASKS}
    finally:
        torch.set_num_threads(threads)
    rows = tuple((task, *(f"{rate:,.0f}" for rate in rates.values())) for task, rates in figures.items())
    table = Cells(
        "IPPO, steps a CPU second on one thread", ("task", "grid", "rollout", "learning", "all"), rows
    )
    show([table], (), console, None if out is None else out / "train.md")
    return figures


def _rates(task: str, runs: int, seed: int) -> dict[str, float]:
    import torch

    from craftsim.training.config import TrainConfig
    from craftsim.training.trainer import Trainer

    trainer = Trainer(TrainConfig(task, seed=seed))
    rollout_s = learning_s = 0.0
    with torch.random.fork_rng():
        for i in range(runs + 1):
            begun = time.process_time()
            rollout = trainer.play(seed + i)
            played = time.process_time()
            trainer.learner.update(rollout)
            if i:  # whatever is compiled or set up at its first use is no part of the time
                rollout_s += played - begun
                learning_s += time.process_time() - played
    steps = runs * trainer.steps_an_iteration
    return {
        "grid": _grid_rate(task, trainer.config.worlds, trainer.learner.ticks * runs, seed),
        "rollout": steps / rollout_s,
        "learning": steps / learning_s,
        "all": steps / (rollout_s + learning_s),
    }


def _grid_rate(task: str, worlds: int, ticks: int, seed: int) -> float:
    rng = np.random.default_rng(seed)
    episodes = Episodes(make_task(task), rng, worlds)
    episodes.reset()
    begun = time.process_time()
    for _ in range(ticks):
        mask = episodes.offered()
        done = episodes.step((rng.random(mask.shape) * mask).argmax(-1)).done
        episodes.reset(done.nonzero()[0])
    return ticks * worlds / (time.process_time() - begun)
