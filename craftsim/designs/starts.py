"""Starts for designs: the blocks and slopes that a building takes, spread over the floor around its place, and cars."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.designs.spreading import Column, FreeFloor
from craftsim.discrete.files.blueprint import MAX_CELLS, MAX_SIDE
from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece, beside
from craftsim.discrete.grid_checks import check_size
from craftsim.errors import InputError
from craftsim.storage.limits import DESIGN_CELLS

MARGIN: Final = 3
"""Free cells around a building, unless said otherwise: a ramp takes two, and a car comes from the third."""
_TRIES: Final = 4
_SHARE: Final = 0.4
"""Of the free floor that things take at most where the size is to be found."""


@dataclass(frozen=True)
class Stock:
    """How many things a start has."""

    blocks: int
    slopes: int
    cars: int

    @classmethod
    def of(cls, design: Design, n_cars: int, spare_blocks: int = 0, spare_slopes: int = 0) -> Stock:
        """Return what a design takes, and more."""
        slopes = len(design.of_kind(Kind.BODY)) + len(design.of_kind(Kind.FSLOPE))
        return cls(len(design.of_kind(Kind.BLOCK)) + spare_blocks, slopes + spare_slopes, n_cars)

    @property
    def cells(self) -> int:
        """Cells of the floor that it takes."""
        return self.blocks + 2 * self.slopes + self.cars


@dataclass(frozen=True, eq=False)
class DesignStart:
    """A world in which a design can be built."""

    grid: Grid
    design: Design
    """Where it is to stand in the world."""


def make_start(
    design: Design,
    n_cars: int,
    rng: np.random.Generator,
    size: Cell | None = None,
    margin: int = MARGIN,
    spare_blocks: int = 0,
    spare_slopes: int | None = None,
    barrier: bool = False,
) -> DesignStart:
    """Return a world that has what a design takes, with the design in its middle.

    Blocks, folded slopes and cars are drawn at random on the floor beside the design's columns. The floor that they
    leave is in one piece, each of them touches it, and behind each slope, where a car backs in, is a free cell.

    Args:
        design: what is to be built.
        n_cars: number of cars.
        rng: draws the places.
        size: (L, W, H) of the area; the smallest that has room at ease unless given, a level higher than the design.
        margin: free cells around the design at least.
        spare_blocks: blocks beyond those of the design, to be built from and taken away again.
        spare_slopes: folded slopes beyond those of the design; one for each upper level that the design has no slope
            to unless given.
        barrier: whether walls stand from side to side of the area, across the middle of the design.

    Raises InputError, with what would do, where there is no room.
    """
    extent = design.size
    stock = Stock.of(design, n_cars, spare_blocks, _needed(design) if spare_slopes is None else spare_slopes)
    if size is None:
        size = _roomy(extent, margin, stock)
    check_size(size, n_cars)
    least = (extent[0] + 2 * margin, extent[1] + 2 * margin, extent[2])
    if any(side < needed for side, needed in zip(size, least, strict=True)):
        raise InputError(
            f"{design.path}: the area of {size} cells is too small for a design of {extent}; "
            f"allowed: at least {least} with a margin of {margin}"
        )
    placed = design.moved((size[0] - extent[0]) // 2, (size[1] - extent[1]) // 2)
    walls = _barrier(placed, size) if barrier else ()
    return DesignStart(spread(placed, size, stock, rng, walls=walls), placed)


def spread(
    design: Design,
    size: Cell,
    stock: Stock,
    rng: np.random.Generator,
    taken: Collection[Column] = (),
    clear: Collection[Column] = (),
    walls: Collection[Cell] = (),
    fits: Callable[[Grid], bool] | None = None,
) -> Grid:
    """Return a world with things spread on the floor beside a design's columns.

    Args:
        design: what is to be built, in its place.
        size: (L, W, H) of the area.
        stock: how many things.
        rng: draws the places.
        taken: columns that are left to other parts of the building, such as ramps that serve for building alone.
        clear: columns of the free floor that nothing is put on.
        walls: cells of walls.
        fits: whether slopes can be carried where they are to go, asked of each world in the making; unless given, a
            place is kept free where a car can turn with one.

    Raises InputError where there is no room.
    """
    if stock.blocks + stock.slopes > DESIGN_CELLS:
        raise InputError(
            f"{design.path}: {stock.blocks} blocks and {stock.slopes} slopes; allowed: {DESIGN_CELLS} together"
        )
    free = np.ones(size[:2], np.bool_)
    for column in [*(target.cell[:2] for target in design.targets), *taken, *(wall[:2] for wall in walls)]:
        free[column] = False
    for i in range(_TRIES):
        grid, floor = Grid.empty(size, stock.cars), FreeFloor(_outside(free))
        for cell in walls:
            grid.kind[cell] = Kind.WALL
        for column in clear:
            floor.keep(column)
        # At random as long as there is room for it, then close together.
        if stock.slopes and fits is None and not _keep_turning_place(floor, rng):
            break
        if _put(grid, floor, stock, rng, dense=i >= _TRIES // 2, fits=fits):
            grid.derive_marks()
            return grid
    raise InputError(
        f"{design.path}: no room for {stock.blocks} blocks, {stock.slopes} slopes and {stock.cars} cars beside the "
        f"design in an area of {size} cells; try a larger one, or fewer of them"
    )


def _outside(free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the largest piece of a free floor: what a court of the design holds could not come out any more."""
    from scipy.ndimage import label

    pieces, n = label(free)
    if n == 0:
        return free
    largest = 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))
    outside: NDArray[np.bool_] = pieces == largest
    return outside


