"""Where a car can be at the start of a random world, and what it can carry there."""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple

import numpy as np

from craftsim.discrete.grid import CarField, Cell, Grid, Kind, beside
from craftsim.discrete.kernel import batch
from craftsim.discrete.rules import RULE_SETS

_LOADS: Final = (Kind.BLOCK, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.FSLOPE)


class Place(Enum):
    """Where a car starts; with how likely that is, and how likely it carries something there."""

    ON_TOP = (0.2, 0.4)
    """On the ground or on top of a stack, the highest included, where it is above the top level."""
    UNDER = (0.15, 0.0)
    """Under a block or a flag, in a stack or not."""
    UNDER_SLOPE = (0.1, 0.0)
    """Under a slope, folded or not."""
    ON_RAMP = (0.2, 0.5)
    """On the foot or over the body of a ramp, up or down."""
    AT_RAMP = (0.35, 0.5)
    """Before the foot or on the landing of a ramp, about to drive it."""

    def __init__(self, share: float, loaded: float) -> None:
        self.share, self.loaded = share, loaded

    @property
    def on_the_way(self) -> bool:
        """Whether it is on a ramp or before one."""
        return self in (Place.ON_RAMP, Place.AT_RAMP)


def put_car(grid: Grid, car: int, place: Place, rng: np.random.Generator) -> bool:
    """Put a car into a drawn cell of a kind of places, after those with lower numbers; return whether there is one."""
    taken = {tuple(row[: CarField.Z + 1]) for row in grid.cars[:car].tolist()}
    columns = {cell[:2] for cell in taken}
    free = [start for start in _cells(grid, place) if start.cell not in taken and not start.way & columns]
    if not free:
        return False
    start = free[int(rng.integers(len(free)))]
    yaw = start.yaws[int(rng.integers(len(start.yaws)))]
    grid.cars[car] = (*start.cell, yaw, Kind.AIR, 0, start.slope)
    return True


def put_load(grid: Grid, car: int, place: Place, rng: np.random.Generator) -> None:
    """Let a car carry something, if the draw says so and there is room for it."""
    row = grid.cars[car]
    chance, load = rng.random(), _LOADS[int(rng.integers(len(_LOADS)))]
    cell = (int(row[CarField.X]), int(row[CarField.Y]), int(row[CarField.Z]))
    if chance >= place.loaded or grid.kind_at(cell) not in (Kind.AIR, Kind.FOOT):
        return
    back = (int(row[CarField.YAW]) + 2) % 4
    row[CarField.LOAD], row[CarField.LOAD_YAW] = load, back if load == Kind.FSLOPE else 0
    if not has_room(grid):
        row[CarField.LOAD], row[CarField.LOAD_YAW] = Kind.AIR, 0


class _Start(NamedTuple):
    cell: Cell
    yaws: tuple[int, ...] = (0, 1, 2, 3)
    """Those that a car can have there."""
    slope: int = 0
    """The half of a slope that it is on."""
    way: frozenset[tuple[int, int]] = frozenset()
    """Columns of a ramp, end and landing included, where no other car may be: it would block the way."""


def _cells(grid: Grid, place: Place) -> list[_Start]:
    """Return the cells of a kind of places."""
    found: list[_Start] = []
    length, width, height = grid.size
    for x, y, z in np.ndindex(length, width, height + 1):
        cell = (x, y, z + 1)
        here, below = grid.kind_at(cell), grid.kind_at((x, y, z))
        along = int(grid.yaw[cell]) if z < height else 0
        match place:
            case Place.ON_TOP:
                if here == Kind.AIR and below in (Kind.GROUND, Kind.BLOCK):
                    found.append(_Start(cell))
            case Place.UNDER:
                if here in (Kind.BLOCK, Kind.FLAG):
                    found.append(_Start(cell))
            case Place.UNDER_SLOPE:
                if here in (Kind.FSLOPE, Kind.BODY):
                    found.append(_Start(cell, ((along + 2) % 4,)))
            case Place.ON_RAMP:
                if here == Kind.BODY:
                    foot, both = beside(cell, along), (along, (along + 2) % 4)
                    found.append(_Start(foot, both, 1, _way(cell, along)))
                    if grid.kind_at((x, y, z + 2)) == Kind.AIR:
                        found.append(_Start((x, y, z + 2), both, 2, _way(cell, along)))
            case Place.AT_RAMP:
                if here == Kind.BODY:
                    end, landing = beside(beside(cell, along), along), beside((x, y, z + 2), along + 2)
                    for there, yaw in ((end, (along + 2) % 4), (landing, along)):
                        found += [_Start(there, (yaw,), 0, _way(cell, along))] if _free(grid, there) else []
    return found


def _way(body: Cell, yaw: int) -> frozenset[tuple[int, int]]:
    cells = (beside(body, yaw + 2), body, beside(body, yaw), beside(beside(body, yaw), yaw))
    return frozenset(cell[:2] for cell in cells)


def _free(grid: Grid, cell: Cell) -> bool:
    """Return whether a cell is on the map, with something to stand on and nothing in it."""
    (x, y, z), (length, width, height) = cell, grid.size
    if not (0 <= x < length and 0 <= y < width and z <= height + 1) or grid.kind_at(cell) != Kind.AIR:
        return False
    return grid.kind_at((x, y, z - 1)) in (Kind.GROUND, Kind.BLOCK)


def has_room(grid: Grid) -> bool:
    """Return whether what each car carries is clear of all else by the rules: else no play of them leads there."""
    arrays = grid.cells, grid.cars, int(RULE_SETS["physical"])
    return all(batch.has_room(*arrays, car) for car in range(grid.n_cars))
