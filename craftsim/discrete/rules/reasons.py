"""Why an action is forbidden, in words: each function names the first rule that its twin in the compiled rules breaks.

They speak of the rules without the corrections of the physical set; :mod:`craftsim.discrete.rules.explain` adds these.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from craftsim.discrete.grid import CarField, Cell, Kind, beside
from craftsim.discrete.kernel.state import Pose, World, back_at, kind_at, standable, top_at, yaw_at
from craftsim.discrete.kinds import MOVE_DIRECTION, NAMES, Action
from craftsim.discrete.rules.moves import ascent_legal, descent_legal, goes_on, load_has_room
from craftsim.discrete.rules.reach import carried_gear_in

ON_A_SLOPE: Final = "on a slope a car can only move forward"


class RuleReason(NamedTuple):
    """Why an action is forbidden."""

    text: str
    cells: tuple[Cell, ...]
    """The cells concerned."""


def at(car: Pose) -> Cell:
    """Return a car's cell."""
    return int(car.x), int(car.y), int(car.z)


def under(cell: Cell) -> Cell:
    """Return the cell below a cell."""
    return cell[0], cell[1], cell[2] - 1


def kind_in(w: World, cell: Cell) -> Kind:
    """Return what is in a cell; beside the map there is wall, above it air."""
    return Kind(kind_at(w, *cell))


def named(w: World, cell: Cell) -> str:
    """Return what is in a cell in words."""
    length, width = w.cells.shape[:2]
    return NAMES[kind_in(w, cell)] if 0 <= cell[0] < length and 0 <= cell[1] < width else "the end of the map"


def car_at(w: World, me: int, cell: Cell) -> int:
    """Return another car in a cell, -1 if there is none."""
    places = w.cars[:, : CarField.Z + 1].tolist()
    return next((i for i, place in enumerate(places) if i != me and tuple(place) == cell), -1)


def on_top(w: World, me: int, cell: Cell) -> RuleReason:
    """Say what stands on a cell by its mark, which is not -1."""
    mark, above = int(top_at(w, *cell, me)), (cell[0], cell[1], cell[2] + 1)
    what = f"car {mark}" if mark >= 0 else named(w, above)
    if what == "nothing":
        what = "so says its mark, left by past events"
    return RuleReason(f"something stands on {cell}: {what}", (cell, above))


def why_lift(w: World, me: int, car: Pose, action: int) -> RuleReason | None:
    """Say why LIFT is forbidden."""
    cell = at(car)
    if car.slope:
        return RuleReason(ON_A_SLOPE, (cell,))
    if car.load != Kind.AIR:
        return RuleReason(f"the car carries {NAMES[Kind(car.load)]}", (cell,))
    if kind_in(w, cell) not in (Kind.BLOCK, Kind.FLAG, Kind.FSLOPE):
        there = "" if kind_in(w, cell) == Kind.AIR else f": {named(w, cell)}"
        return RuleReason(f"there is nothing to lift in {cell}{there}", (cell,))
    return on_top(w, me, cell) if top_at(w, *cell, me) != -1 else None


def why_drop(w: World, me: int, car: Pose, action: int) -> RuleReason | None:
    """Say why DROP is forbidden."""
    cell = at(car)
    if car.slope:
        return RuleReason(ON_A_SLOPE, (cell,))
    if car.load == Kind.AIR:
        return RuleReason("the car carries nothing", (cell,))
    if car.z >= w.cells.shape[2]:
        return RuleReason(f"{cell} is above the top level, where nothing can be put down", (cell,))
    return None


def why_fold(w: World, me: int, car: Pose, action: int) -> RuleReason | None:
    """Say why FOLD is forbidden."""
    cell = at(car)
    if car.slope:
        return RuleReason(ON_A_SLOPE, (cell,))
    if kind_in(w, cell) != Kind.BODY:
        return RuleReason(f"there is no unfolded slope in {cell}: {named(w, cell)}", (cell,))
    if top_at(w, *cell, me) != -1:
        return on_top(w, me, cell)
    foot = beside(cell, int(yaw_at(w, *cell)))
    on_foot = int(top_at(w, *under(foot), me))
    return RuleReason(f"car {on_foot} is on the foot in {foot}", (foot,)) if on_foot >= 0 else None


def why_unfold(w: World, me: int, car: Pose, action: int) -> RuleReason | None:
    """Say why UNFOLD is forbidden."""
    cell = at(car)
    if car.slope:
        return RuleReason(ON_A_SLOPE, (cell,))
    if car.load != Kind.AIR:
        return RuleReason(f"the car carries {NAMES[Kind(car.load)]}", (cell,))
    if kind_in(w, cell) != Kind.FSLOPE:
        return RuleReason(f"there is no folded slope in {cell}: {named(w, cell)}", (cell,))
    foot = beside(cell, int(yaw_at(w, *cell)))
    if kind_in(w, foot) not in (Kind.AIR, Kind.GEAR):
        return RuleReason(f"the foot has no room in {foot}: {named(w, foot)}", (foot,))
    if not standable(kind_at(w, *under(foot))):
        return RuleReason(
            f"the foot has nothing to stand on in {under(foot)}: {named(w, under(foot))}", (foot,)
        )
    for below in (under(foot), under(cell)):
        if back_at(w, *below):
            return RuleReason(f"{below} is the landing of a ramp", (below,))
    return None


