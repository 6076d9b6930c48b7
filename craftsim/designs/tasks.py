"""The task in which each episode has a design of its own, drawn by the generator, with a start to build it from."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.designs.drawn import Size, start_of
from craftsim.designs.starts import DesignStart
from craftsim.discrete.files.blueprint import Blueprint
from craftsim.discrete.grid import KINDS_WITH_YAW, CarField, Cell, Grid, check_size
from craftsim.errors import InputError
from craftsim.storage.limits import SHARE
from craftsim.tasks.random_tasks import whole_size
from craftsim.tasks.registry import DESIGNS
from craftsim.tasks.rewards import Weights
from craftsim.tasks.starts import (
    Split,
    Starts,
    StartSampler,
    Targets,
    belongs,
    check_split,
    read_split,
    split_name,
    targets_of,
)
from craftsim.tasks.task import Task, build_task

_CARS: Final = 2
_BLOCKS: Final = 6
"""Largest number of blocks of a design."""
_SLOPES: Final = 1
_AREA: Final[Cell] = (6, 6, 2)
_MAX_STEPS: Final = 89
"""1.5 times what 95 % of the planner's plans take (docs/reference/tasks.md)."""
POOL: Final = 1024
"""Designs that are drawn at the first use, unless they are shipped; each is used in all its reflections."""
_TARGET: Final = (1, 2, 4)
"""Columns of Targets: x, y and yaw."""
_TRIES: Final = 200
_LEAST: Final = 6
_RAMPS: Final = 0.25
"""Probability that a building of one level has a ramp."""


