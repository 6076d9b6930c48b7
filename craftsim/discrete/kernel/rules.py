"""The rules: why an action is forbidden. docs/rules.md explains the oddities.

:func:`why` returns 0 for a legal action, else a reason: a code, and in the higher bits a detail such as a car's number
(above DETAIL_BITS). A rule, and a correction, is read in one place. In each rule the published ones come first, then
the corrections in the order of their codes: so the reason is a correction only where the published rules allow it.
"""

from __future__ import annotations

from craftsim.compiled.jit import compiled
from craftsim.discrete.kernel import codes as code
from craftsim.discrete.kernel.patterns import why_learned
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    BODY,
    CROSSING_GEAR,
    F_LOAD,
    F_LOAD_YAW,
    F_X,
    F_Y,
    F_Z,
    FLAG,
    FOOT,
    FSLOPE,
    GEAR,
    GEAR_MM,
    LEANING_LOAD,
    LIP_MM,
    NOTHING,
    OVERHEAD_WALL,
    OWN_RAMP,
    RAMP_BELOW_GEAR,
    REACHING_LOAD,
    ROOMY,
    RUN_OUT,
    SUPPORTS,
    SWINGING_FLAP,
    TURNING_LOAD,
    WALL,
    CarState,
    World,
    apply,
    below_leaning,
    car_field,
    car_in,
    carried_gear_in,
    dir_x,
    dir_y,
    downhill_of,
    gear_across,
    inside,
    is_landing,
    kind_at,
    leans_into,
    moved,
    occupant_of,
    reaches_up,
    state_of_car,
    yaw_at,
)

# LIFT, DROP, FOLD, UNFOLD, turns

REASON_BIT = 32
"""First bit of the reason in the result of :func:`legal_actions`."""


@compiled
def _why_lift(w: World, me: int, car: CarState) -> int:
    """LIFT: no load, something to lift in the own cell, and nothing on it."""
    if car.load != AIR:
        return code.CARRIES
    kind = kind_at(w, car.x, car.y, car.z)
    if kind not in (BLOCK, FLAG, FSLOPE):
        return code.NOTHING_TO_LIFT
    on_top = occupant_of(w, car.x, car.y, car.z, me)
    if on_top != NOTHING:
        return code.THING_ON_TOP | on_top << code.DETAIL_BITS
    if w.corrections & REACHING_LOAD and below_leaning(w, me, car):
        return code.REACHING_LOAD_HITS
    if w.corrections & OVERHEAD_WALL and kind_at(w, car.x, car.y, car.z + 1) == WALL:
        return code.WALL_OVERHEAD
    if kind == FSLOPE:
        return _why_gear(w, me, car, yaw_at(w, car.x, car.y, car.z))
    return code.LEGAL


@compiled
def _why_gear(w: World, me: int, car: CarState, yaw: int) -> int:
    """Look whether the gear of a slope that is lifted or set down in a car's cell crosses something in the next one."""
    if not w.corrections & CROSSING_GEAR:
        return code.LEGAL
    x = car.x + dir_x(yaw)
    y = car.y + dir_y(yaw)
    if gear_across(w, me, x, y, car.z, yaw) or car_in(w, me, x, y, car.z, True) >= 0:
        return code.GEARS_CROSS
    crosses = kind_at(w, x, y, car.z) == FOOT and (yaw_at(w, x, y, car.z) - yaw) & 1 != 0
    if crosses:
        return code.GEARS_CROSS
    return code.LEGAL


@compiled
def _why_fold(w: World, me: int, car: CarState) -> int:
    """FOLD: an unfolded slope in the own cell with nothing on its body and no car on its foot."""
    if kind_at(w, car.x, car.y, car.z) != BODY:
        return code.NO_RAMP_HERE
    on_top = occupant_of(w, car.x, car.y, car.z, me)
    if on_top != NOTHING:
        return code.THING_ON_TOP | on_top << code.DETAIL_BITS
    yaw = yaw_at(w, car.x, car.y, car.z)
    on_foot = occupant_of(w, car.x + dir_x(yaw), car.y + dir_y(yaw), car.z - 1, me)
    if on_foot >= 0:
        return code.CAR_ON_OWN_FOOT | on_foot << code.DETAIL_BITS
    return _why_flap(w, me, car, yaw)


