"""A failure in its smallest world, in words; places are as seen by the car that acts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from craftsim.checking.attempt import Verdict
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Cell, Grid, Kind
from craftsim.discrete.kinds import CARRIED, MOVE_DIRECTION, NAMES, Action
from craftsim.discrete.rules import Rules
from craftsim.validation.shrinking.pieces import WorldPart, pieces_of
from craftsim.validation.shrinking.shrink import Smallest

_WAYS: Final = ("ahead", "to the left", "behind", "to the right")
_DOWN: Final = ("ahead", "to the left", "backwards", "to the right")
_NUMBERS: Final = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
_LOADS: Final = {kind: NAMES[kind] for kind in CARRIED}
_RESULTS: Final = {
    Verdict.FAILED: "it fails",
    Verdict.SIDE_EFFECT: "it moves something else",
    Verdict.UNSAFE: "it is unsafe",
}
_CLIMBS: Final = {
    (0, 1): " onto a ramp's foot",
    (1, 2): " up the ramp",
    (2, 0): " off the ramp's top",
    (0, 2): " onto a ramp's top",
    (2, 1): " down the ramp",
    (1, 0): " off the ramp's foot",
}


def sentence(smallest: Smallest) -> str:
    """Return what fails, when, and how, such as "car 0 turns left with a block on level 2; it fails when ..."."""
    grid = smallest.grid
    me, *others = pieces_of(grid)
    after = Rules(smallest.setup.rules).apply(grid, 0, smallest.action)
    around = list(_around(me, others))
    fails = _RESULTS.get(
        Verdict(smallest.attempt.result), f"it is not as predicted ({smallest.attempt.result})"
    )
    when = f" when {'; and '.join(around)}" if around else " with nothing around"
    return f"car 0 {_acts(me, grid, after, smallest.action)}; {fails}{when}"


def _acts(me: WorldPart, grid: Grid, after: Grid, action: Action) -> str:
    """Say what the car does, and on which level."""
    spec, own = ACTIONS[action], Kind(grid.kind[me.cell]) if me.cell[2] < grid.kind.shape[2] else Kind.AIR
    slope = int(after.cars[0, CarField.SLOPE])
    if action in MOVE_DIRECTION:
        way = (MOVE_DIRECTION[action] - me.yaw) % 4
        does = f"drives {'back' if way == 2 else _WAYS[way]}{_CLIMBS.get((me.slope, slope), '')}"
    elif spec.verb == "LIFT":
        does = f"lifts {_LOADS[own]}"
    elif spec.verb == "DROP":
        does = f"puts down {_LOADS[me.load]}"
    elif spec.verb in ("FOLD", "UNFOLD"):
        does = f"{spec.verb.lower()}s a slope"
    else:
        does = f"{spec.words.replace('rotate', 'turns')}"
    if spec.verb in ("MOVE", "ROTATE_LEFT", "ROTATE_RIGHT"):
        does += f" with {_LOADS[me.load]}" if me.load != Kind.AIR else ""
        does += f" from under {_thing(own)}" if own in (*_LOADS, Kind.BODY) else ""
    return f"{does} on level {me.cell[2]}"


def _around(me: WorldPart, others: Sequence[WorldPart]) -> Iterator[str]:
    """Say what stands around, the nearest first; not what only bears something, nor ramps that cars are on."""
    cars = [piece for piece in others if piece.is_car]
    borne = {cell for piece in (me, *others) for cell in piece.rests_on}
    ridden = {_ramp_below(piece) for piece in (me, *cars)} - {None}
    for piece in sorted(others, key=lambda p: (p.is_car, _relative(me, p.cell)[2], p.cell)):
        bears = piece.kind in (Kind.BLOCK, Kind.WALL) and piece.cell in borne
        if bears or (piece.kind == Kind.BODY and not ridden.isdisjoint(piece.cells)) or piece.cell == me.cell:
            continue
        name = f"car {1 + cars.index(piece)}" if piece.is_car else _thing(piece.kind)
        yield f"{name}{_state(me, piece, others)} {_place(me, piece.cell)}"


def _ramp_below(car: WorldPart) -> Cell | None:
    """Return the cell of the part of a ramp that a car is on."""
    x, y, z = car.cell
    return {1: (x, y, z), 2: (x, y, z - 1)}.get(car.slope)


def _state(me: WorldPart, piece: WorldPart, others: Sequence[WorldPart]) -> str:
    """Say what a car carries and is on, or where a slope points."""
    if piece.kind == Kind.BODY:
        return f" that leads down {_DOWN[(piece.yaw - me.yaw) % 4]} is"
    if piece.kind == Kind.FSLOPE:
        return f" whose gear points {_DOWN[(piece.yaw - me.yaw) % 4]} is"
    if not piece.is_car:
        return " is"
    load = f" with {_LOADS[piece.load]}" if piece.load != Kind.AIR else ""
    load += f" whose gear points {_DOWN[(piece.load_yaw - me.yaw) % 4]}" if piece.load == Kind.FSLOPE else ""
    ramp = next((p for p in others if p.kind == Kind.BODY and _ramp_below(piece) in p.cells), None)
    if ramp is None:
        return f"{load} is"
    part = "foot" if piece.slope == 1 else "upper half"
    return f"{load} is on the {part} of a ramp that leads down {_DOWN[(ramp.yaw - me.yaw) % 4]},"


def _thing(kind: Kind) -> str:
    return {Kind.WALL: "a wall", Kind.BODY: "a ramp", **_LOADS}[kind]


def _relative(me: WorldPart, cell: Cell) -> tuple[int, int, int]:
    """Return how far ahead, to the left and above a cell is."""
    dx, dy, dz = (a - b for a, b in zip(cell, me.cell, strict=True))
    for _ in range(me.yaw % 4):
        dx, dy = dy, -dx
    return dx, dy, dz


def _place(me: WorldPart, cell: Cell) -> str:
    """Say where a cell is."""
    ahead, left, above = _relative(me, cell)
    ways = [_WAYS[0 if ahead > 0 else 2]] * (ahead != 0) + [_WAYS[1 if left > 0 else 3]] * (left != 0)
    if not ways:
        place = "in the same column"
    elif len(ways) == 1:
        n = abs(ahead + left)
        place = f"in the next cell {ways[0]}" if n == 1 else f"{_number(n)} cells {ways[0]}"
    elif abs(ahead) == abs(left) == 1:
        place = f"in the cell diagonally {ways[0]} {ways[1]}"
    else:
        place = f"{_number(abs(ahead))} {ways[0]} and {_number(abs(left))} {ways[1]}"
    if not above:
        return place
    levels = "one level" if abs(above) == 1 else f"{_number(abs(above))} levels"
    return f"{place}, {levels} {'above' if above > 0 else 'below'}"


def _number(n: int) -> str:
    return _NUMBERS[n] if n < len(_NUMBERS) else str(n)
