"""From a drawing to a world: checks that it makes sense, listed things in their places, the rest drawn at random."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import CarField, CarRow, Cell, Grid, Kind, Piece, beside
from craftsim.discrete.kinds import NAMES
from craftsim.storage.records import Loc, Mistake
from craftsim.storage.yaml import Document

Placement = Literal["sane", "published"]
"""Way in which unlisted things are drawn.

Sane: any of the four yaws, no object on a listed car. Published: see docs/rules.md#placement.
"""

_PUBLISHED_TRIES: Final = 999


def put_objects(grid: Grid, objects: Iterable[Piece]) -> None:
    """Put objects into a bare world with the marks that go with them; walls leave none."""
    # What is put into a cell blanks its marks, so the lower blocks come first.
    above = grid.size[2] + 1

    def height(item: Piece) -> int:
        if item.kind == Kind.BLOCK:
            return item.cell[2]
        return above

    for piece in sorted(objects, key=height):
        grid.put(piece)
        if piece.kind == Kind.WALL:
            continue
        grid.occupant[_below(piece.cell)] = -2
        if piece.kind == Kind.BODY:
            grid.occupant[_below(piece.cells[1])] = -2
            landing = beside(piece.cell, piece.yaw + 2)
            if grid.inside(landing) and grid.kind[landing] == Kind.BLOCK:
                grid.landing[landing] = True


def _below(cell: Cell) -> Cell:
    return cell[0], cell[1], cell[2] - 1


def free_floor(kind: NDArray[np.int16], slope: bool) -> NDArray[np.bool_]:
    """Return (B, 1, L, W): where a thing has room on the floor of B worlds, of which ``kind`` is (B, L, W).

    For a folded slope (B, 4, L, W), by its yaw: its gear needs the next cell, and no wall is behind it.
    """
    free: NDArray[np.bool_] = (kind == Kind.AIR)[:, None]
    if slope:
        free = free & (_beside_each(kind, 1, Kind.WALL) == Kind.AIR)
        free &= _beside_each(kind, -1, Kind.WALL) != Kind.WALL
    return free


def _beside_each(array: NDArray[Any], sign: int, edge: int) -> NDArray[Any]:
    """Return (B, 4, L, W): what an array (B, L, W) has ahead of each cell in each yaw, with sign -1 behind it.

    ``edge`` is what is beside the map.
    """
    _, length, width = array.shape
    around = np.pad(array, ((0, 0), (1, 1), (1, 1)), constant_values=edge)
    steps = [(1 + sign * dx, 1 + sign * dy) for dx, dy in DIRECTIONS.tolist()]
    return np.stack([around[:, x : x + length, y : y + width] for x, y in steps], axis=1)


def _choose_sane(free: NDArray[np.bool_], rng: np.random.Generator) -> tuple[int, int, int] | None:
    """Return a yaw, x and y of (yaws, L, W), all that are free as likely; None where none is."""
    places = np.flatnonzero(free)
    if not len(places):
        return None
    yaw, x, y = np.unravel_index(places[rng.integers(len(places))], free.shape)
    return int(yaw), int(x), int(y)


def _choose_published(
    free: NDArray[np.bool_], rng: np.random.Generator, redraw_yaw: bool
) -> tuple[int, int, int] | None:
    """Return the same as CraftEnv draws it: place after place until one is free."""
    yaws, length, width = free.shape
    yaw = int(rng.integers(yaws))
    for _ in range(_PUBLISHED_TRIES):
        x = int(rng.integers(length))
        y = int(rng.integers(width))
        if free[yaw, x, y]:
            return yaw, x, y
        if redraw_yaw:
            yaw = int(rng.integers(yaws))
    return None


def draw_place(
    grid: Grid,
    cars: NDArray[np.bool_],
    rng: np.random.Generator,
    placement: Placement,
    item: Kind | Literal["car"],
) -> tuple[Cell, int] | None:
    """Return a random free cell on the floor and a yaw for a block, a folded slope or a car; None if there is none.

    ``cars`` is (L, W): the columns in which cars stand on the floor.
    """
    sane = placement == "sane"
    is_slope = item == Kind.FSLOPE
    free = free_floor(grid.kind[None, ..., 1], is_slope)[0]
    if sane or item == "car":
        free = free & ~cars
    if sane and is_slope:
        free &= ~_beside_each(cars[None], 1, False)[0]
    free = np.broadcast_to(free, (4, *cars.shape))
    if sane:
        chosen = _choose_sane(free, rng)
    else:
        chosen = _choose_published(free[:3], rng, is_slope)
    if chosen is None:
        return None
    yaw, x, y = chosen
    return (x, y, 1), yaw


# Checks of a drawing: one thing in a cell, everything stands on something, cars fit where they are.

Located = Sequence[tuple[Loc, Piece]]
"""Things, each with its place in the file."""
LocatedCars = Sequence[tuple[int, Loc, CarRow]]
"""Cars by number."""


def check_sense(
    document: Document, size: Cell, objects: Located, cars: LocatedCars, goal: Cell | None
) -> None:
    """Raise the document's error for a drawing that contradicts itself; all things lie in the area."""
    document.refuse(_shared_cells(document, objects))
    grid = Grid.empty(size)
    for _, piece in objects:
        grid.put(piece)
    document.refuse(_floating(grid, objects))
    document.refuse(_misplaced(document, grid, cars))
    if goal is not None and grid.kind[goal] == Kind.WALL:
        loc = next(loc for loc, piece in objects if piece.cell == goal)
        document.fail(loc, f"the goal {goal} is inside a wall")