@compiled
def _why_unfold(w: World, me: int, car: CarState) -> int:
    """UNFOLD: a folded slope in the own cell, room and support for the foot, and no landing of a ramp below."""
    if car.load != AIR:
        return code.CARRIES
    if kind_at(w, car.x, car.y, car.z) != FSLOPE:
        return code.NO_SLOPE_HERE
    yaw = yaw_at(w, car.x, car.y, car.z)
    x = car.x + dir_x(yaw)
    y = car.y + dir_y(yaw)
    if kind_at(w, x, y, car.z) not in ROOMY:
        return code.FOOT_BLOCKED
    if kind_at(w, x, y, car.z - 1) not in SUPPORTS:
        return code.FOOT_UNSUPPORTED
    if is_landing(w, x, y, car.z - 1):
        return code.LANDING_BELOW_FOOT
    if is_landing(w, car.x, car.y, car.z - 1):
        return code.LANDING_BELOW_BODY
    return _why_flap(w, me, car, yaw)


@compiled
def _why_flap(w: World, me: int, car: CarState, yaw: int) -> int:
    """Look whether the flap of the slope in a car's cell can swing, which CraftEnv's rules do not (docs/rules.md#flap).

    It is 0.43 m high on its way, and its lip goes 12 mm beyond the cell of the foot. There may stand an unloaded car, a
    foot whose low end is towards this one's, and a gear that points at it.
    """
    fx = car.x + dir_x(yaw)
    fy = car.y + dir_y(yaw)
    bx = fx + dir_x(yaw)
    by = fy + dir_y(yaw)
    if w.corrections & SWINGING_FLAP:
        facing = (yaw + 2) & 3
        kind_beyond = kind_at(w, bx, by, car.z) if inside(w, bx, by, car.z) else AIR
        if kind_beyond not in ROOMY and not (
            kind_beyond == FOOT and yaw_at(w, bx, by, car.z) == facing
        ):
            return code.FLAP_HITS
        if car_in(w, me, fx, fy, car.z, False) >= 0 or car_in(w, me, bx, by, car.z, True) >= 0:
            return code.FLAP_HITS
        if leans_into(w, me, car.x, car.y, car.z, -1) or leans_into(w, me, fx, fy, car.z, -1):
            return code.FLAP_HITS
        if leans_into(w, me, bx, by, car.z, facing) or gear_across(w, me, bx, by, car.z, yaw):
            return code.FLAP_HITS
        for z in range(car.z, car.z + 2):
            if gear_across(w, me, fx, fy, z, yaw):
                return code.FLAP_HITS
        if gear_across(w, me, car.x, car.y, car.z + 1, yaw):
            return code.FLAP_HITS
    if w.corrections & REACHING_LOAD:
        for z in range(car.z + 1, car.z + 3):
            if leans_into(w, me, car.x, car.y, z, -1) or leans_into(w, me, fx, fy, z, -1):
                return code.REACHING_LOAD_HITS
        if reaches_up(w, me, bx, by, car.z, LIP_MM):
            return code.REACHING_LOAD_HITS
    if w.corrections & OVERHEAD_WALL:
        for z in range(car.z + 1, car.z + 3):
            if kind_at(w, car.x, car.y, z) == WALL or kind_at(w, fx, fy, z) == WALL:
                return code.WALL_OVERHEAD
    return code.LEGAL