def why_rotate(w: World, me: int, car: Pose, action: int) -> RuleReason | None:
    """Say why a turn is forbidden."""
    cell, turn = at(car), 1 if action == Action.ROTATE_LEFT else -1
    if car.slope:
        return RuleReason(ON_A_SLOPE, (cell,))
    if car.load == Kind.AIR:
        if kind_in(w, cell) in (Kind.FSLOPE, Kind.BODY):
            return RuleReason(f"a car cannot turn under {named(w, cell)} in {cell}", (cell,))
        return None
    carries_slope = car.load == Kind.FSLOPE
    for d in range(4):
        there = beside(cell, d)
        kind = kind_in(w, there)
        if kind == Kind.GEAR and yaw_at(w, *there) == (d + 2) & 3:
            continue
        if kind != Kind.AIR:
            return RuleReason(f"the load would hit {named(w, there)} in {there}", (there,))
    corner = beside(beside(cell, int(car.load_yaw)), int(car.load_yaw) + turn)
    if carries_slope and kind_in(w, corner) not in (Kind.AIR, Kind.GEAR):
        return RuleReason(f"the slope would hit {named(w, corner)} in {corner}", (corner,))
    for other, row in enumerate(w.cars.tolist()):
        load = row[CarField.LOAD]
        if other == me or row[CarField.Z] != car.z or load == Kind.AIR:
            continue
        place = (row[CarField.X], row[CarField.Y], row[CarField.Z])
        if abs(place[0] - car.x) + abs(place[1] - car.y) == 1 or (carries_slope and place == corner):
            return RuleReason(f"the load would hit that of car {other} in {place}", (place,))
        gear = beside(place, row[CarField.LOAD_YAW])
        aside = abs(gear[0] - car.x) + abs(gear[1] - car.y) == 1
        if load == Kind.FSLOPE and aside and beside(gear, row[CarField.LOAD_YAW]) != cell:
            return RuleReason(f"the load would hit the gear that car {other} carries in {gear}", (gear,))
    return None


def why_stop(w: World, me: int, car: Pose, action: int) -> RuleReason | None:
    """Say why STOP is forbidden."""
    return RuleReason(ON_A_SLOPE, (at(car),)) if car.slope else None


def why_never(w: World, me: int, car: Pose, action: int) -> RuleReason | None:
    """Say why a diagonal move is forbidden."""
    return RuleReason("cars do not move diagonally", (at(car),))


def why_move(w: World, me: int, car: Pose, action: int) -> RuleReason | None:
    """Say why a move is forbidden."""
    m, yaw = MOVE_DIRECTION[Action(action)], int(car.yaw)
    cell, target = at(car), beside(at(car), m)
    forward, along = m == yaw, (m - yaw) % 2 == 0
    own, kind, below = kind_in(w, cell), kind_in(w, target), kind_in(w, under(target))
    loaded = car.load != Kind.AIR
    if car.slope:
        if not forward:
            return RuleReason(ON_A_SLOPE, (cell,))
        if goes_on(w, me, car, m):
            return None
    if own in (Kind.FSLOPE, Kind.BODY) and not forward:
        return RuleReason(f"from under {named(w, cell)} in {cell} a car can only move forward", (cell,))
    if own in (Kind.BLOCK, Kind.FLAG) and not along:
        return RuleReason(f"from under {named(w, cell)} in {cell} a car cannot move sideways", (cell,))
    if below not in (Kind.GROUND, Kind.BLOCK, Kind.BODY):
        what = f"there is nothing to stand on in {under(target)}: {named(w, under(target))}"
        return RuleReason(what if kind != Kind.WALL else f"{named(w, target)} is in {target}", (target,))
    if (other := car_at(w, me, target)) >= 0:
        return RuleReason(f"car {other} is in {target}", (target,))
    if loaded and not car.slope and not load_has_room(w, me, car, m):
        return _why_no_room(w, me, car, m)
    if kind == Kind.AIR:
        blocked = below == Kind.BODY and not descent_legal(w, me, car, m)
        return _why_no_descent(w, me, car, m) if blocked else None
    if kind in (Kind.BLOCK, Kind.FLAG):
        if loaded:
            return RuleReason(f"a load does not fit under {named(w, target)} in {target}", (target,))
        return (
            None
            if along
            else RuleReason(f"{named(w, target)} in {target} cannot be entered sideways", (target,))
        )
    if kind in (Kind.FSLOPE, Kind.BODY):
        if loaded:
            return RuleReason(f"a load does not fit under {named(w, target)} in {target}", (target,))
        high_side = along and not forward and (yaw - yaw_at(w, *target)) % 4 == 2
        entered = f"{named(w, target)} in {target} is entered backwards, from its high side only"
        return None if high_side else RuleReason(entered, (target,))
    if kind == Kind.GEAR:
        return (
            RuleReason(f"a load does not pass {named(w, target)} in {target}", (target,)) if loaded else None
        )
    if kind == Kind.FOOT:
        return None if ascent_legal(w, me, car, m) else _why_no_ascent(w, me, car, m)
    return RuleReason(f"{named(w, target)} is in {target}", (target,))


