"""What the cars observe: rows of 13 numbers an entity, as CraftEnv lays them out, and plain arrays.

Row: x y z, then one flag each for car, folded slope, body, foot, block, flag, goal, then yaw as two bits
(high first), then whether a car is loaded. Gears and walls have no rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.blueprint import NO_CELL, Blueprint
from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import CarField, Cell, Grid, Kind
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    BODY,
    F_LOAD,
    F_LOAD_YAW,
    F_X,
    F_Y,
    F_YAW,
    F_Z,
    FLAG,
    FOOT,
    FSLOPE,
    KIND,
    YAW,
    World,
    car_field,
)

ROW: Final = 13
IS_CAR, IS_FSLOPE, IS_BODY, IS_FOOT, IS_BLOCK, IS_FLAG, IS_GOAL = range(3, 10)
YAW_HIGH, YAW_LOW, IS_LOADED = 10, 11, 12


@dataclass(frozen=True)
class Layout:
    """How many rows an observation has for each group of entities, and what its goal row shows."""

    n_cars: int
    n_slopes: int
    n_blocks: int
    goal: Cell | None
    shows_flag: bool
    """The flag row shows the flag; otherwise it repeats the goal row (docs/rules.md#flag-row)."""
    n_targets: int = 0
    """Rows after those of the entities that show what is to be built."""

    @classmethod
    def of(cls, blueprint: Blueprint, shows_flag: bool, n_targets: int = 0) -> Layout:
        """Return the layout for the worlds of a blueprint."""
        counts = (blueprint.n_cars, blueprint.n_slopes, blueprint.n_blocks)
        return cls(*counts, blueprint.goal, shows_flag, n_targets)

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
    def overflow(self) -> str:
        """What to say when a world does not fit."""
        return f"the world has more than the {self.n_slopes} slopes and {self.n_blocks} blocks announced"

    @property
    def vector_length(self) -> int:
        """Length of one car's observation: its own row, then all rows."""
        return ROW * (1 + self.n_observed)


@compiled
def write_row(row: NDArray[np.int32], x: int, y: int, z: int, flag: int, yaw: int) -> None:
    """Write an entity's position, type flag and yaw into its 13 numbers."""
    row[0], row[1], row[2] = x, y, z
    row[flag] = 1
    row[YAW_HIGH], row[YAW_LOW] = yaw >> 1, yaw & 1


@compiled
def type_flag(kind: int) -> int:
    """Return the index of the type flag of a kind that has rows, else 0."""
    if kind == FSLOPE:
        return IS_FSLOPE
    if kind == BODY:
        return IS_BODY
    if kind == FOOT:
        return IS_FOOT
    if kind == BLOCK:
        return IS_BLOCK
    return IS_FLAG if kind == FLAG else 0


@compiled
def fill_rows(
    w: World,
    n_slopes: int,
    n_blocks: int,
    goal: tuple[int, int, int],
    shows_flag: bool,
    slots: NDArray[np.int64],
    out: NDArray[np.int32],
) -> bool:
    """Write the rows of all entities into out (n_rows, 13); return False if a group has too few rows.

    ``slots`` (2, 13) is scratch: by type flag, a group's next row and how many it has left.
    """
    out[:] = 0
    n_cars = w.cars.shape[0]
    slots[:] = 0
    first, free = slots[0], slots[1]
    first[IS_FSLOPE] = n_cars
    first[IS_BODY] = first[IS_FSLOPE] + n_slopes
    first[IS_FOOT] = first[IS_BODY] + n_slopes
    first[IS_BLOCK] = first[IS_FOOT] + n_slopes
    first[IS_FLAG] = first[IS_BLOCK] + n_blocks
    free[IS_FSLOPE] = free[IS_BODY] = free[IS_FOOT] = n_slopes
    free[IS_BLOCK] = n_blocks
    free[IS_FLAG] = 1 if shows_flag else 0
    fits = True
    for car in range(n_cars):
        write_row(
            out[car],
            car_field(w, car, F_X),
            car_field(w, car, F_Y),
            car_field(w, car, F_Z),
            IS_CAR,
            car_field(w, car, F_YAW),
        )
        flag = type_flag(car_field(w, car, F_LOAD))
        if flag == 0:
            continue
        out[car, IS_LOADED] = 1
        if free[flag] > 0:
            write_row(
                out[first[flag]],
                car_field(w, car, F_X),
                car_field(w, car, F_Y),
                car_field(w, car, F_Z),
                flag,
                car_field(w, car, F_LOAD_YAW),
            )
            first[flag] += 1
            free[flag] -= 1
        elif flag != IS_FLAG:
            fits = False
    for x in range(w.cells.shape[0]):
        for y in range(w.cells.shape[1]):
            for z in range(1, w.cells.shape[2]):
                if w.cells[x, y, z, KIND] == AIR:
                    continue
                flag = type_flag(w.cells[x, y, z, KIND])
                if flag == 0:
                    continue
                if free[flag] > 0:
                    write_row(out[first[flag]], x, y, z, flag, w.cells[x, y, z, YAW])
                    first[flag] += 1
                    free[flag] -= 1
                elif flag != IS_FLAG:
                    fits = False
    last = out.shape[0] - 1
    write_row(out[last], goal[0], goal[1], goal[2], IS_GOAL, 0)
    if not shows_flag:
        write_row(out[last - 1], goal[0], goal[1], goal[2], IS_GOAL, 0)
    return fits


def car_vectors(rows: NDArray[np.int32], n_cars: int) -> NDArray[np.int32]:
    """Return every car's observation, shape (..., n_cars, 13 * (1 + n_rows)): its own row, then all rows."""
    everything = rows.reshape(*rows.shape[:-2], 1, -1)
    shared = np.broadcast_to(everything, (*rows.shape[:-2], n_cars, everything.shape[-1]))
    return np.concatenate([rows[..., :n_cars, :], shared], axis=-1)


def target_rows(designs: NDArray[np.integer]) -> NDArray[np.int32]:
    """Return a row for each cell to be built, (..., T, 13): as a thing would have there, and marked as a goal.

    ``designs`` is (..., T, 5), rows (kind, x, y, z, yaw), kind 0 and a row of zeros where there is none.
    """
    kind, yaw = designs[..., 0], np.maximum(designs[..., 4], 0)
    rows = np.zeros((*designs.shape[:-1], ROW), np.int32)
    rows[..., :3] = designs[..., 1:4]
    for one in (Kind.FSLOPE, Kind.BODY, Kind.FOOT, Kind.BLOCK):
        rows[..., type_flag(one)] = kind == one
    rows[..., YAW_HIGH], rows[..., YAW_LOW], rows[..., IS_GOAL] = yaw >> 1, yaw & 1, 1
    rows[kind == 0] = 0
    return rows


def design_rows(design: Design) -> NDArray[np.int32]:
    """Return one row for each target body, foot and block, in this order, shape (n, 13).

    Feet carry the flag of a body (docs/rules.md#design-feet).
    """
    bodies, feet, blocks = (design.of_kind(kind) for kind in (Kind.BODY, Kind.FOOT, Kind.BLOCK))
    rows = np.zeros((len(bodies) + len(feet) + len(blocks), ROW), np.int32)
    flags = [IS_BODY] * (len(bodies) + len(feet)) + [IS_BLOCK] * len(blocks)
    yaws = [design.body_yaw(cell) for cell in bodies] + [0] * (len(feet) + len(blocks))
    for row, cell, flag, yaw in zip(rows, [*bodies, *feet, *blocks], flags, yaws, strict=True):
        write_row(row, *cell, flag, yaw)
    return rows


def as_arrays(grid: Grid) -> dict[str, NDArray[np.generic]]:
    """Return the world as plain arrays that share nothing with it.

    ``kind`` and ``yaw`` have shape (L, W, H) without the ground layer; ``position`` (n, 3), ``heading`` (n,),
    ``load`` (n,), ``load_yaw`` (n,) and ``slope`` (n,) describe the cars.
    """
    cars = grid.cars
    return {
        "kind": grid.kind[:, :, 1:].copy(),
        "yaw": grid.yaw[:, :, 1:].copy(),
        "position": cars[:, CarField.X : CarField.Z + 1].copy(),
        "heading": cars[:, CarField.YAW].copy(),
        "load": cars[:, CarField.LOAD].copy(),
        "load_yaw": cars[:, CarField.LOAD_YAW].copy(),
        "slope": cars[:, CarField.SLOPE].copy(),
    }