@compiled
def _why_rotate(w: World, me: int, car: CarState, turn: int) -> int:
    """Turn by +1 or -1: unloaded not under a slope; loaded only with room all round for the load."""
    if car.load == AIR:
        kind = kind_at(w, car.x, car.y, car.z)
        if kind in (FSLOPE, BODY):
            return code.TURN_UNDER_SLOPE
        return code.LEGAL
    for d in range(4):
        x = car.x + dir_x(d)
        y = car.y + dir_y(d)
        neighbour = kind_at(w, x, y, car.z)
        facing = neighbour == GEAR and yaw_at(w, x, y, car.z) == (d + 2) & 3
        if neighbour != AIR and not facing:
            return code.LOAD_HITS_THING | d << code.DETAIL_BITS
    corner_x = car.x + dir_x(car.load_yaw) + dir_x(car.load_yaw + turn)
    corner_y = car.y + dir_y(car.load_yaw) + dir_y(car.load_yaw + turn)
    if car.load == FSLOPE and kind_at(w, corner_x, corner_y, car.z) not in ROOMY:
        return code.SLOPE_HITS_CORNER
    reason = meets_turning_load(w, me, car, corner_x, corner_y)
    if reason != code.LEGAL:
        return reason
    # Whether the load meets a car, a load that leans or reaches in, or a wall overhead.
    if w.corrections & TURNING_LOAD:
        for d in range(4):
            x = car.x + dir_x(d)
            y = car.y + dir_y(d)
            leaning = leans_into(w, me, x, y, car.z, (d + 2) & 3)
            if leaning or car_in(w, me, x, y, car.z, False) >= 0:
                return code.TURNING_LOAD_HITS
    if w.corrections & REACHING_LOAD:
        legs_mm = 42 if car.load == FSLOPE else 32
        if below_leaning(w, me, car):
            return code.REACHING_LOAD_HITS
        for d in range(4):
            x = car.x + dir_x(d)
            y = car.y + dir_y(d)
            over = leans_into(w, me, x, y, car.z + 1, -1)
            if over or reaches_up(w, me, x, y, car.z, legs_mm):
                return code.REACHING_LOAD_HITS
    if w.corrections & OVERHEAD_WALL:
        for d in range(4):
            if kind_at(w, car.x + dir_x(d), car.y + dir_y(d), car.z + 1) == WALL:
                return code.WALL_OVERHEAD
    return code.LEGAL


@compiled
def meets_turning_load(w: World, me: int, car: CarState, corner_x: int, corner_y: int) -> int:
    """Return the reason where a load that turns would hit that of another car, or the gear that it carries."""
    for other_car in range(w.cars.shape[0]):
        if other_car == me or w.cars[other_car, F_Z] != car.z or w.cars[other_car, F_LOAD] == AIR:
            continue
        ox = car_field(w, other_car, F_X)
        oy = car_field(w, other_car, F_Y)
        if abs(ox - car.x) + abs(oy - car.y) == 1 or (
            car.load == FSLOPE and ox == corner_x and oy == corner_y
        ):
            return code.LOAD_HITS_LOAD | other_car << code.DETAIL_BITS
        if w.cars[other_car, F_LOAD] == FSLOPE:
            yaw = car_field(w, other_car, F_LOAD_YAW)
            gx = ox + dir_x(yaw)
            gy = oy + dir_y(yaw)
            points_at_me = gx + dir_x(yaw) == car.x and gy + dir_y(yaw) == car.y
            if abs(gx - car.x) + abs(gy - car.y) == 1 and not points_at_me:
                return code.LOAD_HITS_GEAR | other_car << code.DETAIL_BITS
    return code.LEGAL


# Moves


