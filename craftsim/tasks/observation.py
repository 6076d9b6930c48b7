"""Observations of the cars: rows of 13 numbers an entity, as CraftEnv lays them out.

Row: x y z, then one flag each for car, folded slope, body, foot, block, flag, goal, then yaw as two bits
(high first), then whether a car is loaded. Gears and walls have no rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.blueprint import NO_CELL
from craftsim.discrete.grid import Cell, Grid
from craftsim.errors import CraftsimError
from craftsim.tasks.kernel import IS_CAR, IS_GOAL, ROW, TYPE_FLAGS, YAW_HIGH, YAW_LOW, write_rows
from craftsim.tasks.starts import Targets


@dataclass(frozen=True)
class Layout:
    """Numbers of rows of an observation by group of entities, and the content of its goal row."""

    n_cars: int
    n_slopes: int
    n_blocks: int
    goal: Cell | None
    shows_flag: bool
    """The flag row shows the flag; otherwise it repeats the goal row (docs/rules.md#flag-row)."""
    n_targets: int = 0
    """Number of rows after those of the entities, which show what is to be built."""

    @property
    def n_rows(self) -> int:
        """Rows of all entities: cars; folded slopes, bodies and feet; blocks; flag; goal."""
        return self.n_cars + 3 * self.n_slopes + self.n_blocks + 2

    @property
    def n_observed(self) -> int:
        """Rows of an observation: of all entities, and of what is to be built where that is shown."""
        return self.n_rows + self.n_targets

    @property
    def goal_cell(self) -> Cell:
        """Coordinates of the goal row, without a goal those that CraftEnv writes."""
        return self.goal or NO_CELL

    @property
    def vector_length(self) -> int:
        """Length of one car's observation: its own row, then all rows."""
        return ROW * (1 + self.n_observed)

    @cached_property
    def slots(self) -> NDArray[np.int64]:
        """(2, 13): by type flag, the first row of its group and how many rows there are."""
        slots = np.zeros((2, ROW), np.int64)
        groups = self.n_cars, *3 * (self.n_slopes,), self.n_blocks, int(self.shows_flag)
        slots[1, IS_CAR:IS_GOAL] = groups
        slots[0] = slots[1].cumsum() - slots[1]
        return slots


def entity_rows(grids: Grid, layout: Layout, designs: Targets) -> NDArray[np.int32]:
    """Return (B, n_observed, 13): the rows of all entities of each of B worlds, and of its design where that is shown.

    ``designs`` (B, T, 5) are what is to be built. Raises CraftsimError if a world has more cars, slopes or blocks than
    the layout has rows for.
    """
    out = np.empty((len(grids), layout.n_rows, ROW), np.int32)
    slots = np.empty_like(layout.slots)
    n_goals = 2
    if layout.shows_flag:
        n_goals = 1
    first_rows = layout.slots[0]
    counts = layout.slots[1]
    if not write_rows(
        grids.cells, grids.cars, first_rows, counts, slots, layout.goal_cell, n_goals, out
    ):
        raise CraftsimError(
            f"the world has more than the {layout.n_slopes} slopes and {layout.n_blocks} blocks announced"
        )
    if layout.n_targets:
        return np.concatenate([out, target_rows(designs)], axis=1)
    return out


def car_vectors(rows: NDArray[np.int32], n_cars: int) -> NDArray[np.int32]:
    """Return every car's observation, shape (..., n_cars, 13 * (1 + n_rows)): its own row, then all rows."""
    everything = rows.reshape(*rows.shape[:-2], 1, -1)
    vectors = np.empty((*rows.shape[:-2], n_cars, ROW + everything.shape[-1]), rows.dtype)
    vectors[..., :ROW] = rows[..., :n_cars, :]
    vectors[..., ROW:] = everything
    return vectors


def target_rows(designs: Targets) -> NDArray[np.int32]:
    """Return a row for each cell to be built, (..., T, 13): as a thing would have there, and marked as a goal.

    ``designs`` is (..., T, 5), rows (kind, x, y, z, yaw), kind 0 and a row of zeros where there is none.
    """
    kind = designs[..., 0]
    yaw = np.maximum(designs[..., 4], 0)
    rows = np.zeros((*designs.shape[:-1], ROW), np.int32)
    rows[..., :3] = designs[..., 1:4]
    for code, flag in enumerate(TYPE_FLAGS):
        if flag:
            rows[..., flag] = kind == code
    rows[..., YAW_HIGH] = yaw >> 1
    rows[..., YAW_LOW] = yaw & 1
    rows[..., IS_GOAL] = 1
    rows[kind == 0] = 0
    return rows
