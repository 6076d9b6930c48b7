"""How long any plan must take."""

from __future__ import annotations

from craftsim.discrete.grid import CarField, Grid, Kind, Piece
from craftsim.discrete.kinds import Action
from craftsim.discrete.schedule import nominal_durations
from craftsim.planning.assembly import State


def makespan_bound(start: Grid, building: State) -> float:
    """Return a time in seconds that every plan for a building takes at least.

    Each thing that does not stand must be taken up, carried at least the distance in the plane, and set down; the cars
    share that work, and nobody can carry one thing faster than alone.
    """
    table = nominal_durations()
    lift, drop, unfold = table[Action.LIFT, 0], table[Action.DROP, 1], table[Action.UNFOLD, 0]
    move = table[Action.MOVE_FORWARD, 1]
    there = list(start.pieces())
    carried = set(start.cars[:, CarField.LOAD].tolist())
    work = []
    for thing in building:
        if thing.load in carried:
            # It may be above its place already.
            work.append(0.0)
            continue
        if any((other.kind, other.cell) == (thing.kind, thing.cell) for other in there):
            continue
        work.append(
            min((_least(other, thing, move) for other in there if other.load == thing.load), default=0.0)
        )
        if thing.kind == Kind.BODY:
            work[-1] += 0.0 if any(o.kind == Kind.BODY for o in there) else unfold
        elif thing.kind == Kind.FLAG:
            work[-1] += lift
            continue
        if work[-1] > unfold or thing.kind != Kind.BODY:
            work[-1] += lift + drop
    return float(max([sum(work) / max(start.n_cars, 1), *work], default=0.0))


def _least(source: Piece, target: Piece, move: float) -> float:
    return float(move * sum(abs(a - b) for a, b in zip(source.cell[:2], target.cell[:2], strict=True)))
