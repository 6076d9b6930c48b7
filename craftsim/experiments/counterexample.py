"""The world of a failure as parts that can be removed, and its description in words."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from craftsim.checking.attempt import Verdict
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import (
    KINDS_WITH_YAW,
    SECOND_PART,
    CarField,
    Cell,
    Grid,
    Kind,
    Piece,
    beside,
    grid_of,
    turn_cell,
)
from craftsim.discrete.kinds import CARRIED, MOVE_DIRECTION, NAMES, STANDING, Action
from craftsim.discrete.rules import Rules

_WAYS: Final = ("ahead", "to the left", "behind", "to the right")
_DOWN: Final = ("ahead", "to the left", "backwards", "to the right")
_NUMBERS: Final = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
_LOADS: Final = {kind: NAMES[kind] for kind in CARRIED}
_THINGS: Final = {Kind.WALL: "a wall", Kind.BODY: "a ramp", **_LOADS}
_RESULTS: Final = {
    Verdict.FAILED: "it fails",
    Verdict.SIDE_EFFECT: "it moves something else",
    Verdict.UNSAFE: "it is unsafe",
    Verdict.AS_PREDICTED: "it is as predicted",
    Verdict.RETRIED: "it works at the second try",
    Verdict.NUMERICS: "the simulation breaks down",
}
_CLIMBS: Final = {
    (0, 1): " onto a ramp's foot",
    (1, 2): " up the ramp",
    (2, 0): " off the ramp's top",
    (0, 2): " onto a ramp's top",
    (2, 1): " down the ramp",
    (1, 0): " off the ramp's foot",
}


class WorldPart(NamedTuple):
    """A wall, a block, a flag, a slope, or a car in a world."""

    cell: Cell
    kind: Kind
    """AIR for a car."""
    yaw: int = 0
    load: Kind = Kind.AIR
    load_yaw: int = 0
    slope: int = 0
    """Slope that a car is on: 0 none, 1 foot, 2 body."""

    @property
    def is_car(self) -> bool:
        """Whether it is a car."""
        return self.kind == Kind.AIR

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Its cells: two for a slope and for a car that carries one."""
        if self.is_car:
            kind = self.load
            yaw = self.load_yaw
        else:
            kind = self.kind
            yaw = self.yaw
        if kind in SECOND_PART:
            return self.cell, beside(self.cell, yaw)
        return (self.cell,)

    @property
    def rests_on(self) -> tuple[Cell, ...]:
        """The cells of what it stands on, which may be the ground; none for a wall, which may float."""
        if self.kind == Kind.WALL:
            return ()
        if self.slope == 1:
            return (self.cell,)
        cells: tuple[Cell, ...] = (self.cell,)
        if self.kind == Kind.BODY:
            cells = self.cells
        return tuple((x, y, z - 1) for x, y, z in cells)

    def moved(self, by: Cell) -> WorldPart:
        """Return it elsewhere."""
        x, y, z = self.cell
        dx, dy, dz = by
        return self._replace(cell=(x + dx, y + dy, z + dz))

    def turned(self, quarters: int) -> WorldPart:
        """Return it turned about the column (0, 0), counterclockwise."""
        yaw = 0
        if self.is_car or self.kind in KINDS_WITH_YAW:
            yaw = (self.yaw + quarters) % 4
        load_yaw = 0
        if self.load == Kind.FSLOPE:
            load_yaw = (self.load_yaw + quarters) % 4
        return self._replace(cell=turn_cell(self.cell, quarters), yaw=yaw, load_yaw=load_yaw)


def pieces_of(grid: Grid, first: int = 0) -> tuple[WorldPart, ...]:
    """Return the pieces of a world: the car ``first``, the other cars in their order, and the things."""
    rows = grid.cars.tolist()
    cars = []
    for x, y, z, yaw, load, load_yaw, slope in (rows[first], *rows[:first], *rows[first + 1 :]):
        cars.append(WorldPart((x, y, z), Kind.AIR, yaw, Kind(load), load_yaw, slope))
    return (*cars, *(WorldPart(cell, kind, yaw) for kind, cell, yaw in grid.pieces(*STANDING)))


