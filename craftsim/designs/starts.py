"""Starts for designs: the blocks and slopes that a building takes, spread over the floor around its place, and cars.

A car can get at each thing, and away with it: the free floor stays in one piece, and everything touches it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import (
    MAX_CELLS,
    MAX_SIDE,
    CarField,
    Cell,
    Grid,
    Kind,
    Piece,
    beside,
    check_size,
)
from craftsim.errors import InputError
from craftsim.storage.limits import DESIGN_CELLS

FloorColumn = tuple[int, int]
"""(x, y)."""
FloorMask = NDArray[np.bool_]
"""(L, W)."""

BUILDING_MARGIN: Final = 3
"""Free cells around a building, unless said otherwise: a ramp takes two, and a car comes from the third."""
_TRIES: Final = 4
_SHARE: Final = 0.4
"""Largest share of the free floor that objects take where the area is not given."""
_AROUND: Final = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
"""The eight neighbours in a circle; those with an edge in common are the even ones."""


@dataclass(frozen=True, eq=False)
class DesignStart:
    """A world in which a design can be built."""

    grid: Grid
    design: Design
    """The design, in its place in the world."""
    steps: tuple[Piece, ...] = ()
    """Blocks and ramps of a random design, those too that serve for building alone, in an order in which each can be
    put there."""


def make_start(
    design: Design,
    n_cars: int,
    rng: np.random.Generator,
    size: Cell | None = None,
    margin: int = BUILDING_MARGIN,
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
    if spare_slopes is None:
        levels = {cell[2] for cell in design.of_kind(Kind.BLOCK)} - {1}
        for cell in design.of_kind(Kind.BODY):
            levels.discard(cell[2] + 1)
        spare_slopes = len(levels)
    if size is None:
        n_blocks, n_slopes = _things(design, spare_blocks, spare_slopes)
        size = _roomy(design, margin, n_blocks + 2 * n_slopes + n_cars, barrier)
    check_size(size, n_cars)
    smallest = (extent[0] + 2 * margin, extent[1] + 2 * margin, extent[2])
    if any(side < required for side, required in zip(size, smallest, strict=True)):
        raise InputError(
            f"{design.path}: the area of {size} cells is too small for a design of {extent}; "
            f"allowed: at least {smallest} with a margin of {margin}"
        )
    placed, walls = _place(design, size, barrier)
    grid = spread_things(placed, size, n_cars, rng, spare_blocks, spare_slopes, walls=walls)
    return DesignStart(grid, placed)


def _place(design: Design, size: Cell, barrier: bool) -> tuple[Design, list[Cell]]:
    """Return a design in the middle of an area of a size, and the cells of a barrier's walls."""
    placed = design.moved((size[0] - design.size[0]) // 2, (size[1] - design.size[1]) // 2)
    columns = {target.cell[:2] for target in placed.targets}
    x = (min(columns)[0] + max(columns)[0]) // 2
    walls = []
    if barrier:
        for y in range(size[1]):
            if (x, y) not in columns:
                walls.append((x, y, 1))
    return placed, walls


def spread_things(
    design: Design,
    size: Cell,
    n_cars: int,
    rng: np.random.Generator,
    spare_blocks: int = 0,
    spare_slopes: int = 0,
    reserved: Collection[FloorColumn] = (),
    clear: Collection[FloorColumn] = (),
    walls: Collection[Cell] = (),
    fits: Callable[[Grid], bool] | None = None,
) -> Grid:
    """Return a world with things spread on the floor beside a design's columns.

    The design is in its place. Columns that are ``reserved`` are left to other parts of the building, such as ramps
    that serve for building alone, and nothing is put on those that are to be ``clear``. ``fits`` tells of each world in
    the making whether slopes can be carried where they are to go; unless given, a place is kept free where a car can
    turn with one. Raises InputError where there is no room.
    """
    n_blocks, n_slopes = _things(design, spare_blocks, spare_slopes)
    if n_blocks + n_slopes > DESIGN_CELLS:
        raise InputError(
            f"{design.path}: {n_blocks} blocks and {n_slopes} slopes; allowed: {DESIGN_CELLS} together"
        )
    outside = _outside(design, size, reserved, walls)
    for i in range(_TRIES):
        grid = Grid.empty(size, n_cars)
        floor = FreeFloor(outside)
        for cell in walls:
            grid.kind[cell] = Kind.WALL
        for column in clear:
            floor.keep(column)
        # At random as long as there is room for it, then close together.
        if n_slopes and fits is None and not floor.keep_turning_place(rng):
            break
        if _put(grid, floor, n_blocks, n_slopes, rng, dense=i >= _TRIES // 2, fits=fits):
            grid.derive_marks()
            return grid
    raise InputError(
        f"{design.path}: no room for {n_blocks} blocks, {n_slopes} slopes and {n_cars} cars beside the "
        f"design in an area of {size} cells; try a larger one, or fewer of them"
    )


def _outside(
    design: Design, size: Cell, reserved: Collection[FloorColumn] = (), walls: Collection[Cell] = ()
) -> FloorMask:
    """Return (L, W): the largest piece of the free floor; what a court of the design holds could not come out."""
    free = np.ones(size[:2], np.bool_)
    for target in design.targets:
        free[target.cell[:2]] = False
    for column in reserved:
        free[column] = False
    for wall in walls:
        free[wall[:2]] = False
    pieces, _ = label_pieces(free)
    outside: FloorMask = pieces == 1 + np.argmax(np.bincount(pieces.ravel(), minlength=2)[1:])
    return outside


def label_pieces(mask: FloorMask) -> tuple[NDArray[np.int32], int]:
    """Return (L, W): the number, from 1, of the piece that a cell is in, and how many pieces there are."""
    from scipy.ndimage import label

    pieces: tuple[NDArray[np.int32], int] = label(mask)
    return pieces


def _put(
    grid: Grid,
    floor: FreeFloor,
    blocks: int,
    slopes: int,
    rng: np.random.Generator,
    dense: bool,
    fits: Callable[[Grid], bool] | None,
) -> bool:
    """Put things on a floor, slopes first; return whether all found room."""
    while slopes + blocks:
        before = slopes + blocks
        order = rng.permutation(floor.free.size)
        if dense:
            order = order[np.argsort(floor.neighbours(_AROUND[::2]).ravel()[order], kind="stable")]
        for index in order.tolist():
            cell = (*divmod(index, floor.free.shape[1]), 1)
            if slopes:
                for yaw in rng.permutation(4).tolist():
                    if _put_thing(grid, floor, Piece(Kind.FSLOPE, cell, yaw), fits):
                        slopes -= 1
                        break
            elif blocks:
                blocks -= _put_thing(grid, floor, Piece(Kind.BLOCK, cell), fits)
        if slopes + blocks == before:
            return False
    places = rng.permutation(np.argwhere(floor.free))
    if len(places) < grid.n_cars:
        return False
    for car, (x, y) in zip(grid.cars, places.tolist(), strict=False):
        car[CarField.X] = x
        car[CarField.Y] = y
        car[CarField.YAW] = rng.integers(4)
    return True


def _put_thing(
    grid: Grid, floor: FreeFloor, piece: Piece, fits: Callable[[Grid], bool] | None
) -> bool:
    """Put a block, or a folded slope, where there is room for all of it and the car that backs into it."""
    backing = []
    if piece.kind == Kind.FSLOPE:
        backing = [beside(piece.cell, piece.yaw + 2)]
    parts = [*piece.cells, *backing]
    columns = [covered[:2] for covered in piece.cells]
    if not (
        all(map(grid.inside, parts))
        and all(floor.free[column_cell[:2]] for column_cell in backing)
        and floor.take(*columns)
    ):
        return False
    grid.put(piece)
    if fits is not None and not fits(grid):
        grid.take(piece.cell)
        floor.give_back(*columns)
        return False
    for cell in backing:
        floor.keep(cell[:2])
    return True


def _things(design: Design, spare_blocks: int, spare_slopes: int) -> tuple[int, int]:
    """Return how many blocks and slopes a start has: those that a design takes, and more."""
    n_slopes = len(design.of_kind(Kind.BODY)) + len(design.of_kind(Kind.FSLOPE))
    return len(design.of_kind(Kind.BLOCK)) + spare_blocks, n_slopes + spare_slopes


def _roomy(design: Design, margin: int, cells: int, barrier: bool) -> Cell:
    """Return the size of the smallest area with a margin in which so many cells do not take too much of the floor."""
    extent = design.size
    length = extent[0] + 2 * margin
    width = extent[1] + 2 * margin
    while max(length, width) < MAX_SIDE:
        free = length * width - extent[0] * extent[1]
        if barrier:
            # Things lie on one side of the walls.
            placed, walls = _place(design, (length, width, extent[2]), barrier)
            free = int(_outside(placed, (length, width, extent[2]), walls=walls).sum())
        if cells <= _SHARE * free:
            break
        length += 1
        width += 1
    height = min(extent[2] + 1, MAX_CELLS // (length * width))
    return length, width, max(height, extent[2])


class FreeFloor:
    """A floor on which things take cells.

    Whether a cell can be taken is seen from the eight around it alone: those of its free neighbours that are joined
    there stay joined.
    """

    def __init__(self, free: FloorMask) -> None:
        """Take (L, W): where things may be put, and cars drive; beside it is nothing."""
        # A border saves all tests for the edge.
        self._free = np.pad(free, 1)
        self._kept = np.zeros_like(self._free)
        self._things = np.zeros_like(self._free)

    @property
    def free(self) -> FloorMask:
        """(L, W): what is free still."""
        return self._free[1:-1, 1:-1]

    def keep(self, column: FloorColumn) -> None:
        """Let a free cell stay so."""
        self._kept[column[0] + 1, column[1] + 1] = True

    def keep_turning_place(self, rng: np.random.Generator) -> bool:
        """Keep nine cells free, where a car can turn with a slope; return whether there are such."""
        places = np.argwhere(self.free & (self.neighbours(_AROUND) == len(_AROUND)))
        if not len(places):
            return False
        x, y = places[rng.integers(len(places))].tolist()
        self._kept[x : x + 3, y : y + 3] = True
        return True

    def neighbours(self, around: Sequence[FloorColumn]) -> NDArray[np.int64]:
        """Return (L, W): how many of the cells in some places beside each are free."""
        length, width = self.free.shape
        counts = np.zeros(self.free.shape, np.int64)
        for dx, dy in around:
            counts += self._free[1 + dx : 1 + dx + length, 1 + dy : 1 + dy + width]
        return counts

    def take(self, *columns: FloorColumn) -> bool:
        """Take cells for one thing, the first of which a car must get at; return whether that was possible."""
        before = self._free.copy()
        went = all(map(self._go, columns))
        if went and self._touched(columns[0]) and all(map(self._leaves_touched, columns)):
            self._things[columns[0][0] + 1, columns[0][1] + 1] = True
            return True
        self._free = before
        return False

    def give_back(self, *columns: FloorColumn) -> None:
        """Free the cells of a thing again that were taken last."""
        for x, y in columns:
            self._free[x + 1, y + 1] = True
            self._things[x + 1, y + 1] = False

    def _go(self, column: FloorColumn) -> bool:
        """Take a cell if it is free, not kept, and no bridge between parts of the free floor."""
        x = column[0] + 1
        y = column[1] + 1
        if not self._free[x, y] or self._kept[x, y]:
            return False
        circle = [bool(self._free[x + dx, y + dy]) for dx, dy in _AROUND]
        # A free neighbour begins a new piece where the way back around the circle to the last one is not free.
        pieces = sum(circle[i] and not (circle[i - 1] and circle[i - 2]) for i in range(0, 8, 2))
        self._free[x, y] = pieces > 1 or not any(circle[::2])
        return not self._free[x, y]

    def _leaves_touched(self, column: FloorColumn) -> bool:
        """Return whether the things beside a cell that is taken touch the free floor still."""
        for dx, dy in _AROUND[::2]:
            x = column[0] + dx
            y = column[1] + dy
            if self._things[x + 1, y + 1] and not self._touched((x, y)):
                return False
        return True

    def _touched(self, column: FloorColumn) -> bool:
        x = column[0] + 1
        y = column[1] + 1
        return any(self._free[x + dx, y + dy] for dx, dy in _AROUND[::2])
