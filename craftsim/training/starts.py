"""Other starts to train from: worlds that a plan comes by, or that were reached in physics."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.starts import load_starts, starting_from


def with_starts(task: Task, path: Path) -> Task:
    """Return a task of whose episodes half start as ever and half with a world drawn from a file.

    Args:
        task: the task.
        path: a plan, followed under the rules from the task's start, or a file of
            :func:`craftsim.discrete.tasks.starts.save_starts`.

    Raises:
        InputError: the file cannot be read, or does not fit the task.
    """
    own = task.draw(np.random.default_rng(0))
    grids = along_plan(own, path) if path.suffix == ".plan" else load_starts(path)
    return starting_from(task, [*grids, *[own] * len(grids)])


def along_plan(start: Grid, path: Path) -> list[Grid]:
    """Return the worlds that a plan comes by before its last tick, the start left out."""
    rules, grids = Rules("physical"), [start]
    for tick in read_plan(path, start.n_cars).ticks[:-1]:
        grids.append(rules.tick(grids[-1], tick)[0])
    return grids[1:]