def world_of(pieces: Iterable[WorldPart], size: Cell) -> Grid:
    """Return the world of pieces, its cars numbered in their order."""
    pieces = list(pieces)
    cars = [(*piece.cell, *piece[2:]) for piece in pieces if piece.is_car]
    things = [Piece(piece.kind, piece.cell, piece.yaw) for piece in pieces if not piece.is_car]
    return grid_of(things, cars, size)


def without_parts(
    pieces: Sequence[WorldPart], removed: Collection[WorldPart]
) -> tuple[WorldPart, ...]:
    """Return what is left when some are taken away, with all that stands on them."""
    removed = set(removed)
    while True:
        bare = set()
        for piece in removed:
            if piece.kind in (Kind.BLOCK, Kind.BODY):
                for cell in piece.cells:
                    bare.add(cell)
        fallen = {piece for piece in pieces if piece not in removed and bare & {*piece.rests_on}}
        if not fallen:
            return tuple(piece for piece in pieces if piece not in removed)
        removed |= fallen


def lowered(pieces: Sequence[WorldPart]) -> tuple[WorldPart, ...]:
    """Return everything one level lower, less the blocks on the floor: empty where something else is there."""
    floor = [piece for piece in pieces if piece.cell[2] == 1]
    if not floor or any(piece.kind != Kind.BLOCK for piece in floor):
        return ()
    return tuple(piece.moved((0, 0, -1)) for piece in pieces if piece.cell[2] > 1)


def cropped(
    pieces: Sequence[WorldPart], margin: int, above: int
) -> tuple[tuple[WorldPart, ...], Cell]:
    """Return the pieces on a map with so many empty columns round them and levels above them, and its size."""
    cells = np.concatenate([piece.cells for piece in pieces])
    low = cells.min(axis=0)
    length, width, _ = (cells.max(axis=0) - low + 1 + 2 * margin).tolist()
    by = (margin - int(low[0]), margin - int(low[1]), 0)
    return tuple(piece.moved(by) for piece in pieces), (
        length,
        width,
        int(cells[:, 2].max()) + above,
    )


def words_of(grid: Grid, action: Action, result: str, rules: Rules) -> str:
    """Return what fails, when, and how, such as "car 0 turns left with a block on level 2; it fails when ...".

    Places are as seen by car 0, which acts.
    """
    me, *other_pieces = pieces_of(grid)
    around = list(_surroundings(me, other_pieces))
    fails = _RESULTS[Verdict(result)]
    circumstances = " with nothing around"
    if around:
        circumstances = f" when {'; and '.join(around)}"
    return f"car 0 {_action_words(me, grid, rules.apply(grid, 0, action), action)}; {fails}{circumstances}"


def _action_words(me: WorldPart, grid: Grid, after: Grid, action: Action) -> str:
    spec = ACTIONS[action]
    if me.cell[2] < grid.kind.shape[2]:
        kind_here = Kind(grid.kind[me.cell])
    else:
        kind_here = Kind.AIR
    slope = int(after.cars[0, CarField.SLOPE])
    if action in MOVE_DIRECTION:
        direction = (MOVE_DIRECTION[action] - me.yaw) % 4
        heading = _WAYS[direction]
        if direction == 2:
            heading = "back"
        words = f"drives {heading}{_CLIMBS.get((me.slope, slope), '')}"
    elif spec.verb == "LIFT":
        words = f"lifts {_LOADS[kind_here]}"
    elif spec.verb == "DROP":
        words = f"puts down {_LOADS[me.load]}"
    elif spec.verb in ("FOLD", "UNFOLD"):
        words = f"{spec.verb.lower()}s a slope"
    else:
        words = spec.words.replace("rotate", "turns")
    if spec.verb in ("MOVE", "ROTATE_LEFT", "ROTATE_RIGHT"):
        if me.load != Kind.AIR:
            words += f" with {_LOADS[me.load]}"
        if kind_here in (*_LOADS, Kind.BODY):
            words += f" from under {_THINGS[kind_here]}"
    return f"{words} on level {me.cell[2]}"


