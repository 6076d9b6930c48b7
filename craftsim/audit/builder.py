"""Builder of small worlds: pieces must not overlap, and what would float gets blocks below it."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

import numpy as np

from craftsim.discrete.grid import KINDS_WITH_YAW, SECOND_PART, CarField, Cell, Grid, Kind, Piece, beside
from craftsim.discrete.kinds import STANDING

CarRow = tuple[int, ...]
"""A row of ``Grid.cars``."""


class ImpossibleError(Exception):
    """A world or an effect that cannot exist; the message is the reason."""


def grid_of(pieces: Iterable[Piece], cars: Collection[CarRow], size: Cell) -> Grid:
    """Return the grid of pieces and cars.

    A gear is left out if its cell is occupied; of two gears in a cell the one with the smaller yaw is kept.
    """
    grid = Grid.empty(size, len(cars))
    grid.cars[:] = np.array(list(cars), np.int16).reshape(-1, len(CarField))
    filled: dict[Cell, tuple[int, int]] = {}
    for kind, cell, yaw in sorted(pieces, key=lambda piece: (piece.kind == Kind.FSLOPE, -piece.yaw)):
        filled[cell] = (int(kind), yaw)
        if (second := SECOND_PART.get(kind)) is not None:
            next_cell = beside(cell, yaw)
            gives_way = second == Kind.GEAR and filled.get(next_cell, (Kind.GEAR,))[0] != Kind.GEAR
            if not gives_way and grid.inside(next_cell):
                filled[next_cell] = (int(second), yaw)
    # One assignment: a survey makes tens of thousands of worlds.
    rows = np.array([(*cell, *what) for cell, what in filled.items()], np.int16).reshape(-1, 5)
    x, y, z, *_ = rows.T
    grid.cells[x, y, z, :2] = rows[:, 3:]
    grid.derive_marks()
    return grid


def turned(cell: Cell, quarters: int) -> Cell:
    """Return a cell turned counterclockwise about the column (0, 0)."""
    x, y, z = cell
    for _ in range(quarters % 4):
        x, y = -y, x
    return x, y, z


@dataclass
class Builder:
    """A world under construction. Columns may have any coordinates, also negative ones; levels begin at 1."""

    cells: dict[Cell, tuple[Kind, int]] = field(default_factory=dict)
    """Kind and yaw by occupied cell. AIR reserves a free cell; a gear occupies a cell only if it was claimed."""
    cars: list[CarRow] = field(default_factory=list)

    @classmethod
    def of(cls, grid: Grid) -> Builder:
        """Return a builder with the pieces and cars of a grid."""
        made = cls(cars=[tuple(row) for row in grid.cars.tolist()])
        for piece in grid.pieces(*STANDING):
            made.put(piece)
        return made

    def copy(self) -> Builder:
        """Return an independent copy."""
        return Builder(dict(self.cells), list(self.cars))

    def put(self, piece: Piece) -> None:
        """Add a piece; a gear occupies no cell. Raises ImpossibleError if a cell is occupied."""
        taken = {cell: (kind, piece.yaw) for cell, kind in self._taken(piece) if kind != Kind.GEAR}
        if taken.keys() & self.cells:
            raise ImpossibleError("two things would share a cell")
        self.cells |= taken

    def claim(self, piece: Piece) -> None:
        """Add a piece unless it is there already; a gear occupies a cell, and AIR reserves one.

        Raises ImpossibleError if something else is there.
        """
        for cell, kind in self._taken(piece):
            if self.cells.setdefault(cell, (kind, piece.yaw)) != (kind, piece.yaw):
                raise ImpossibleError("two things would share a cell")

    @staticmethod
    def _taken(piece: Piece) -> list[tuple[Cell, Kind]]:
        if piece.cell[2] < 1:
            raise ImpossibleError("something would be in the ground")
        return list(zip(piece.cells, piece.kinds, strict=True))

    def support(self, cell: Cell) -> None:
        """Fill the cells below with blocks, down to the ground."""
        x, y, z = cell
        if z < 1:
            raise ImpossibleError("something would be in the ground")
        for level in range(1, z):
            below = (x, y, level)
            if below not in self.cells and any(row[:3] == below for row in self.cars):
                raise ImpossibleError("something would stand on nothing")
            there, _ = self.cells.setdefault(below, (Kind.BLOCK, 0))
            if there == Kind.AIR:
                raise ImpossibleError("something would stand on nothing")
            if there != Kind.BLOCK:
                raise ImpossibleError(f"something would stand on a {there.name.lower()}")

    def turned(self, quarters: int) -> Builder:
        """Return a copy turned counterclockwise about the column (0, 0)."""
        cells = {
            turned(cell, quarters): (kind, (yaw + quarters) % 4 if kind in KINDS_WITH_YAW else 0)
            for cell, (kind, yaw) in self.cells.items()
        }
        cars: list[CarRow] = []
        for x, y, z, yaw, load, load_yaw, slope in self.cars:
            gear = (load_yaw + quarters) % 4 if load == Kind.FSLOPE else 0
            cars.append((*turned((x, y, z), quarters), (yaw + quarters) % 4, load, gear, slope))
        return Builder(cells, cars)

    def grid(self, low: tuple[int, int], size: Cell) -> Grid:
        """Return the grid of this size whose first column is ``low``."""
        lx, ly = low
        pieces = [
            Piece(kind, (x - lx, y - ly, z), yaw)
            for (x, y, z), (kind, yaw) in self.cells.items()
            if kind in STANDING
        ]
        return grid_of(pieces, [(x - lx, y - ly, *row) for x, y, *row in self.cars], size)
