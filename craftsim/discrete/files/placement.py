"""From a blueprint to a world: listed things in their places, the rest drawn at random."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import Cell, Grid, Kind, Piece, beside
from craftsim.errors import BlueprintError

if TYPE_CHECKING:
    from craftsim.discrete.files.blueprint import Blueprint

Placement = Literal["sane", "published"]
"""How unlisted things are drawn.

Sane: any of the four yaws, no object on a listed car. Published: see docs/rules.md#placement.
"""

PUBLISHED_TRIES: Final = 999


def _stand(grid: Grid, objects: Iterable[Piece]) -> None:
    """Put objects into a bare world with the marks that go with them; walls leave none."""
    # What is put into a cell blanks its marks, so the lower blocks come first.
    above = grid.size[2] + 1
    for piece in sorted(objects, key=lambda one: one.cell[2] if one.kind == Kind.BLOCK else above):
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
        free = free & (beside_each(kind, 1, Kind.WALL) == Kind.AIR)
        free &= beside_each(kind, -1, Kind.WALL) != Kind.WALL
    return free


def beside_each(array: NDArray[Any], sign: int, edge: int) -> NDArray[Any]:
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
    for _ in range(PUBLISHED_TRIES):
        x, y = int(rng.integers(length)), int(rng.integers(width))
        if free[yaw, x, y]:
            return yaw, x, y
        if redraw_yaw:
            yaw = int(rng.integers(yaws))
    return None


def build_grid(blueprint: Blueprint, rng: np.random.Generator, placement: Placement) -> Grid:
    """Return the start of a world as :meth:`craftsim.discrete.files.blueprint.Blueprint.grid` describes it."""
    grid, sane = Grid.empty(blueprint.size, blueprint.n_cars), placement == "sane"
    _stand(grid, blueprint.objects)
    for piece in blueprint.snapshot.pieces if blueprint.snapshot else ():
        grid.cells[piece.cell] = (piece.kind, piece.yaw, -1, 0)
    cars = np.zeros(grid.size[:2], np.bool_)
    for x, y, z, *_ in blueprint.cars.values():
        cars[x, y] |= z == 1

    def place(what: str, slope: bool = False, for_car: bool = False) -> tuple[Cell, int]:
        """Return a free cell on the floor and a yaw; raise BlueprintError if there is none."""
        free = free_floor(grid.kind[None, ..., 1], slope)[0]
        if sane or for_car:
            free = free & ~cars
        if sane and slope:
            free &= ~beside_each(cars[None], 1, False)[0]
        free = np.broadcast_to(free, (4, *cars.shape))
        found = _choose_sane(free, rng) if sane else _choose_published(free[:3], rng, slope)
        if found is None:
            raise BlueprintError(f"{blueprint.path}: no room left for {what}")
        yaw, x, y = found
        return (x, y, 1), yaw

    for _ in range(blueprint.n_slopes - blueprint.listed(Kind.FSLOPE, Kind.BODY)):
        cell, yaw = place("a random folded slope", slope=True)
        grid.put(Piece(Kind.FSLOPE, cell, yaw))
    for _ in range(blueprint.n_blocks - blueprint.listed(Kind.BLOCK)):
        cell, _ = place("a random block")
        grid.put(Piece(Kind.BLOCK, cell))
    for car in range(blueprint.n_cars):
        row = blueprint.cars.get(car)
        if row is None:
            cell, yaw = place(f"car {car}", for_car=True)
            row = (*cell, yaw, Kind.AIR, 0, 0)
            cars[cell[:2]] = True
        grid.cars[car] = row
        grid.occupant[row[0], row[1], row[2] - 1] = car
    if blueprint.snapshot:
        for entry in blueprint.snapshot.top:
            grid.occupant[entry.cell] = entry.mark
        for entry in blueprint.snapshot.back:
            grid.landing[entry.cell] = entry.mark
    return grid
