"""What stands in a world as one thing each, a slope's two cells together, and worlds made of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from craftsim.discrete.grid import SECOND_PART, Cell, Grid, Kind, beside

_IS_MOVABLE = np.isin(list(Kind), (Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.BODY))
"""(kinds,)."""


class BuildingPart(NamedTuple):
    """A block, a flag, a folded slope or, as BODY, an unfolded one."""

    kind: Kind
    cell: Cell
    yaw: int = 0

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The cells that it takes."""
        return (self.cell, beside(self.cell, self.yaw)) if self.kind in SECOND_PART else (self.cell,)

    @property
    def yaws(self) -> tuple[int, ...]:
        """The headings of a car below it: a slope's car heads uphill, half a turn from where it points."""
        return ((self.yaw + 2) % 4,) if self.kind in SECOND_PART else (0, 1, 2, 3)

    @property
    def load(self) -> Kind:
        """What it is on a car."""
        return Kind.FSLOPE if self.kind == Kind.BODY else self.kind


def things_in(grid: Grid) -> Iterator[BuildingPart]:
    """Yield what stands in a world and can be moved."""
    for x, y, z in np.argwhere(_IS_MOVABLE[grid.kind]).tolist():
        yield BuildingPart(Kind(grid.kind[x, y, z]), (x, y, z), int(grid.yaw[x, y, z]))


def without_things(grid: Grid) -> Grid:
    """Return the world with nothing but ground and walls."""
    bare = Grid.empty(grid.size)
    bare.kind[grid.kind == Kind.WALL] = Kind.WALL
    return bare


def put(grid: Grid, things: Iterable[BuildingPart]) -> None:
    """Put things into a world, in place; a gear gives way to what stands."""
    for thing in things:
        grid.kind[thing.cell], grid.yaw[thing.cell] = thing.kind, thing.yaw
        if thing.kind in SECOND_PART:
            second = thing.cells[1]
            if _is_inside(grid, second) and (thing.kind == Kind.BODY or grid.kind[second] == Kind.AIR):
                grid.kind[second], grid.yaw[second] = SECOND_PART[thing.kind], thing.yaw


def take(grid: Grid, things: Iterable[BuildingPart]) -> None:
    """Take things out of a world, in place."""
    for thing in things:
        for cell in thing.cells:
            if cell == thing.cell or (_is_inside(grid, cell) and grid.kind[cell] in (Kind.GEAR, Kind.FOOT)):
                grid.kind[cell], grid.yaw[cell] = Kind.AIR, 0


def _is_inside(grid: Grid, cell: Cell) -> bool:
    """Return whether a cell is in the area; the gear of a folded slope may not be."""
    return all(0 <= c < n for c, n in zip(cell, grid.kind.shape, strict=True))


def with_car(grid: Grid, cell: Cell, yaw: int, load: Kind = Kind.AIR) -> Grid:
    """Return the world with a single car; a slope that it carries has its low side behind it."""
    car = [*cell, yaw, load, (yaw + 2) % 4 if load == Kind.FSLOPE else 0, 0]
    return Grid(grid.cells, np.array([car], np.int16))