@compiled
def _why_move(w: World, me: int, car: CarState, m: int) -> int:
    """Move in direction m (0..3)."""
    x = car.x + dir_x(m)
    y = car.y + dir_y(m)
    target = kind_at(w, x, y, car.z)
    below = kind_at(w, x, y, car.z - 1)
    # CraftEnv's rules take any body before a foot, and any foot below a top, for the same ramp's, and do not look for
    # cars there (docs/rules.md#own-ramp, docs/rules.md#shared-cell).
    up = car.slope == 1 and target == BODY
    down = car.slope == 2 and below == FOOT
    if car.slope != 0 and m != car.yaw:
        return code.ON_SLOPE
    if not (up or down):
        reason = _why_flat(w, me, car, m, x, y, target, below)
        if reason != code.LEGAL:
            return reason
    if w.corrections == 0:
        return code.LEGAL
    if (
        car.load != AIR
        and w.corrections & LEANING_LOAD
        and not load_fits(w, me, car, moved(w, car, m))
    ):
        return code.LEANING_LOAD_HITS
    if car.slope != 0 and w.corrections & OWN_RAMP:
        if up and not (
            yaw_at(w, x, y, car.z) == (m + 2) & 3 and car_in(w, me, x, y, car.z + 1, False) < 0
        ):
            return code.OTHER_RAMP
        if down and not (
            yaw_at(w, x, y, car.z - 1) == m and car_in(w, me, x, y, car.z - 1, False) < 0
        ):
            return code.OTHER_RAMP
        if not (up or down) and below == BODY:
            return code.OTHER_RAMP
    # CraftEnv's rules do not look at what is below a gear (docs/rules.md#through-a-gear).
    over_ramp = target == GEAR and below == BODY
    if (
        w.corrections & RAMP_BELOW_GEAR
        and over_ramp
        and _why_descent(w, me, car, m, x, y) != code.LEGAL
    ):
        return code.RAMP_UNDER_GEAR
    if (
        car.load != AIR
        and w.corrections & REACHING_LOAD
        and not _clears_levels(w, me, car, moved(w, car, m))
    ):
        return code.REACHING_LOAD_HITS
    if w.corrections & OVERHEAD_WALL:
        climbs = target == FOOT and not down
        over_body = climbs and kind_at(w, x + dir_x(m), y + dir_y(m), car.z + 1) == WALL
        if over_body or (up and kind_at(w, x, y, car.z + 1) == WALL):
            return code.WALL_OVERHEAD
        if car.load != AIR and not load_below_walls(w, car, moved(w, car, m)):
            return code.WALL_OVERHEAD
    if w.corrections & RUN_OUT and car.slope == 1 and target in (BLOCK, FLAG):
        return code.UNDER_THING_AT_END
    return code.LEGAL


@compiled
def _why_flat(
    w: World, me: int, car: CarState, m: int, x: int, y: int, target: int, below: int
) -> int:
    """Look whether a car that is not on its way along a ramp could move in direction m, to (x, y)."""
    forward = m == car.yaw
    along = (m - car.yaw) & 1 == 0
    loaded = car.load != AIR
    kind = kind_at(w, car.x, car.y, car.z)
    if kind in (FSLOPE, BODY) and not forward:
        return code.FORWARD_ONLY
    if kind in (BLOCK, FLAG) and not along:
        return code.NOT_SIDEWAYS
    if below not in SUPPORTS and below != BODY:
        if target == WALL:
            return code.IN_THE_WAY
        return code.NO_FLOOR
    other_car = car_in(w, me, x, y, car.z, False)
    if other_car >= 0:
        return code.CAR_THERE | other_car << code.DETAIL_BITS
    if loaded and car.slope == 0:
        if carried_gear_in(w, me, x, y, car.z, -1):
            return code.GEAR_THERE
        if car.load == FSLOPE:
            # The gear behind the car needs room beside its way.
            gx = car.x + dir_x(car.yaw + 2) + dir_x(m)
            gy = car.y + dir_y(car.yaw + 2) + dir_y(m)
            facing = (car.load_yaw + 2) & 3
            swept = kind_at(w, gx, gy, car.z)
            if swept not in ROOMY or (swept == GEAR and yaw_at(w, gx, gy, car.z) != facing):
                return code.GEAR_NO_ROOM
            if car_in(w, me, gx, gy, car.z, True) >= 0 or carried_gear_in(
                w, me, gx, gy, car.z, facing
            ):
                return code.GEAR_NO_ROOM
    if target == AIR:
        if below == BODY:
            return _why_descent(w, me, car, m, x, y)
        return code.LEGAL
    if target == FOOT:
        return _why_ascent(w, me, car, m, x, y)
    if target not in (BLOCK, FLAG, FSLOPE, BODY, GEAR):
        return code.IN_THE_WAY
    if loaded:
        if target == GEAR:
            return code.LOAD_NOT_THROUGH_GEAR
        return code.LOAD_NOT_UNDER
    if target in (BLOCK, FLAG) and not along:
        return code.ENTERED_SIDEWAYS
    if target in (FSLOPE, BODY) and not (
        along and not forward and (car.yaw - yaw_at(w, x, y, car.z)) & 3 == 2
    ):
        return code.HIGH_SIDE_ONLY
    return code.LEGAL


