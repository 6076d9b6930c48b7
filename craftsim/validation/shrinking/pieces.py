"""A world as pieces that can be taken away one by one: what stands in it, and its cars with their loads."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from craftsim.audit import builder
from craftsim.discrete.grid import KINDS_WITH_YAW, SECOND_PART, CarField, Cell, Grid, Kind, Piece, beside
from craftsim.discrete.kinds import STANDING


@dataclass(frozen=True)
class WorldPart:
    """Something that stands in a world: a wall, a block, a flag, a slope, or a car."""

    cell: Cell
    kind: Kind
    """AIR for a car."""
    yaw: int = 0
    load: Kind = Kind.AIR
    """Of a car."""
    load_yaw: int = 0
    slope: int = 0
    """Of a car: 0 off slopes, 1 on a foot, 2 on a body."""

    @property
    def is_car(self) -> bool:
        """Whether it is a car."""
        return self.kind == Kind.AIR

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Where it is; of a slope, and of a car that carries one, both cells."""
        kind, yaw = (self.load, self.load_yaw) if self.is_car else (self.kind, self.yaw)
        return (self.cell, beside(self.cell, yaw)) if kind in SECOND_PART else (self.cell,)

    @property
    def rests_on(self) -> tuple[Cell, ...]:
        """The cells of what it stands on, which may be the ground; none for a wall, which may float."""
        if self.kind == Kind.WALL:
            return ()
        if self.slope == 1:
            return (self.cell,)
        return tuple((x, y, z - 1) for x, y, z in (self.cells if self.kind == Kind.BODY else (self.cell,)))

    def moved(self, by: Cell) -> WorldPart:
        """Return it elsewhere."""
        (x, y, z), (dx, dy, dz) = self.cell, by
        return replace(self, cell=(x + dx, y + dy, z + dz))

    def turned(self, quarters: int) -> WorldPart:
        """Return it turned about the column (0, 0), counterclockwise."""
        yaw = (self.yaw + quarters) % 4 if self.is_car or self.kind in KINDS_WITH_YAW else 0
        load_yaw = (self.load_yaw + quarters) % 4 if self.load == Kind.FSLOPE else 0
        return replace(self, cell=builder.turned(self.cell, quarters), yaw=yaw, load_yaw=load_yaw)


def pieces_of(grid: Grid, first: int = 0) -> tuple[WorldPart, ...]:
    """Return the pieces of a world: the car ``first``, the other cars in their order, and the things."""
    rows = grid.cars.tolist()
    cars = [
        WorldPart(
            tuple(row[: CarField.Z + 1]),
            Kind.AIR,
            row[CarField.YAW],
            Kind(row[CarField.LOAD]),
            row[CarField.LOAD_YAW],
            row[CarField.SLOPE],
        )
        for row in (rows[first], *rows[:first], *rows[first + 1 :])
    ]
    things = [WorldPart(piece.cell, piece.kind, piece.yaw) for piece in grid.pieces(*STANDING)]
    return (*cars, *things)


def grid_of(pieces: Iterable[WorldPart], size: Cell) -> Grid:
    """Return the world of pieces, its cars numbered in their order."""
    pieces = list(pieces)
    cars = [(*one.cell, one.yaw, one.load, one.load_yaw, one.slope) for one in pieces if one.is_car]
    things = [Piece(one.kind, one.cell, one.yaw) for one in pieces if not one.is_car]
    return builder.grid_of(things, cars, size)


def without(pieces: Sequence[WorldPart], gone: Collection[WorldPart]) -> tuple[WorldPart, ...]:
    """Return what is left when some are taken away, with all that stands on them."""
    gone = set(gone)
    while True:
        bare = {cell for piece in gone if piece.kind in (Kind.BLOCK, Kind.BODY) for cell in piece.cells}
        fallen = {piece for piece in pieces if piece not in gone and bare & {*piece.rests_on}}
        if not fallen:
            return tuple(piece for piece in pieces if piece not in gone)
        gone |= fallen


def distance(piece: WorldPart, cell: Cell) -> int:
    """Return how many steps along the axes a piece is from a cell."""
    return sum(abs(a - b) for a, b in zip(piece.cell, cell, strict=True))


def lowered(pieces: Sequence[WorldPart]) -> tuple[WorldPart, ...]:
    """Return everything one level lower, less the blocks on the floor: empty where something else is there."""
    floor = [piece for piece in pieces if piece.cell[2] == 1]
    if not floor or any(piece.kind != Kind.BLOCK for piece in floor):
        return ()
    return tuple(piece.moved((0, 0, -1)) for piece in pieces if piece.cell[2] > 1)


def cropped(pieces: Sequence[WorldPart], margin: int, above: int) -> tuple[tuple[WorldPart, ...], Cell]:
    """Return the pieces on a map with so many empty columns round them and levels above them, and its size."""
    cells = np.array([cell for piece in pieces for cell in piece.cells])
    low = cells.min(axis=0)
    length, width, _ = (cells.max(axis=0) - low + 1 + 2 * margin).tolist()
    by = (margin - int(low[0]), margin - int(low[1]), 0)
    return tuple(piece.moved(by) for piece in pieces), (length, width, int(cells[:, 2].max()) + above)