@dataclass(frozen=True)
class DrawnDesigns:
    """Random designs of a split with starts: a pool drawn at the first use, then drawn from with replacement."""

    difficulty: tuple[float, float] = (0.0, 1.0)
    n_cars: int = _CARS
    n_blocks: int = _BLOCKS
    area: Cell = _AREA
    split: Split = "train"

    def draw(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n starts; raises InputError where designs find no room."""
        return _pool(self).draw(rng, n)

    def fresh(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n new starts with their designs."""
        starts: list[DesignStart] = []
        designs: list[Targets] = []
        misses = 0
        while len(starts) < n:
            start = start_of(self._size(rng), self.n_cars, rng)
            if start is None:
                misses += 1
                if misses > _TRIES * (1 + len(starts)):
                    raise InputError(
                        f"designs of up to {self.n_blocks} blocks with {self.n_cars} cars find no room in an area of "
                        f"{self.area[:2]} cells; try a larger one, or fewer of them"
                    )
                continue
            rows = targets_of(start.design)
            if belongs([shape_digest(rows)], self.split)[0]:
                starts.append(start)
                designs.append(np.pad(rows, ((0, self.n_blocks + 2 * _SLOPES - len(rows)), (0, 0))))
        return Starts.of([start.grid for start in starts], np.stack(designs))

    def _size(self, rng: np.random.Generator) -> Size:
        difficulty = rng.uniform(*self.difficulty)
        middle = 2 + difficulty * (self.n_blocks - 2)
        blocks = int(np.clip(round(rng.uniform(middle - 1, middle + 1)), 2, self.n_blocks))
        if rng.random() < difficulty:
            levels = 2
        else:
            levels = 1
        ramps = levels - 1 or int(rng.random() < _RAMPS)
        return Size(self.area, blocks, levels, ramps, self.n_cars)


@lru_cache(maxsize=8)
def _pool(designs: DrawnDesigns) -> Starts:
    if designs == DrawnDesigns():
        return with_reflections(read_split(DESIGNS, "train")[0])
    return with_reflections(designs.fresh(np.random.default_rng(0), POOL))


def designs_task(
    split: Split = "train",
    reward: str | Weights = "paper",
    difficulty: tuple[float, float] = (0.0, 1.0),
    n_cars: int | None = None,
    n_blocks: int | None = None,
    area: tuple[int, ...] | None = None,
    max_steps: int = _MAX_STEPS,
) -> Task:
    """Return the task in which each episode has a random design with a start: on one or two levels, at most one ramp.

    Args:
        split: ``train`` or ``test``; no design of one, turned, reflected or moved, is in the other. The held-out
            starts that are shipped have each been solved by the planner; with other arguments the designs are drawn at
            the first use, and some may have no solution.
        reward: see :func:`craftsim.make_task`.
        difficulty: from 0 to 1, the range that each design's is drawn from: it sets how many blocks there are and how
            often a second level.
        n_cars: 2 unless given.
        n_blocks: of a design at most, 6 unless given.
        area: (length, width) or (length, width, height) in cells, (6, 6, 2) unless given.
        max_steps: the step limit.

    Raises InputError.

    Example:
        >>> import craftsim
        >>> task = craftsim.designs_task("test")
        >>> task.layout.n_blocks, task.layout.n_slopes, task.layout.n_targets
        (6, 1, 8)
    """
    check_split(split)
    for end in difficulty:
        SHARE.check("the difficulty", end)
    cars = _CARS if n_cars is None else n_cars
    blocks = _BLOCKS if n_blocks is None else n_blocks
    size = whole_size(area, _AREA)
    check_size(size, cars)
    if blocks < 2 or min(size[:2]) < _LEAST:
        raise InputError(
            f"designs of {blocks} blocks in an area of {size[:2]} cells; allowed: 2 blocks or more, "
            f"{_LEAST} cells a side"
        )
    designs = DrawnDesigns(difficulty, cars, blocks, size, split)
    sampler: StartSampler = designs
    if designs == DrawnDesigns(split="test"):
        sampler = read_split(DESIGNS, "test")[0]
    blueprint = Blueprint(Path(DESIGNS), size, blocks, _SLOPES, cars)
    return replace(
        build_task(DESIGNS, (blueprint,), "built", reward, max_steps),
        name=split_name(DESIGNS, split),
        sampler=sampler,
        split=split,
        shown_targets=blocks + 2 * _SLOPES,
    )


def with_reflections(starts: Starts) -> Starts:
    """Return starts with all that become of them by turning and reflecting the area, which keeps its sides."""
    step = 2
    if starts.grids.size[0] == starts.grids.size[1]:
        step = 1
    images = []
    for turns in range(0, 4, step):
        turned = starts
        for _ in range(turns):
            turned = _moved(turned, reflected=False)
        images += [turned, _moved(turned, reflected=True)]
    return Starts.joined(images)


def _moved(starts: Starts, reflected: bool) -> Starts:
    """Return starts with y reversed, or turned by a quarter, from +x to +y."""
    cells = starts.grids.cells
    width = starts.grids.size[1]
    if reflected:
        cells = cells[:, :, ::-1]
    else:
        cells = cells.swapaxes(1, 2)[:, ::-1]
    grids = Grid(cells.copy(), starts.grids.cars.copy())
    designs = starts.designs.copy()
    turned = np.isin(grids.kind, KINDS_WITH_YAW)
    if reflected:
        grids.yaw[turned] = -grids.yaw[turned] % 4
    else:
        grids.yaw[turned] = (grids.yaw[turned] + 1) % 4
    every_car = np.ones(grids.cars.shape[:-1], np.bool_)
    _move(grids.cars, (CarField.X, CarField.Y, CarField.YAW), every_car, width, reflected)
    _move(designs, _TARGET, designs[..., 0] != 0, width, reflected)
    return Starts(grids, designs)


def _move(
    rows: NDArray[Any],
    columns: tuple[int, int, int],
    moves: NDArray[np.bool_],
    width: int,
    reflected: bool,
) -> None:
    """Move x, y and yaw of those rows that are there, in place, in an area of a width; a yaw of -1 stays."""
    x, y, yaw = (rows[..., column].copy() for column in columns)
    if reflected:
        moved = (x, width - 1 - y, -yaw % 4)
    else:
        moved = (width - 1 - y, x, (yaw + 1) % 4)
    for column, value, change in zip(
        columns, moved, (moves, moves, moves & (yaw >= 0)), strict=True
    ):
        rows[..., column][change] = value[change]


def shape_digest(targets: Targets) -> bytes:
    """Return a digest (SHA-256) of a design, (T, 5), that is the same wherever it stands, turned or reflected."""
    rows = targets[targets[:, 0] != 0].copy()
    every_row = np.ones(len(rows), np.bool_)
    forms = []
    for turn in range(8):
        _move(rows, _TARGET, every_row, 1, reflected=turn == 4)
        form = rows.copy()
        form[:, 1:3] -= form[:, 1:3].min(axis=0)
        forms.append(form[np.lexsort(form.T)].tobytes())
    return hashlib.sha256(min(forms)).digest()