@compiled
def _why_descent(w: World, me: int, car: CarState, m: int, x: int, y: int) -> int:
    """Drive down onto the slope whose body is below the target cell (x, y).

    Of the landing only the mark under it is looked at (docs/rules.md#landing-not-inspected).
    """
    if kind_at(w, car.x, car.y, car.z) not in (AIR, BLOCK, FLAG):
        return code.NO_DESCENT_FROM
    if m != car.yaw or m != yaw_at(w, x, y, car.z - 1):
        return code.DOWN_FORWARD_ONLY
    on_body = occupant_of(w, x, y, car.z - 1, me)
    if on_body != NOTHING:
        return code.THING_ON_BODY_BELOW | on_body << code.DETAIL_BITS
    x = x + dir_x(m)
    y = y + dir_y(m)
    on_foot = occupant_of(w, x, y, car.z - 2, me)
    if on_foot >= 0:
        return code.CAR_ON_FOOT_BELOW | on_foot << code.DETAIL_BITS
    x = x + dir_x(m)
    y = y + dir_y(m)
    if kind_at(w, x, y, car.z - 2) not in SUPPORTS:
        return code.NO_FLOOR_AT_END
    at_end = occupant_of(w, x, y, car.z - 2, me)
    if at_end != NOTHING:
        return code.THING_AT_END | at_end << code.DETAIL_BITS
    return code.LEGAL


@compiled
def _why_ascent(w: World, me: int, car: CarState, m: int, x: int, y: int) -> int:
    """Drive up onto the slope whose foot is in the target cell (x, y); a landing must stand behind its body."""
    if kind_at(w, car.x, car.y, car.z) != AIR:
        return code.NO_ASCENT_FROM
    if m != car.yaw or (m + 2) & 3 != yaw_at(w, x, y, car.z):
        return code.UP_FORWARD_ONLY
    on_foot = occupant_of(w, x, y, car.z - 1, me)
    if on_foot >= 0:
        return code.CAR_ON_FOOT | on_foot << code.DETAIL_BITS
    x = x + dir_x(m)
    y = y + dir_y(m)
    on_body = occupant_of(w, x, y, car.z, me)
    if on_body != NOTHING:
        return code.THING_ON_BODY | on_body << code.DETAIL_BITS
    x = x + dir_x(m)
    y = y + dir_y(m)
    if kind_at(w, x, y, car.z) not in SUPPORTS:
        return code.NO_LANDING
    on_landing = occupant_of(w, x, y, car.z, me)
    if on_landing >= 0:
        return code.CAR_ON_LANDING | on_landing << code.DETAIL_BITS
    over = kind_at(w, x, y, car.z + 1)
    free = over == AIR or (over in (BLOCK, FLAG) and car.load == AIR)
    if free:
        return code.LEGAL
    return code.NO_ROOM_ON_LANDING


@compiled
def load_fits(w: World, me: int, old: CarState, new: CarState) -> bool:
    """Return whether a load fits on a ramp, off a ramp, and beside a load that leans on one.

    On the upper half it would meet gears that hang above body or foot from the side; and where it ends up leaning,
    nothing may be but a gear that points at it.
    """
    for half in (old, new):
        downhill = downhill_of(w, half.x, half.y, half.z, half.slope)
        if half.slope != 0 and gear_across(w, me, half.x, half.y, half.z, downhill):
            return False
        if half.slope == 2:
            x = half.x + dir_x(downhill)
            y = half.y + dir_y(downhill)
            if gear_across(w, me, x, y, half.z - 1, downhill) or gear_across(
                w, me, x, y, half.z, downhill
            ):
                return False
    if new.slope == 0:
        gx = new.x + dir_x(new.load_yaw)
        gy = new.y + dir_y(new.load_yaw)
        if new.load == FSLOPE and leans_into(w, me, gx, gy, new.z, (new.load_yaw + 2) & 3):
            return False
        leans = leans_into(w, me, new.x, new.y, new.z, -1)
        return not leans and not carried_gear_in(w, me, new.x, new.y, new.z, -1)
    downhill = downhill_of(w, new.x, new.y, new.z, new.slope)
    x = new.x + dir_x(downhill)
    y = new.y + dir_y(downhill)
    if kind_at(w, x, y, new.z) not in ROOMY and not (x == old.x and y == old.y):
        return False
    if car_in(w, me, x, y, new.z, True) >= 0 or gear_across(w, me, x, y, new.z, downhill):
        return False
    return not leans_into(w, me, x, y, new.z, (downhill + 2) & 3)