def _surroundings(me: WorldPart, other_pieces: Sequence[WorldPart]) -> Iterator[str]:
    """Say what stands around, the nearest first; not what only bears something, nor ramps that cars are on."""
    cars = [piece for piece in other_pieces if piece.is_car]
    borne = set()
    for piece in (me, *other_pieces):
        for cell in piece.rests_on:
            borne.add(cell)
    ridden = {_ramp_below(piece) for piece in (me, *cars)} - {None}
    for piece in sorted(other_pieces, key=lambda p: (p.is_car, _relative(me, p.cell)[2], p.cell)):
        bears = piece.kind in (Kind.BLOCK, Kind.WALL) and piece.cell in borne
        if (
            bears
            or (piece.kind == Kind.BODY and not ridden.isdisjoint(piece.cells))
            or piece.cell == me.cell
        ):
            continue
        if piece.is_car:
            name = f"car {1 + cars.index(piece)}"
        else:
            name = _THINGS[piece.kind]
        yield f"{name}{_state_words(me, piece, other_pieces)} {_place_words(me, piece.cell)}"


def _ramp_below(car: WorldPart) -> Cell | None:
    """Return the cell of the part of a ramp that a car is on."""
    x, y, z = car.cell
    if car.slope:
        return x, y, z - (car.slope == 2)
    return None


def _state_words(me: WorldPart, piece: WorldPart, other_pieces: Sequence[WorldPart]) -> str:
    """Say what a car carries and is on, or where a slope points."""

    def points(subject: str, yaw: int) -> str:
        return f" {subject} {_DOWN[(yaw - me.yaw) % 4]}"

    if not piece.is_car:
        if piece.kind == Kind.BODY:
            return f"{points('that leads down', piece.yaw)} is"
        if piece.kind == Kind.FSLOPE:
            return f"{points('whose gear points', piece.yaw)} is"
        return " is"
    load = ""
    if piece.load != Kind.AIR:
        load = f" with {_LOADS[piece.load]}"
    if piece.load == Kind.FSLOPE:
        load += points("whose gear points", piece.load_yaw)
    ramp = next(
        (p for p in other_pieces if p.kind == Kind.BODY and _ramp_below(piece) in p.cells), None
    )
    if ramp is None:
        return f"{load} is"
    if piece.slope == 1:
        half = "foot"
    else:
        half = "upper half"
    return f"{load} is on the {half} of a ramp{points('that leads down', ramp.yaw)},"


def _relative(me: WorldPart, cell: Cell) -> tuple[int, int, int]:
    """Return how far ahead, to the left and above a cell is."""
    dx, dy, dz = (a - b for a, b in zip(cell, me.cell, strict=True))
    for _ in range(me.yaw % 4):
        dx, dy = dy, -dx
    return dx, dy, dz


def _place_words(me: WorldPart, cell: Cell) -> str:
    """Say where a cell is, such as "two ahead and one to the left, one level above"."""
    ahead_cells, left_cells, levels_above = _relative(me, cell)
    along = _WAYS[0]
    if ahead_cells < 0:
        along = _WAYS[2]
    across = _WAYS[1]
    if left_cells < 0:
        across = _WAYS[3]
    if ahead_cells and left_cells:
        if abs(ahead_cells) == abs(left_cells) == 1:
            place = f"in the cell diagonally {along} {across}"
        else:
            place = f"{_number_word(ahead_cells)} {along} and {_number_word(left_cells)} {across}"
    elif ahead_cells:
        place = _straight_words(ahead_cells, along)
    elif left_cells:
        place = _straight_words(left_cells, across)
    else:
        place = "in the same column"
    if not levels_above:
        return place
    levels = "level"
    if abs(levels_above) > 1:
        levels = "levels"
    side = "above"
    if levels_above < 0:
        side = "below"
    return f"{place}, {_number_word(levels_above)} {levels} {side}"


def _straight_words(n_cells: int, direction: str) -> str:
    if abs(n_cells) == 1:
        return f"in the next cell {direction}"
    return f"{_number_word(n_cells)} cells {direction}"


def _number_word(number: int) -> str:
    """Return the magnitude of a number, a small one as a word."""
    magnitude = abs(number)
    if magnitude < len(_NUMBERS):
        return _NUMBERS[magnitude]
    return str(magnitude)