def _why_no_room(w: World, me: int, car: Pose, m: int) -> RuleReason:
    target = beside(at(car), m)
    if carried_gear_in(w, me, *target, -1):
        return RuleReason(f"another car carries a gear in {target}", (target,))
    swept = beside(beside(at(car), int(car.yaw) + 2), m)
    what = named(w, swept)
    if (other := car_at(w, me, swept)) >= 0:
        what = f"car {other}"
    elif what == "nothing":
        what = "a gear that another car carries"
    return RuleReason(f"the gear of the load has no room in {swept}: {what}", (swept,))


def _why_no_descent(w: World, me: int, car: Pose, m: int) -> RuleReason:
    cell, target = at(car), beside(at(car), m)
    body = under(target)
    foot, end = beside(body, m), beside(beside(body, m), m)
    if kind_in(w, cell) not in (Kind.AIR, Kind.BLOCK, Kind.FLAG):
        return RuleReason(f"from a cell with {named(w, cell)} no ramp is driven down", (cell,))
    if m != car.yaw or m != yaw_at(w, *body):
        return RuleReason(f"the ramp in {body} is driven down forward, in its own direction, only", (body,))
    if top_at(w, *body, me) != -1:
        return on_top(w, me, body)
    if (other := int(top_at(w, *under(foot), me))) >= 0:
        return RuleReason(f"car {other} is on the foot of the ramp in {foot}", (foot,))
    if not standable(kind_at(w, *under(end))):
        return RuleReason(f"the ramp ends in {end}, where there is nothing to stand on", (end,))
    return on_top(w, me, under(end))


def _why_no_ascent(w: World, me: int, car: Pose, m: int) -> RuleReason:
    cell, foot = at(car), beside(at(car), m)
    body = beside(foot, m)
    landing = beside(body, m)
    top = (landing[0], landing[1], landing[2] + 1)
    if kind_in(w, cell) != Kind.AIR:
        return RuleReason(f"from a cell with {named(w, cell)} no ramp is driven up", (cell,))
    if m != car.yaw or (m + 2) & 3 != yaw_at(w, *foot):
        return RuleReason(f"the ramp in {foot} is driven up forward, from its low end, only", (foot,))
    if (other := int(top_at(w, *under(foot), me))) >= 0:
        return RuleReason(f"car {other} is on the foot of the ramp in {foot}", (foot,))
    if top_at(w, *body, me) != -1:
        return on_top(w, me, body)
    if not standable(kind_at(w, *landing)):
        return RuleReason(f"the ramp has no landing in {landing}: {named(w, landing)}", (landing,))
    if (other := int(top_at(w, *landing, me))) >= 0:
        return RuleReason(f"car {other} is on the landing, in {top}", (top,))
    return RuleReason(f"there is no room above the landing, in {top}: {named(w, top)}", (top,))


def always_a_goal(w: World, car: Pose) -> str:
    """Say that a forbidden action has something to try everywhere."""
    return ""


def nothing_to_lift(w: World, car: Pose) -> str:
    """Say why there is nothing to try for a forbidden LIFT."""
    lifted = car.load == Kind.AIR and kind_in(w, at(car)) in (Kind.BLOCK, Kind.FLAG, Kind.FSLOPE)
    return "" if lifted else "there is nothing to lift"


def nothing_to_drop(w: World, car: Pose) -> str:
    """Say why there is nothing to try for a forbidden DROP."""
    if car.load == Kind.AIR:
        return "there is nothing to drop"
    return "nothing stands on a slope" if car.slope else ""


def nothing_to_fold(w: World, car: Pose) -> str:
    """Say why there is nothing to try for a forbidden FOLD."""
    return "" if kind_in(w, at(car)) == Kind.BODY else "there is nothing to fold"


def nothing_to_unfold(w: World, car: Pose) -> str:
    """Say why there is nothing to try for a forbidden UNFOLD."""
    return "" if kind_in(w, at(car)) == Kind.FSLOPE else "there is nothing to unfold"
