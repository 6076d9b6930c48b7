"""From a blueprint to a world: listed things in their places, the rest drawn at random."""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.documents import Source
from craftsim.discrete.files.listing import ListedObject, Listing
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import SECOND_PART, CarField, Cell, Grid, Kind, beside

Placement = Literal["sane", "published"]
"""How unlisted things are drawn.

Sane: any of the four yaws, no object on a listed car. Published: see docs/rules.md#placement.
"""

PUBLISHED_TRIES: Final = 999


def below(cell: Cell) -> Cell:
    """Return the cell under a cell."""
    return cell[0], cell[1], cell[2] - 1


def put(grid: Grid, cell: Cell, kind: Kind, yaw: int = 0) -> None:
    """Put something into a cell; its marks start blank."""
    grid.kind[cell] = kind
    grid.yaw[cell] = yaw
    grid.occupant[cell] = -1
    grid.landing[cell] = False


def put_object(grid: Grid, item: ListedObject) -> None:
    """Put a listed object in place with the marks that go with it; walls and gears leave none."""
    put(grid, item.cell, item.kind, item.yaw)
    if item.kind == Kind.WALL:
        return
    grid.occupant[below(item.cell)] = -2
    if item.kind in SECOND_PART:
        second = beside(item.cell, item.yaw)
        put(grid, second, SECOND_PART[item.kind], item.yaw)
    if item.kind == Kind.BODY:
        grid.occupant[below(second)] = -2
        landing = beside(item.cell, item.yaw + 2)
        if kind_of(grid, landing) == Kind.BLOCK:
            grid.landing[landing] = True


def kind_of(grid: Grid, cell: Cell) -> Kind:
    """Return what is in a cell; beside the map there is wall."""
    length, width, _ = grid.size
    if 0 <= cell[0] < length and 0 <= cell[1] < width:
        return Kind(grid.kind[cell])
    return Kind.WALL


class _Draw:
    """Draws free places at level 1."""

    def __init__(
        self, grid: Grid, blueprint: Listing, rng: np.random.Generator, placement: Placement
    ) -> None:
        self.grid = grid
        self.rng = rng
        self.sane = placement == "sane"
        self.source = Source(blueprint.path)
        self.used = np.zeros(grid.size[:2], np.bool_)
        self.cars = np.zeros(grid.size[:2], np.bool_)
        for item in blueprint.objects:
            self.used[item.cell[:2]] |= item.cell[2] == 1
        for car in blueprint.cars:
            self.cars[car.cell[:2]] |= car.cell[2] == 1

    def allowed(self, slope_yaw: int | None, for_car: bool) -> NDArray[np.bool_]:
        """Return (L, W): the columns where a thing can be put, a slope in the direction given."""
        length, width, _ = self.grid.size
        level = np.pad(self.grid.kind[:, :, 1], 1, constant_values=Kind.WALL)
        avoided = np.pad(self.used | self.cars if self.sane else np.zeros_like(self.used), 1)

        def neighbour(array: NDArray[Any], yaw: int) -> NDArray[Any]:
            dx, dy = DIRECTIONS[yaw % 4]
            return array[1 + dx : 1 + dx + length, 1 + dy : 1 + dy + width]

        free: NDArray[np.bool_] = (self.grid.kind[:, :, 1] == Kind.AIR) & ~self.used
        if self.sane or for_car:
            free &= ~self.cars
        if slope_yaw is not None:
            free &= (neighbour(level, slope_yaw) == Kind.AIR) & ~neighbour(avoided, slope_yaw)
            free &= neighbour(level, slope_yaw + 2) != Kind.WALL
        return free

    def place(self, what: str, slope: bool = False, for_car: bool = False) -> tuple[Cell, int]:
        """Return a free cell and a yaw, and count the cell as used; raise BlueprintError if there is none."""
        yaws = range(4 if self.sane else 3)
        if slope:
            allowed = np.array([self.allowed(yaw, for_car) for yaw in yaws])
        else:
            allowed = np.repeat(self.allowed(None, for_car)[None], len(yaws), axis=0)
        found = self._sane(allowed) if self.sane else self._published(allowed, slope)
        if found is None:
            self.source.fail(None, f"no room left for {what}")
        yaw, x, y = found
        self.used[x, y] = True
        return (x, y, 1), yaw

    def _sane(self, allowed: NDArray[np.bool_]) -> tuple[int, int, int] | None:
        free = np.flatnonzero(allowed)
        if not len(free):
            return None
        yaw, x, y = np.unravel_index(free[self.rng.integers(len(free))], allowed.shape)
        return int(yaw), int(x), int(y)

    def _published(self, allowed: NDArray[np.bool_], redraw_yaw: bool) -> tuple[int, int, int] | None:
        yaws, length, width = allowed.shape
        yaw = int(self.rng.integers(yaws))
        for _ in range(PUBLISHED_TRIES):
            x, y = int(self.rng.integers(length)), int(self.rng.integers(width))
            if allowed[yaw, x, y]:
                return yaw, x, y
            if redraw_yaw:
                yaw = int(self.rng.integers(yaws))
        return None


def build_grid(blueprint: Listing, rng: np.random.Generator, placement: Placement) -> Grid:
    """Return the start of a world as :meth:`craftsim.discrete.files.blueprint.Blueprint.grid` describes it."""
    grid = Grid.empty(blueprint.size, blueprint.n_cars)
    blocks = [item for item in blueprint.objects if item.kind == Kind.BLOCK]
    others = [item for item in blueprint.objects if item.kind != Kind.BLOCK]
    for item in [*sorted(blocks, key=lambda block: block.cell[2]), *others]:
        put_object(grid, item)
    for override in blueprint.snapshot.cells if blueprint.snapshot else ():
        put(grid, override.cell, override.kind, override.yaw)
    draw = _Draw(grid, blueprint, rng, placement)
    for _ in range(blueprint.n_slopes - blueprint.listed(Kind.FSLOPE, Kind.BODY)):
        cell, yaw = draw.place("a random folded slope", slope=True)
        put(grid, cell, Kind.FSLOPE, yaw)
        put(grid, beside(cell, yaw), Kind.GEAR, yaw)
    for _ in range(blueprint.n_blocks - blueprint.listed(Kind.BLOCK)):
        cell, _ = draw.place("a random block")
        put(grid, cell, Kind.BLOCK)
    _place_cars(grid, blueprint, draw)
    if blueprint.snapshot:
        for cell, mark in blueprint.snapshot.top:
            grid.occupant[cell] = mark
        for cell, mark in blueprint.snapshot.back:
            grid.landing[cell] = bool(mark)
    return grid


def _place_cars(grid: Grid, blueprint: Listing, draw: _Draw) -> None:
    listed = {car.car: car for car in blueprint.cars}
    for car in range(blueprint.n_cars):
        row = grid.cars[car]
        if car in listed:
            entry = listed[car]
            cell, yaw = entry.cell, entry.yaw
            row[CarField.LOAD] = entry.load
            row[CarField.LOAD_YAW] = entry.load_yaw
            row[CarField.SLOPE] = entry.slope
        else:
            cell, yaw = draw.place(f"car {car}", for_car=True)
        row[CarField.X], row[CarField.Y], row[CarField.Z], row[CarField.YAW] = *cell, yaw
        grid.occupant[below(cell)] = car
