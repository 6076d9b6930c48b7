"""Things and cars around an action, drawn as the smallest world; cells count from the acting car's, heading +x."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from craftsim.discrete.grid import KINDS_WITH_YAW, SECOND_PART, CarField, Cell, Grid, Kind, beside
from craftsim.mjcf.parameters import Machines
from craftsim.models.placement import Placement, placements
from craftsim.validation.contexts.worlds import STANDS_ON, ImpossibleError

Thing = tuple[Kind, Cell, int]
"""An object with its cell and yaw; the second part of a slope comes with it."""
CarRow = tuple[int, int, int, int, Kind, int, int]
"""A row of ``Grid.cars``."""

WINDOW: Final = (13, 13, 6)
"""Cells of the world that all is drawn in: more than any rule looks at round the car in its middle."""
MIDDLE: Final = 6
"""Column and row of the acting car."""


@dataclass(frozen=True)
class Scenery:
    """Things and cars; the first car acts where it is the base of a situation."""

    things: tuple[Thing, ...] = ()
    cars: tuple[CarRow, ...] = ()

    def __add__(self, other: Scenery) -> Scenery:
        """Return both together."""
        return Scenery(self.things + other.things, self.cars + other.cars)

    def moved(self, dx: int, dy: int, dz: int) -> Scenery:
        """Return the same elsewhere."""
        return Scenery(
            tuple((kind, (x + dx, y + dy, z + dz), yaw) for kind, (x, y, z), yaw in self.things),
            tuple((x + dx, y + dy, z + dz, *row) for x, y, z, *row in self.cars),  # type: ignore[misc]
        )

    def parts(self, machines: Machines) -> list[Placement]:
        """Return where its parts stand, without what bears them, in a world with the acting car in the middle."""
        return placements(_placed(Grid.empty(WINDOW), self, supported=False), machines)


def draw(scenery: Scenery, around: Grid | None = None) -> Grid:
    """Return a world, empty unless given, with this scenery and stacks of blocks below all that needs them.

    Raises ImpossibleError where two things or cars would share a cell, or something would float.
    """
    grid = _placed(Grid.empty(WINDOW) if around is None else around.copy(), scenery)
    _hang_gears(grid)
    grid.derive_marks()
    return grid


def without(grid: Grid, taken: Scenery) -> Grid:
    """Return a world without the things and the last cars, those of a scenery; what stood below them stays."""
    less = replace(grid.copy(), cars=grid.cars[: grid.n_cars - len(taken.cars)].copy())
    for kind, cell, yaw in taken.things:
        for x, y, z in [cell, beside(cell, yaw)] if kind in SECOND_PART else [cell]:
            less.kind[x + MIDDLE, y + MIDDLE, z] = Kind.AIR
            less.yaw[x + MIDDLE, y + MIDDLE, z] = 0
    _hang_gears(less)
    less.derive_marks()
    return less


def _placed(grid: Grid, scenery: Scenery, supported: bool = True) -> Grid:
    for kind, cell, yaw in scenery.things:
        _put(grid, kind, cell, yaw)
        if kind == Kind.BODY:
            _put(grid, Kind.FOOT, beside(cell, yaw), yaw)
    rows = [(x + MIDDLE, y + MIDDLE, *row) for x, y, *row in scenery.cars]
    cars = [*grid.cars.tolist(), *rows]
    grid = replace(grid, cars=np.array(cars, np.int16).reshape(-1, len(CarField)))
    if supported:
        _support(grid, scenery, {(x, y, z) for x, y, z, *_ in cars})
    return grid


def _put(grid: Grid, kind: Kind, cell: Cell, yaw: int) -> None:
    x, y, z = cell[0] + MIDDLE, cell[1] + MIDDLE, cell[2]
    if z < 1 or grid.kind[x, y, z] not in (Kind.AIR, Kind.GEAR):
        raise ImpossibleError(
            "something would be in the ground" if z < 1 else "two things would share a cell"
        )
    grid.kind[x, y, z] = kind
    grid.yaw[x, y, z] = yaw % 4 if kind in KINDS_WITH_YAW else 0


def _support(grid: Grid, scenery: Scenery, cars: set[Cell]) -> None:
    """Put stacks of blocks below things and cars; walls may hang in the air."""
    if len(cars) < grid.n_cars:
        raise ImpossibleError("two cars would share a cell")
    for kind, (x, y, z), yaw in scenery.things:
        if kind in STANDS_ON and kind != Kind.WALL:
            _stack(grid, (x, y, z), cars)
        if kind == Kind.BODY:
            _stack(grid, beside((x, y, z), yaw), cars)
    for x, y, z, _, _, _, slope in scenery.cars:
        own = Kind(grid.kind[x + MIDDLE, y + MIDDLE, z])
        if slope == 0:
            _stack(grid, (x, y, z), cars)
            if own == Kind.FOOT:
                raise ImpossibleError("a car in a foot's cell is on the slope")


def _stack(grid: Grid, cell: Cell, cars: Iterable[Cell]) -> None:
    x, y, z = cell[0] + MIDDLE, cell[1] + MIDDLE, cell[2]
    if z < 1:
        raise ImpossibleError("something would be in the ground")
    for level in range(1, z):
        below = grid.kind[x, y, level]
        if below in (Kind.AIR, Kind.GEAR) and (x, y, level) not in cars:
            grid.kind[x, y, level] = Kind.BLOCK
            grid.yaw[x, y, level] = 0
        elif below != Kind.BLOCK:
            raise ImpossibleError("something would stand on nothing")


def _hang_gears(grid: Grid) -> None:
    """Show gears beside folded slopes; each gives way to what stands, and the greater yaw to the smaller."""
    length, width, _ = WINDOW
    for x, y, z in np.argwhere(grid.kind == Kind.FSLOPE).tolist():
        yaw = int(grid.yaw[x, y, z])
        gx, gy, gz = beside((x, y, z), yaw)
        there = grid.kind[gx, gy, gz] if 0 <= gx < length and 0 <= gy < width else Kind.WALL
        if there == Kind.AIR or (there == Kind.GEAR and yaw < grid.yaw[gx, gy, gz]):
            grid.kind[gx, gy, gz], grid.yaw[gx, gy, gz] = Kind.GEAR, yaw
