"""Checks of a drawing: one thing in a cell, everything stands on something, cars fit where they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece, beside
from craftsim.discrete.kinds import NAMES
from craftsim.storage.records import Loc, Mistake
from craftsim.storage.yaml import Document

CarRow = tuple[int, ...]
"""A row of :attr:`Grid.cars`."""
Located = Sequence[tuple[Loc, Piece]]
"""Things, each with its place in the file."""
LocatedCars = Sequence[tuple[int, Loc, CarRow]]
"""Cars by number."""


def check_sense(
    document: Document, size: Cell, things: Located, cars: LocatedCars, goal: Cell | None
) -> None:
    """Raise the document's error for a drawing that contradicts itself; all things lie in the area."""
    document.refuse(_shared_cells(document, things))
    grid = Grid.empty(size)
    for _, piece in things:
        grid.put(piece)
    document.refuse(_floating(grid, things))
    document.refuse(_misplaced(document, grid, cars))
    if goal is not None and grid.kind[goal] == Kind.WALL:
        loc = next(loc for loc, piece in things if piece.cell == goal)
        document.fail(loc, f"the goal {goal} is inside a wall")


def outside(size: Cell, things: Located) -> Iterator[Mistake]:
    """Yield the things that reach out of the area."""
    length, width, height = size
    for loc, piece in things:
        for cell, kind in zip(piece.cells, piece.kinds, strict=True):
            if not (0 <= cell[0] < length and 0 <= cell[1] < width and 1 <= cell[2] <= height):
                yield loc, f"{NAMES[kind]} would be at {cell}, outside the area of {size} cells"


def _shared_cells(document: Document, things: Located) -> Iterator[Mistake]:
    """Yield the things in whose cells others are."""
    taken: dict[Cell, tuple[Loc, Kind, int]] = {}
    for loc, piece in things:
        for cell, kind in zip(piece.cells, piece.kinds, strict=True):
            other, there, yaw = taken.get(cell, (loc, Kind.AIR, 0))
            # Two folded slopes may face each other with their gears in one cell: play leads there.
            if there != Kind.AIR and not (there == kind == Kind.GEAR and yaw == (piece.yaw + 2) % 4):
                line = document.lines.get(other)
                yield (
                    loc,
                    f"{NAMES[kind]} would be at {cell}, where {NAMES[there]} is already (line {line}); "
                    "allowed: one thing a cell",
                )
            taken[cell] = loc, kind, piece.yaw


def _stands(grid: Grid, cell: Cell) -> bool:
    """Return whether there is ground or a block below a cell."""
    return grid.kind[cell[0], cell[1], cell[2] - 1] in (Kind.GROUND, Kind.BLOCK)


def _floating(grid: Grid, things: Located) -> Iterator[Mistake]:
    """Yield the things that float; walls and gears may."""
    for loc, piece in things:
        for cell, kind in zip(piece.cells, piece.kinds, strict=True):
            if kind not in (Kind.WALL, Kind.GEAR) and not _stands(grid, cell):
                yield loc, f"{NAMES[kind]} at {cell} floats; allowed: on the ground or on a block"


def _misplaced(document: Document, grid: Grid, cars: LocatedCars) -> Iterator[Mistake]:
    """Yield the cars that cannot be where they are, and those that share a cell."""
    taken: dict[Cell, tuple[Loc, int]] = {}
    for car, loc, row in cars:
        cell = row[0], row[1], row[2]
        if wrong := _wrong_with(grid, cell, row):
            yield loc, f"car {car} at {cell}{wrong}"
        first, other = taken.setdefault(cell, (loc, car))
        if other != car:
            yield loc, f"car {car} is at {cell}, where car {other} is (line {document.lines.get(first)})"


def _wrong_with(grid: Grid, cell: Cell, row: CarRow) -> str:
    """Return why a car cannot stand in a cell, or fit a slope or load there; empty if it can."""
    yaw, load, load_yaw, slope = row[CarField.YAW :]
    x, y, z = cell
    own, body = grid.kind_at(cell), (x, y, z - 1)
    along = int(grid.yaw[body if slope == 2 else cell]) if slope == 2 or grid.inside(cell) else 0
    up = (along + 2) % 4
    gear = beside(cell, load_yaw)
    if own == Kind.WALL:
        return " is inside a wall"
    if slope == 2 and grid.kind[body] != Kind.BODY:
        return ": slope 2 needs the body of a slope below the car"
    if slope != 2 and not _stands(grid, cell):
        return " stands in the air; allowed: on the ground or on a block"
    if (slope == 1) != (own == Kind.FOOT):
        return ": slope 1 and a slope's foot in its cell need each other"
    if slope and (yaw - along) % 2:
        return f": yaw {yaw} is across the slope; allowed: {along}, {up}"
    if own in (Kind.FSLOPE, Kind.BODY) and yaw != up:
        return f": yaw {yaw} under a slope; allowed: {up}, away from its gear or foot"
    if load != Kind.AIR and own not in (Kind.AIR, Kind.GEAR, Kind.FOOT):
        return f": carries a load, but {NAMES[own]} is in its cell"
    if load == Kind.FSLOPE and load_yaw != (yaw + 2) % 4:
        return f": load_yaw {load_yaw}; allowed: {(yaw + 2) % 4}, behind the car"
    if load == Kind.FSLOPE and not grid.inside((gear[0], gear[1], 1)):
        return f": the gear of its slope would be at {gear}, outside the area of {grid.size} cells"
    return ""