@compiled
def _clears_levels(w: World, me: int, old: CarState, new: CarState) -> bool:
    """Return whether a load that moves meets none that reaches up from the level below or leans over from above."""
    if below_leaning(w, me, old) or below_leaning(w, me, new):
        return False
    if new.slope != 0:
        return not leans_into(w, me, new.x, new.y, new.z, -1)
    if new.load != FSLOPE:
        return True
    for state in (old, new):
        x = state.x + dir_x(state.load_yaw)
        y = state.y + dir_y(state.load_yaw)
        if reaches_up(w, me, x, y, state.z, GEAR_MM):
            return False
    return True


@compiled
def load_below_walls(w: World, old: CarState, new: CarState) -> bool:
    """Return whether no wall is above a load on its way, or above where it leans on a ramp's foot."""
    if kind_at(w, old.x, old.y, old.z + 1) == WALL or kind_at(w, new.x, new.y, new.z + 1) == WALL:
        return False
    if new.slope != 1:
        return True
    downhill = downhill_of(w, new.x, new.y, new.z, 1)
    return kind_at(w, new.x + dir_x(downhill), new.y + dir_y(downhill), new.z + 1) != WALL


# All actions


@compiled
def why(w: World, me: int, car: CarState, action: int) -> int:
    """Return why car ``me``, were it in the state ``car``, could not do a primitive action now; 0 if it could."""
    reason = _why_built_in(w, me, car, action)
    if reason == code.LEGAL and w.patterns.shape[0] > 0:
        return why_learned(w, me, car, action)
    return reason


@compiled
def _why_built_in(w: World, me: int, car: CarState, action: int) -> int:
    """Return the same by the published rules and the corrections."""
    if code.FIRST_MOVE <= action <= code.LAST_MOVE:
        return _why_move(w, me, car, code.MOVE_DIRECTIONS[action - code.FIRST_MOVE])
    if not 0 <= action <= code.STOP:
        return code.NEVER
    if car.slope != 0:
        return code.ON_SLOPE
    if action == code.LIFT:
        return _why_lift(w, me, car)
    if action == code.DROP:
        # Whatever the cell holds (docs/rules.md#drop-overwrites).
        if car.load == AIR:
            return code.CARRIES_NOTHING
        if car.z >= w.cells.shape[2]:
            return code.ABOVE_TOP_LEVEL
        if car.load == FSLOPE:
            return _why_gear(w, me, car, car.load_yaw)
        return code.LEGAL
    if action == code.FOLD:
        return _why_fold(w, me, car)
    if action == code.UNFOLD:
        return _why_unfold(w, me, car)
    if action in (code.ROTATE_LEFT, code.ROTATE_RIGHT):
        turn = 1 if action == code.ROTATE_LEFT else -1
        return _why_rotate(w, me, car, turn)
    return code.LEGAL


@compiled(inline=False)
def legal_actions(w: World, me: int, car: CarState, first: int, last: int) -> int:
    """Return which of the actions from ``first`` to ``last`` are legal, a bit each, as :func:`why` says.

    Above these bits, from REASON_BIT on, stands why ``last`` is not legal. This function and the next are called, not
    inlined: so the rules above are compiled twice and no more, here in a loop, which makes one action dear.
    """
    legal = 0
    reason = 0
    for action in range(first, last + 1):
        reason = why(w, me, car, action)
        if reason == code.LEGAL:
            legal |= 1 << action
    return legal | (reason << REASON_BIT)


@compiled(inline=False)
def act(w: World, me: int, action: int) -> bool:
    """Carry out an action if it is legal now, else leave the world as it is; return whether it was."""
    if why(w, me, state_of_car(w, me), action) != code.LEGAL:
        return False
    apply(w, me, action)
    return True
