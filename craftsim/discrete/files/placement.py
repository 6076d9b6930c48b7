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


class _Draw:
    """Draws free places at level 1."""

    def __init__(
        self, grid: Grid, blueprint: Blueprint, rng: np.random.Generator, placement: Placement
    ) -> None:
        self.grid = grid
        self.rng = rng
        self.sane = placement == "sane"
        self.path = blueprint.path
        self.used = np.zeros(grid.size[:2], np.bool_)
        self.cars = np.zeros(grid.size[:2], np.bool_)
        for item in blueprint.objects:
            self.used[item.cell[:2]] |= item.cell[2] == 1
        for x, y, z, *_ in blueprint.cars.values():
            self.cars[x, y] |= z == 1

    def place(self, what: str, slope: bool = False, for_car: bool = False) -> tuple[Cell, int]:
        """Return a free cell and a yaw, and count the cell as used; raise BlueprintError if there is none."""
        yaws = 4 if self.sane else 3
        free = free_floor(self.grid.kind[None, ..., 1], slope)[0, :yaws] & ~self.used
        if self.sane or for_car:
            free &= ~self.cars
        if slope and self.sane:
            free &= ~beside_each((self.used | self.cars)[None], 1, False)[0]
        allowed = np.broadcast_to(free, (yaws, *self.used.shape))
        found = self._sane(allowed) if self.sane else self._published(allowed, slope)
        if found is None:
            raise BlueprintError(f"{self.path}: no room left for {what}")
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


def build_grid(blueprint: Blueprint, rng: np.random.Generator, placement: Placement) -> Grid:
    """Return the start of a world as :meth:`craftsim.discrete.files.blueprint.Blueprint.grid` describes it."""
    grid = Grid.empty(blueprint.size, blueprint.n_cars)
    _stand(grid, blueprint.objects)
    for piece in blueprint.snapshot.pieces if blueprint.snapshot else ():
        grid.cells[piece.cell] = (piece.kind, piece.yaw, -1, 0)
    draw = _Draw(grid, blueprint, rng, placement)
    for _ in range(blueprint.n_slopes - blueprint.listed(Kind.FSLOPE, Kind.BODY)):
        cell, yaw = draw.place("a random folded slope", slope=True)
        grid.put(Piece(Kind.FSLOPE, cell, yaw))
    for _ in range(blueprint.n_blocks - blueprint.listed(Kind.BLOCK)):
        cell, _ = draw.place("a random block")
        grid.put(Piece(Kind.BLOCK, cell))
    for car in range(blueprint.n_cars):
        row = blueprint.cars.get(car)
        if row is None:
            cell, yaw = draw.place(f"car {car}", for_car=True)
            row = (*cell, yaw, Kind.AIR, 0, 0)
        grid.cars[car] = row
        grid.occupant[row[0], row[1], row[2] - 1] = car
    if blueprint.snapshot:
        for entry in blueprint.snapshot.top:
            grid.occupant[entry.cell] = entry.mark
        for entry in blueprint.snapshot.back:
            grid.landing[entry.cell] = entry.mark
    return grid