def outside(size: Cell, objects: Located) -> Iterator[Mistake]:
    """Yield the things that reach out of the area."""
    length, width, height = size
    for loc, piece in objects:
        for cell, kind in zip(piece.cells, piece.kinds, strict=True):
            if not (0 <= cell[0] < length and 0 <= cell[1] < width and 1 <= cell[2] <= height):
                yield loc, f"{NAMES[kind]} would be at {cell}, outside the area of {size} cells"


def _shared_cells(document: Document, objects: Located) -> Iterator[Mistake]:
    """Yield the things in whose cells others are."""
    filled: dict[Cell, tuple[Loc, Kind, int]] = {}
    for loc, piece in objects:
        for cell, kind in zip(piece.cells, piece.kinds, strict=True):
            other_loc, other_kind, yaw = filled.get(cell, (loc, Kind.AIR, 0))
            # Two folded slopes may face each other with their gears in one cell: play leads there.
            if other_kind != Kind.AIR and not (
                other_kind == kind == Kind.GEAR and yaw == (piece.yaw + 2) % 4
            ):
                line = document.lines.get(other_loc)
                yield (
                    loc,
                    f"{NAMES[kind]} would be at {cell}, where {NAMES[other_kind]} is already (line {line}); "
                    "allowed: one thing a cell",
                )
            filled[cell] = loc, kind, piece.yaw


def _stands(grid: Grid, cell: Cell) -> bool:
    """Return whether there is ground or a block below a cell."""
    return grid.kind[cell[0], cell[1], cell[2] - 1] in (Kind.GROUND, Kind.BLOCK)


def _floating(grid: Grid, objects: Located) -> Iterator[Mistake]:
    """Yield the things that float; walls and gears may."""
    for loc, piece in objects:
        for cell, kind in zip(piece.cells, piece.kinds, strict=True):
            if kind not in (Kind.WALL, Kind.GEAR) and not _stands(grid, cell):
                yield loc, f"{NAMES[kind]} at {cell} floats; allowed: on the ground or on a block"


def _misplaced(document: Document, grid: Grid, cars: LocatedCars) -> Iterator[Mistake]:
    """Yield the cars that cannot be where they are, and those that share a cell."""
    occupied: dict[Cell, tuple[Loc, int]] = {}
    for car, loc, row in cars:
        cell = row[0], row[1], row[2]
        wrong = _wrong_with(grid, cell, row)
        if wrong:
            yield loc, f"car {car} at {cell}{wrong}"
        first, other_car = occupied.setdefault(cell, (loc, car))
        if other_car != car:
            yield (
                loc,
                f"car {car} is at {cell}, where car {other_car} is (line {document.lines.get(first)})",
            )


def _wrong_with(grid: Grid, cell: Cell, row: CarRow) -> str:
    """Return why a car cannot stand in a cell, or fit a slope or load there; empty if it can."""
    yaw, load, load_yaw, slope = row[CarField.YAW :]
    x, y, z = cell
    kind = grid.kind_at(cell)
    body = (x, y, z - 1)
    along = 0
    if slope == 2:
        along = int(grid.yaw[body])
    elif grid.inside(cell):
        along = int(grid.yaw[cell])
    up = (along + 2) % 4
    gear = beside(cell, load_yaw)
    if kind == Kind.WALL:
        return " is inside a wall"
    if slope == 2 and grid.kind[body] != Kind.BODY:
        return ": slope 2 needs the body of a slope below the car"
    if slope != 2 and not _stands(grid, cell):
        return " stands in the air; allowed: on the ground or on a block"
    if (slope == 1) != (kind == Kind.FOOT):
        return ": slope 1 and a slope's foot in its cell need each other"
    if slope and (yaw - along) % 2:
        return f": yaw {yaw} is across the slope; allowed: {along}, {up}"
    if kind in (Kind.FSLOPE, Kind.BODY) and yaw != up:
        return f": yaw {yaw} under a slope; allowed: {up}, away from its gear or foot"
    if load != Kind.AIR and kind not in (Kind.AIR, Kind.GEAR, Kind.FOOT):
        return f": carries a load, but {NAMES[kind]} is in its cell"
    if load == Kind.FSLOPE and load_yaw != (yaw + 2) % 4:
        return f": load_yaw {load_yaw}; allowed: {(yaw + 2) % 4}, behind the car"
    if load == Kind.FSLOPE and not grid.inside((gear[0], gear[1], 1)):
        return f": the gear of its slope would be at {gear}, outside the area of {grid.size} cells"
    return ""