def _keep_turning_place(floor: FreeFloor, rng: np.random.Generator) -> bool:
    """Keep the cells free where a car can turn with a slope; return whether there are such."""
    places = floor.turning_places()
    if not len(places):
        return False
    x, y = places[rng.integers(len(places))].tolist()
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            floor.keep((x + dx, y + dy))
    return True


def _put(
    grid: Grid,
    floor: FreeFloor,
    stock: Stock,
    rng: np.random.Generator,
    dense: bool,
    fits: Callable[[Grid], bool] | None,
) -> bool:
    """Put things on a floor, slopes first; return whether all found room."""
    slopes, blocks = stock.slopes, stock.blocks
    while slopes + blocks:
        before = slopes + blocks
        order = rng.permutation(floor.free.size)
        if dense:
            order = order[np.argsort(floor.neighbours().ravel()[order], kind="stable")]
        for index in order.tolist():
            cell = (*divmod(index, floor.free.shape[1]), 1)
            if slopes:
                yaws = rng.permutation(4).tolist()
                slopes -= any(_put_thing(grid, floor, cell, yaw, fits) for yaw in yaws)
            elif blocks:
                blocks -= _put_thing(grid, floor, cell, None, fits)
        if slopes + blocks == before:
            return False
    places = rng.permutation(np.argwhere(floor.free))
    if len(places) < stock.cars:
        return False
    for car, (x, y) in zip(grid.cars, places.tolist(), strict=False):
        car[CarField.X], car[CarField.Y], car[CarField.YAW] = x, y, rng.integers(4)
    return True


def _put_thing(
    grid: Grid, floor: FreeFloor, cell: Cell, yaw: int | None, fits: Callable[[Grid], bool] | None
) -> bool:
    """Put a block, or with a yaw a folded slope, where there is room for all of it and the car that backs into it."""
    piece, behind = Piece(Kind.BLOCK, cell), None
    if yaw is not None:
        piece, behind = Piece(Kind.FSLOPE, cell, yaw), beside(cell, yaw + 2)
        if not all(map(grid.inside, (*piece.cells, behind))):
            return False
    columns = [part[:2] for part in piece.cells]
    if (behind is not None and not floor.free[behind[:2]]) or not floor.take(*columns):
        return False
    grid.put(piece)
    if fits is not None and not fits(grid):
        grid.take(cell)
        floor.give_back(*columns)
        return False
    if behind is not None:
        floor.keep(behind[:2])
    return True


def _needed(design: Design) -> int:
    """Return on how many upper levels a design has blocks, but no slope of its own to them."""
    ramps = {cell[2] + 1 for cell in design.of_kind(Kind.BODY)}
    return len({cell[2] for cell in design.of_kind(Kind.BLOCK) if cell[2] > 1} - ramps)


def _roomy(extent: Cell, margin: int, stock: Stock) -> Cell:
    """Return the size of the smallest area with a margin in which things do not take too much of the floor."""
    length, width = extent[0] + 2 * margin, extent[1] + 2 * margin
    while stock.cells > _SHARE * (length * width - extent[0] * extent[1]) and max(length, width) < MAX_SIDE:
        length, width = length + 1, width + 1
    height = min(extent[2] + 1, MAX_CELLS // (length * width))
    return length, width, max(height, extent[2])


def _barrier(design: Design, size: Cell) -> list[Cell]:
    """Return walls from side to side, but for the design's columns, halfway along the design."""
    columns = {target.cell[:2] for target in design.targets}
    x = (min(x for x, _ in columns) + max(x for x, _ in columns)) // 2
    return [(x, y, 1) for y in range(size[1]) if (x, y) not in columns]
