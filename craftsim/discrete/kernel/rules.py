"""The rules: why an action is forbidden, and what it changes. docs/rules.md explains the oddities.

:func:`why` returns 0 for a legal action, else a reason: a code, and in the higher bits a detail such as a car's number
(:func:`because`). Codes of the published rules come first, then those of corrections in the order of their codes;
:mod:`craftsim.discrete.rules` has words for each. A correction is read in one place.

Gears are found by their slopes, standing or carried, since a cell shows only one gear. A load on a ramp leans downhill
with its car, by 40 to 60 mm, into the next cell: what comes straight towards its gear or it has room there, what moves
at a right angle to it has not. Heights are those of the machines' swept volumes (``craftsim clearance``).
"""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    BODY,
    CROSSING_GEAR,
    F_LOAD,
    F_LOAD_YAW,
    F_SLOPE,
    F_X,
    F_Y,
    F_YAW,
    F_Z,
    FLAG,
    FOOT,
    FSLOPE,
    GEAR,
    KIND,
    LANDING,
    LASTING_GEARS,
    LEANING_LOAD,
    NOTHING,
    OBJECT,
    OCCUPANT,
    OVERHEAD_WALL,
    OWN_RAMP,
    RAMP_BELOW_GEAR,
    REACHING_LOAD,
    RUN_OUT,
    SECOND_RAMP,
    SWINGING_FLAP,
    TURNING_LOAD,
    WALL,
    YAW,
    Pose,
    World,
    car_field,
    derived_landing,
    dir_x,
    dir_y,
    inside,
    is_air_or_gear,
    is_landing,
    kind_at,
    occupant_of,
    pose_of,
    standable,
    yaw_at,
)
from craftsim.discrete.kinds import Action

LIFT = int(Action.LIFT)
DROP = int(Action.DROP)
FOLD = int(Action.FOLD)
UNFOLD = int(Action.UNFOLD)
ROTATE_LEFT = int(Action.ROTATE_LEFT)
ROTATE_RIGHT = int(Action.ROTATE_RIGHT)
FIRST_MOVE = int(Action.MOVE_FORWARD)
LAST_MOVE = int(Action.MOVE_RIGHT)
STOP = int(Action.STOP)
N_ACTIONS = len(Action)

(
    LEGAL,
    NEVER,
    ON_SLOPE,
    CARRIES,
    CARRIES_NOTHING,
    NOTHING_TO_LIFT,
    THING_ON_TOP,
    ABOVE_TOP_LEVEL,
    NO_RAMP_HERE,
    CAR_ON_OWN_FOOT,
    NO_SLOPE_HERE,
    FOOT_BLOCKED,
    FOOT_UNSUPPORTED,
    LANDING_BELOW_FOOT,
    LANDING_BELOW_BODY,
    TURN_UNDER_SLOPE,
    LOAD_HITS_THING,
    SLOPE_HITS_CORNER,
    LOAD_HITS_LOAD,
    LOAD_HITS_GEAR,
    FORWARD_ONLY,
    NOT_SIDEWAYS,
    NO_FLOOR,
    IN_THE_WAY,
    CAR_THERE,
    GEAR_THERE,
    GEAR_NO_ROOM,
    LOAD_NOT_UNDER,
    ENTERED_SIDEWAYS,
    HIGH_SIDE_ONLY,
    LOAD_NOT_THROUGH_GEAR,
    NO_DESCENT_FROM,
    DOWN_FORWARD_ONLY,
    THING_ON_BODY_BELOW,
    CAR_ON_FOOT_BELOW,
    NO_FLOOR_AT_END,
    THING_AT_END,
    NO_ASCENT_FROM,
    UP_FORWARD_ONLY,
    CAR_ON_FOOT,
    THING_ON_BODY,
    NO_LANDING,
    CAR_ON_LANDING,
    NO_ROOM_ON_LANDING,
    FLAP_HITS,
    TURNING_LOAD_HITS,
    LEANING_LOAD_HITS,
    OTHER_RAMP,
    RAMP_UNDER_GEAR,
    REACHING_LOAD_HITS,
    WALL_OVERHEAD,
    GEARS_CROSS,
    UNDER_THING_AT_END,
) = range(53)
"""What may forbid an action."""

DETAIL_BITS = 8
"""A reason's detail lies above so many bits."""

LIP_MM = 10
"""Height above its floor at which the lip of a flap passes the border of the foot's cell."""
GEAR_MM = 115
"""Height above its floor, less what a load on a foot leaves, at which the gear of a carried slope begins."""


@compiled
def because(code: int, detail: int) -> int:
    """Return a reason with a detail: a direction 0..3 or a car's number."""
    return code | (detail << DETAIL_BITS)


@compiled
def move_direction(action: int) -> int:
    """Return the direction 0..3 of one of the four move actions 6..9 (+y, -y, -x, +x)."""
    step = action - FIRST_MOVE
    return 1 if step == 0 else (3 if step == 1 else (2 if step == 2 else 0))


# What is where: cars, gears and loads that reach out of their cells.


@compiled
def car_in(w: World, me: int, x: int, y: int, z: int, only_loaded: bool) -> int:
    """Return another car, or another loaded car, in a cell; -1 if there is none."""
    for other in range(w.cars.shape[0]):
        if other == me or (only_loaded and w.cars[other, F_LOAD] == AIR):
            continue
        if w.cars[other, F_X] == x and w.cars[other, F_Y] == y and w.cars[other, F_Z] == z:
            return other
    return -1


@compiled
def carried_gear_in(w: World, me: int, x: int, y: int, z: int, tolerated_yaw: int) -> bool:
    """Return whether another car carries a gear in a cell; ``tolerated_yaw`` (-1: none) is not seen."""
    for other in range(w.cars.shape[0]):
        if other == me or w.cars[other, F_LOAD] != FSLOPE or w.cars[other, F_Z] != z:
            continue
        yaw = car_field(w, other, F_LOAD_YAW)
        here = w.cars[other, F_X] + dir_x(yaw) == x and w.cars[other, F_Y] + dir_y(yaw) == y
        if here and yaw != tolerated_yaw:
            return True
    return False


@compiled
def gear_across(w: World, me: int, x: int, y: int, z: int, along: int) -> bool:
    """Return whether a gear, standing or carried, reaches into a cell at a right angle to the direction ``along``."""
    for side in range(2):
        yaw = (along + 1 + 2 * side) & 3
        sx, sy = x - dir_x(yaw), y - dir_y(yaw)
        if kind_at(w, sx, sy, z) == FSLOPE and yaw_at(w, sx, sy, z) == yaw:
            return True
        for other in range(w.cars.shape[0]):
            if other == me or w.cars[other, F_LOAD] != FSLOPE or w.cars[other, F_LOAD_YAW] != yaw:
                continue
            if w.cars[other, F_X] == sx and w.cars[other, F_Y] == sy and w.cars[other, F_Z] == z:
                return True
    return False


@compiled
def downhill_of(w: World, x: int, y: int, z: int, slope: int) -> int:
    """Return where downhill is for a car on a slope (1 on the foot, 2 above the body) in a cell; -1 off slopes."""
    if slope == 1 and kind_at(w, x, y, z) == FOOT:
        return yaw_at(w, x, y, z)
    if slope == 2 and kind_at(w, x, y, z - 1) == BODY:
        return yaw_at(w, x, y, z - 1)
    return -1


@compiled
def leans_into(w: World, me: int, x: int, y: int, z: int, tolerated: int) -> bool:
    """Return whether another car's load leans into a cell; the direction ``tolerated`` (-1: none) is not seen."""
    for other in range(w.cars.shape[0]):
        if other == me or w.cars[other, F_SLOPE] == 0 or w.cars[other, F_LOAD] == AIR:
            continue
        ox, oy, oz = car_field(w, other, F_X), car_field(w, other, F_Y), car_field(w, other, F_Z)
        if oz != z or abs(ox - x) + abs(oy - y) != 1:
            continue
        downhill = downhill_of(w, ox, oy, oz, car_field(w, other, F_SLOPE))
        here = ox + dir_x(downhill) == x and oy + dir_y(downhill) == y
        if downhill >= 0 and downhill != tolerated and here:
            return True
    return False


@compiled
def reaches_up(w: World, me: int, x: int, y: int, z: int, height_mm: int) -> bool:
    """Return whether another car's load stands into a cell from the level below, up to this height above its floor.

    One that leans into the cell below does so by less than 50 mm.
    """
    for other in range(w.cars.shape[0]):
        if other == me or w.cars[other, F_LOAD] == AIR:
            continue
        if w.cars[other, F_X] != x or w.cars[other, F_Y] != y or w.cars[other, F_Z] != z - 1:
            continue
        folded_slope = 10 if w.cars[other, F_LOAD] == FSLOPE else 0
        if (113 if w.cars[other, F_SLOPE] == 1 else 32) + folded_slope >= height_mm:
            return True
    return height_mm < 50 and leans_into(w, me, x, y, z - 1, -1)


@compiled
def below_leaning(w: World, me: int, car: Pose) -> bool:
    """Return whether another car's load leans over that of a car, from a ramp one level above."""
    if leans_into(w, me, car.x, car.y, car.z + 1, -1):
        return True
    if car.slope != 1:
        return False
    downhill = downhill_of(w, car.x, car.y, car.z, 1)
    return leans_into(w, me, car.x + dir_x(downhill), car.y + dir_y(downhill), car.z + 1, -1)


# LIFT, DROP, FOLD, UNFOLD, turns


@compiled
def why_lift(w: World, me: int, car: Pose) -> int:
    """LIFT: no load, something to lift in the own cell, and nothing on it."""
    if car.load != AIR:
        return CARRIES
    own = kind_at(w, car.x, car.y, car.z)
    if own not in (BLOCK, FLAG, FSLOPE):
        return NOTHING_TO_LIFT
    on_top = occupant_of(w, car.x, car.y, car.z, me)
    if on_top != NOTHING:
        return because(THING_ON_TOP, on_top)
    if w.corrections & REACHING_LOAD and below_leaning(w, me, car):
        return REACHING_LOAD_HITS
    if w.corrections & OVERHEAD_WALL and kind_at(w, car.x, car.y, car.z + 1) == WALL:
        return WALL_OVERHEAD
    return why_gear(w, me, car, yaw_at(w, car.x, car.y, car.z)) if own == FSLOPE else LEGAL


@compiled
def why_drop(w: World, me: int, car: Pose) -> int:
    """DROP: a load and a cell for it, whatever that cell holds (docs/rules.md#drop-overwrites)."""
    if car.load == AIR:
        return CARRIES_NOTHING
    if car.z >= w.cells.shape[2]:
        return ABOVE_TOP_LEVEL
    return why_gear(w, me, car, car.load_yaw) if car.load == FSLOPE else LEGAL


@compiled
def why_gear(w: World, me: int, car: Pose, yaw: int) -> int:
    """Look whether the gear of a slope that is lifted or set down in a car's cell crosses something in the next one."""
    if not w.corrections & CROSSING_GEAR:
        return LEGAL
    x, y = car.x + dir_x(yaw), car.y + dir_y(yaw)
    if gear_across(w, me, x, y, car.z, yaw) or car_in(w, me, x, y, car.z, True) >= 0:
        return GEARS_CROSS
    return GEARS_CROSS if kind_at(w, x, y, car.z) == FOOT and (yaw_at(w, x, y, car.z) - yaw) & 1 else LEGAL


@compiled
def why_fold(w: World, me: int, car: Pose) -> int:
    """FOLD: an unfolded slope in the own cell with nothing on its body and no car on its foot."""
    if kind_at(w, car.x, car.y, car.z) != BODY:
        return NO_RAMP_HERE
    on_top = occupant_of(w, car.x, car.y, car.z, me)
    if on_top != NOTHING:
        return because(THING_ON_TOP, on_top)
    yaw = yaw_at(w, car.x, car.y, car.z)
    on_foot = occupant_of(w, car.x + dir_x(yaw), car.y + dir_y(yaw), car.z - 1, me)
    return because(CAR_ON_OWN_FOOT, on_foot) if on_foot >= 0 else why_flap(w, me, car, yaw)


@compiled
def why_unfold(w: World, me: int, car: Pose) -> int:
    """UNFOLD: a folded slope in the own cell, room and support for the foot, and no landing of a ramp below."""
    if car.load != AIR:
        return CARRIES
    if kind_at(w, car.x, car.y, car.z) != FSLOPE:
        return NO_SLOPE_HERE
    yaw = yaw_at(w, car.x, car.y, car.z)
    x, y = car.x + dir_x(yaw), car.y + dir_y(yaw)
    if not is_air_or_gear(kind_at(w, x, y, car.z)):
        return FOOT_BLOCKED
    if not standable(kind_at(w, x, y, car.z - 1)):
        return FOOT_UNSUPPORTED
    if is_landing(w, x, y, car.z - 1):
        return LANDING_BELOW_FOOT
    return LANDING_BELOW_BODY if is_landing(w, car.x, car.y, car.z - 1) else why_flap(w, me, car, yaw)


@compiled
def why_flap(w: World, me: int, car: Pose, yaw: int) -> int:
    """Look whether the flap of the slope in a car's cell can swing, which CraftEnv's rules do not (docs/rules.md#flap).

    It is 0.43 m high on its way.
    """
    fx, fy = car.x + dir_x(yaw), car.y + dir_y(yaw)
    bx, by = fx + dir_x(yaw), fy + dir_y(yaw)
    if w.corrections & SWINGING_FLAP and not flap_has_room(w, me, car, yaw, fx, fy, bx, by):
        return FLAP_HITS
    if w.corrections & REACHING_LOAD:
        for z in range(car.z + 1, car.z + 3):
            if leans_into(w, me, car.x, car.y, z, -1) or leans_into(w, me, fx, fy, z, -1):
                return REACHING_LOAD_HITS
        if reaches_up(w, me, bx, by, car.z, LIP_MM):
            return REACHING_LOAD_HITS
    if w.corrections & OVERHEAD_WALL:
        for z in range(car.z + 1, car.z + 3):
            if kind_at(w, car.x, car.y, z) == WALL or kind_at(w, fx, fy, z) == WALL:
                return WALL_OVERHEAD
    return LEGAL


@compiled
def flap_has_room(w: World, me: int, car: Pose, yaw: int, fx: int, fy: int, bx: int, by: int) -> bool:
    """Return whether a flap can swing between the cells of its foot (fx, fy) and the next one (bx, by).

    Its lip goes 12 mm into that. There may stand an unloaded car, a foot whose low end is towards this one's, and a
    gear that points at it.
    """
    facing = (yaw + 2) & 3
    beyond = kind_at(w, bx, by, car.z) if inside(w, bx, by, car.z) else AIR
    if not is_air_or_gear(beyond) and not (beyond == FOOT and yaw_at(w, bx, by, car.z) == facing):
        return False
    if car_in(w, me, fx, fy, car.z, False) >= 0 or car_in(w, me, bx, by, car.z, True) >= 0:
        return False
    if leans_into(w, me, car.x, car.y, car.z, -1) or leans_into(w, me, fx, fy, car.z, -1):
        return False
    if leans_into(w, me, bx, by, car.z, facing) or gear_across(w, me, bx, by, car.z, yaw):
        return False
    for z in range(car.z, car.z + 2):
        if gear_across(w, me, fx, fy, z, yaw):
            return False
    return not gear_across(w, me, car.x, car.y, car.z + 1, yaw)


@compiled
def why_rotate(w: World, me: int, car: Pose, turn: int) -> int:
    """Turn by +1 or -1: unloaded not under a slope; loaded only with room all round for the load."""
    if car.load == AIR:
        own = kind_at(w, car.x, car.y, car.z)
        return TURN_UNDER_SLOPE if own in (FSLOPE, BODY) else LEGAL
    for d in range(4):
        x, y = car.x + dir_x(d), car.y + dir_y(d)
        neighbour = kind_at(w, x, y, car.z)
        facing = neighbour == GEAR and yaw_at(w, x, y, car.z) == (d + 2) & 3
        if neighbour != AIR and not facing:
            return because(LOAD_HITS_THING, d)
    corner_x = car.x + dir_x(car.load_yaw) + dir_x(car.load_yaw + turn)
    corner_y = car.y + dir_y(car.load_yaw) + dir_y(car.load_yaw + turn)
    if car.load == FSLOPE and not is_air_or_gear(kind_at(w, corner_x, corner_y, car.z)):
        return SLOPE_HITS_CORNER
    for other in range(w.cars.shape[0]):
        if other == me or w.cars[other, F_Z] != car.z or w.cars[other, F_LOAD] == AIR:
            continue
        ox, oy = car_field(w, other, F_X), car_field(w, other, F_Y)
        if abs(ox - car.x) + abs(oy - car.y) == 1 or (
            car.load == FSLOPE and ox == corner_x and oy == corner_y
        ):
            return because(LOAD_HITS_LOAD, other)
        if w.cars[other, F_LOAD] == FSLOPE:
            yaw = car_field(w, other, F_LOAD_YAW)
            gx, gy = ox + dir_x(yaw), oy + dir_y(yaw)
            points_at_me = gx + dir_x(yaw) == car.x and gy + dir_y(yaw) == car.y
            if abs(gx - car.x) + abs(gy - car.y) == 1 and not points_at_me:
                return because(LOAD_HITS_GEAR, other)
    return why_turning_load(w, me, car)


@compiled
def why_turning_load(w: World, me: int, car: Pose) -> int:
    """Look whether a load that turns meets a car, a load that leans or reaches in, or a wall overhead."""
    legs_mm = 42 if car.load == FSLOPE else 32
    turning, reaching, wall = False, w.corrections & REACHING_LOAD != 0 and below_leaning(w, me, car), False
    for d in range(4):
        x, y = car.x + dir_x(d), car.y + dir_y(d)
        if w.corrections & TURNING_LOAD:
            turning |= leans_into(w, me, x, y, car.z, (d + 2) & 3) or car_in(w, me, x, y, car.z, False) >= 0
        if w.corrections & REACHING_LOAD and not reaching:
            reaching = reaches_up(w, me, x, y, car.z, legs_mm) or leans_into(w, me, x, y, car.z + 1, -1)
        wall |= w.corrections & OVERHEAD_WALL != 0 and kind_at(w, x, y, car.z + 1) == WALL
    if turning:
        return TURNING_LOAD_HITS
    if reaching:
        return REACHING_LOAD_HITS
    return WALL_OVERHEAD if wall else LEGAL


# Moves


@compiled
def moved(w: World, car: Pose, m: int) -> Pose:
    """Return a car's state after a move in direction m: onto, along or off a slope, or on the flat."""
    x, y = car.x + dir_x(m), car.y + dir_y(m)
    here = kind_at(w, x, y, car.z)
    below = kind_at(w, x, y, car.z - 1)
    z, slope = car.z, 0
    if here == FOOT and (car.slope == 0 or (w.corrections & SECOND_RAMP and car.slope == 2)):
        slope = 1
    elif car.slope == 1 and here == BODY:
        z, slope = car.z + 1, 2
    elif car.slope == 0 and below == BODY:
        slope = 2
    elif car.slope == 2 and below == FOOT:
        z, slope = car.z - 1, 1
    return Pose(x, y, z, car.yaw, car.load, car.load_yaw, slope)


@compiled
def why_move(w: World, me: int, car: Pose, m: int) -> int:
    """Move in direction m (0..3)."""
    x, y = car.x + dir_x(m), car.y + dir_y(m)
    target, below = kind_at(w, x, y, car.z), kind_at(w, x, y, car.z - 1)
    # CraftEnv's rules take any body before a foot, and any foot below a top, for the same ramp's, and do not look for
    # cars there (docs/rules.md#own-ramp, docs/rules.md#shared-cell).
    up, down = car.slope == 1 and target == BODY, car.slope == 2 and below == FOOT
    if car.slope != 0 and m != car.yaw:
        return ON_SLOPE
    if not (up or down):
        reason = why_flat(w, me, car, m, x, y, target, below)
        if reason != LEGAL:
            return reason
    if w.corrections == 0:
        return LEGAL
    if car.load != AIR and w.corrections & LEANING_LOAD and not load_fits(w, me, car, moved(w, car, m)):
        return LEANING_LOAD_HITS
    if car.slope != 0 and w.corrections & OWN_RAMP:
        if up and not (yaw_at(w, x, y, car.z) == (m + 2) & 3 and car_in(w, me, x, y, car.z + 1, False) < 0):
            return OTHER_RAMP
        if down and not (yaw_at(w, x, y, car.z - 1) == m and car_in(w, me, x, y, car.z - 1, False) < 0):
            return OTHER_RAMP
        if not (up or down) and below == BODY:
            return OTHER_RAMP
    # CraftEnv's rules do not look at what is below a gear (docs/rules.md#through-a-gear).
    over_ramp = target == GEAR and below == BODY
    if w.corrections & RAMP_BELOW_GEAR and over_ramp and why_descent(w, me, car, m, x, y) != LEGAL:
        return RAMP_UNDER_GEAR
    if car.load != AIR and w.corrections & REACHING_LOAD and not clears_levels(w, me, car, moved(w, car, m)):
        return REACHING_LOAD_HITS
    if w.corrections & OVERHEAD_WALL:
        climbs = target == FOOT and not down
        over_body = climbs and kind_at(w, x + dir_x(m), y + dir_y(m), car.z + 1) == WALL
        if over_body or (up and kind_at(w, x, y, car.z + 1) == WALL):
            return WALL_OVERHEAD
        if car.load != AIR and not load_below_walls(w, car, moved(w, car, m)):
            return WALL_OVERHEAD
    if w.corrections & RUN_OUT and car.slope == 1 and target in (BLOCK, FLAG):
        return UNDER_THING_AT_END
    return LEGAL


@compiled
def why_flat(w: World, me: int, car: Pose, m: int, x: int, y: int, target: int, below: int) -> int:
    """Look whether a car that is not on its way along a ramp could move in direction m, to (x, y)."""
    forward, along = m == car.yaw, (m - car.yaw) & 1 == 0
    loaded = car.load != AIR
    own = kind_at(w, car.x, car.y, car.z)
    if own in (FSLOPE, BODY) and not forward:
        return FORWARD_ONLY
    if own in (BLOCK, FLAG) and not along:
        return NOT_SIDEWAYS
    if not standable(below) and below != BODY:
        return IN_THE_WAY if target == WALL else NO_FLOOR
    other = car_in(w, me, x, y, car.z, False)
    if other >= 0:
        return because(CAR_THERE, other)
    if loaded and car.slope == 0:
        if carried_gear_in(w, me, x, y, car.z, -1):
            return GEAR_THERE
        if car.load == FSLOPE and not gear_has_room(w, me, car, m):
            return GEAR_NO_ROOM
    if target == AIR:
        return why_descent(w, me, car, m, x, y) if below == BODY else LEGAL
    if target == FOOT:
        return why_ascent(w, me, car, m, x, y)
    if target not in (BLOCK, FLAG, FSLOPE, BODY, GEAR):
        return IN_THE_WAY
    if loaded:
        return LOAD_NOT_THROUGH_GEAR if target == GEAR else LOAD_NOT_UNDER
    if target in (BLOCK, FLAG) and not along:
        return ENTERED_SIDEWAYS
    if target in (FSLOPE, BODY) and not (
        along and not forward and (car.yaw - yaw_at(w, x, y, car.z)) & 3 == 2
    ):
        return HIGH_SIDE_ONLY
    return LEGAL


@compiled
def gear_has_room(w: World, me: int, car: Pose, m: int) -> bool:
    """Return whether the gear of the slope that a car on the flat carries has room beside its way in direction m."""
    x, y = car.x + dir_x(car.yaw + 2) + dir_x(m), car.y + dir_y(car.yaw + 2) + dir_y(m)
    facing = (car.load_yaw + 2) & 3
    swept = kind_at(w, x, y, car.z)
    if not is_air_or_gear(swept) or (swept == GEAR and yaw_at(w, x, y, car.z) != facing):
        return False
    return car_in(w, me, x, y, car.z, True) < 0 and not carried_gear_in(w, me, x, y, car.z, facing)


@compiled
def why_descent(w: World, me: int, car: Pose, m: int, x: int, y: int) -> int:
    """Drive down onto the slope whose body is below the target cell (x, y).

    Of the landing only the mark under it is looked at (docs/rules.md#landing-not-inspected).
    """
    if kind_at(w, car.x, car.y, car.z) not in (AIR, BLOCK, FLAG):
        return NO_DESCENT_FROM
    if m != car.yaw or m != yaw_at(w, x, y, car.z - 1):
        return DOWN_FORWARD_ONLY
    on_body = occupant_of(w, x, y, car.z - 1, me)
    if on_body != NOTHING:
        return because(THING_ON_BODY_BELOW, on_body)
    x, y = x + dir_x(m), y + dir_y(m)
    on_foot = occupant_of(w, x, y, car.z - 2, me)
    if on_foot >= 0:
        return because(CAR_ON_FOOT_BELOW, on_foot)
    x, y = x + dir_x(m), y + dir_y(m)
    if not standable(kind_at(w, x, y, car.z - 2)):
        return NO_FLOOR_AT_END
    at_end = occupant_of(w, x, y, car.z - 2, me)
    return because(THING_AT_END, at_end) if at_end != NOTHING else LEGAL


@compiled
def why_ascent(w: World, me: int, car: Pose, m: int, x: int, y: int) -> int:
    """Drive up onto the slope whose foot is in the target cell (x, y); a landing must stand behind its body."""
    if kind_at(w, car.x, car.y, car.z) != AIR:
        return NO_ASCENT_FROM
    if m != car.yaw or (m + 2) & 3 != yaw_at(w, x, y, car.z):
        return UP_FORWARD_ONLY
    on_foot = occupant_of(w, x, y, car.z - 1, me)
    if on_foot >= 0:
        return because(CAR_ON_FOOT, on_foot)
    x, y = x + dir_x(m), y + dir_y(m)
    on_body = occupant_of(w, x, y, car.z, me)
    if on_body != NOTHING:
        return because(THING_ON_BODY, on_body)
    x, y = x + dir_x(m), y + dir_y(m)
    if not standable(kind_at(w, x, y, car.z)):
        return NO_LANDING
    on_landing = occupant_of(w, x, y, car.z, me)
    if on_landing >= 0:
        return because(CAR_ON_LANDING, on_landing)
    over = kind_at(w, x, y, car.z + 1)
    free = over == AIR or (over in (BLOCK, FLAG) and car.load == AIR)
    return LEGAL if free else NO_ROOM_ON_LANDING


@compiled
def load_fits(w: World, me: int, old: Pose, new: Pose) -> bool:
    """Return whether a load fits on a ramp, off a ramp, and beside a load that leans on one.

    On the upper half it would meet gears that hang above body or foot from the side; and where it ends up leaning,
    nothing may be but a gear that points at it.
    """
    for half in (old, new):
        downhill = downhill_of(w, half.x, half.y, half.z, half.slope)
        if half.slope != 0 and gear_across(w, me, half.x, half.y, half.z, downhill):
            return False
        if half.slope == 2:
            x, y = half.x + dir_x(downhill), half.y + dir_y(downhill)
            if gear_across(w, me, x, y, half.z - 1, downhill) or gear_across(w, me, x, y, half.z, downhill):
                return False
    if new.slope == 0:
        gx, gy = new.x + dir_x(new.load_yaw), new.y + dir_y(new.load_yaw)
        if new.load == FSLOPE and leans_into(w, me, gx, gy, new.z, (new.load_yaw + 2) & 3):
            return False
        leans = leans_into(w, me, new.x, new.y, new.z, -1)
        return not leans and not carried_gear_in(w, me, new.x, new.y, new.z, -1)
    downhill = downhill_of(w, new.x, new.y, new.z, new.slope)
    x, y = new.x + dir_x(downhill), new.y + dir_y(downhill)
    if not is_air_or_gear(kind_at(w, x, y, new.z)) and not (x == old.x and y == old.y):
        return False
    if car_in(w, me, x, y, new.z, True) >= 0 or gear_across(w, me, x, y, new.z, downhill):
        return False
    return not leans_into(w, me, x, y, new.z, (downhill + 2) & 3)


@compiled
def clears_levels(w: World, me: int, old: Pose, new: Pose) -> bool:
    """Return whether a load that moves meets none that reaches up from the level below or leans over from above."""
    if below_leaning(w, me, old) or below_leaning(w, me, new):
        return False
    if new.slope != 0:
        return not leans_into(w, me, new.x, new.y, new.z, -1)
    if new.load != FSLOPE:
        return True
    for pose in (old, new):
        x, y = pose.x + dir_x(pose.load_yaw), pose.y + dir_y(pose.load_yaw)
        if reaches_up(w, me, x, y, pose.z, GEAR_MM):
            return False
    return True


@compiled
def load_below_walls(w: World, old: Pose, new: Pose) -> bool:
    """Return whether no wall is above a load on its way, or above where it leans on a ramp's foot."""
    if kind_at(w, old.x, old.y, old.z + 1) == WALL or kind_at(w, new.x, new.y, new.z + 1) == WALL:
        return False
    if new.slope != 1:
        return True
    downhill = downhill_of(w, new.x, new.y, new.z, 1)
    return kind_at(w, new.x + dir_x(downhill), new.y + dir_y(downhill), new.z + 1) != WALL


# All actions


@compiled
def why(w: World, me: int, car: Pose, action: int) -> int:
    """Return why car ``me``, were it in the state ``car``, could not do a primitive action now; 0 if it could."""
    if FIRST_MOVE <= action <= LAST_MOVE:
        return why_move(w, me, car, move_direction(action))
    if not 0 <= action <= STOP:
        return NEVER
    if car.slope != 0:
        return ON_SLOPE
    if action == LIFT:
        return why_lift(w, me, car)
    if action == DROP:
        return why_drop(w, me, car)
    if action == FOLD:
        return why_fold(w, me, car)
    if action == UNFOLD:
        return why_unfold(w, me, car)
    if action == STOP:
        return LEGAL
    return why_rotate(w, me, car, 1 if action == ROTATE_LEFT else -1)


@compiled(inline=False)
def legal_actions(w: World, me: int, car: Pose, first: int, last: int) -> int:
    """Return which of the actions from ``first`` to ``last`` are legal, a bit each, as :func:`why` says.

    It is called, not inlined: so the rules above are compiled once.
    """
    legal = 0
    for action in range(first, last + 1):
        if why(w, me, car, action) == LEGAL:
            legal |= 1 << action
    return legal


# What a legal action changes, the event-driven marks included (docs/rules.md#marks)


@compiled
def put(w: World, x: int, y: int, z: int, kind: int, yaw: int) -> None:
    """Replace whatever is in a cell (docs/rules.md#drop-overwrites); the newcomer's marks start blank.

    Cells beside the map stay wall.
    """
    if inside(w, x, y, z):
        w.cells[x, y, z, KIND] = kind
        w.cells[x, y, z, YAW] = yaw
        w.cells[x, y, z, OCCUPANT] = NOTHING
        w.cells[x, y, z, LANDING] = 0


@compiled
def put_gear(w: World, x: int, y: int, z: int, kind: int, yaw: int) -> None:
    """Put a gear into a cell, or with AIR take one away, whatever is there (docs/rules.md#lift-erases-gear-cell).

    When gears last, the cell shows one only where nothing stands, and as long as a slope beside it has its gear there:
    that of the least yaw if there are two.
    """
    if not w.corrections & LASTING_GEARS:
        put(w, x, y, z, kind, yaw)
        return
    if not is_air_or_gear(kind_at(w, x, y, z)):
        return
    kind, yaw = AIR, 0
    for d in range(3, -1, -1):
        sx, sy = x - dir_x(d), y - dir_y(d)
        if kind_at(w, sx, sy, z) == FSLOPE and yaw_at(w, sx, sy, z) == d:
            kind, yaw = GEAR, d
    put(w, x, y, z, kind, yaw)


@compiled
def set_occupant(w: World, x: int, y: int, z: int, mark: int) -> None:
    """Set the mark "what is on me" of a cell."""
    if inside(w, x, y, z):
        w.cells[x, y, z, OCCUPANT] = mark


@compiled
def set_landing(w: World, x: int, y: int, z: int, mark: bool) -> None:
    """Set the mark "I am the landing of a ramp" of a cell; only blocks carry it."""
    if kind_at(w, x, y, z) == BLOCK:
        w.cells[x, y, z, LANDING] = mark


@compiled
def turned(car: Pose, turn: int) -> Pose:
    """Return a car's state after a turn by +1 or -1; a carried slope turns with it."""
    load_yaw = (car.load_yaw + turn) & 3 if car.load == FSLOPE else 0
    return Pose(car.x, car.y, car.z, (car.yaw + turn) & 3, car.load, load_yaw, car.slope)


@compiled
def write_pose(w: World, me: int, car: Pose) -> None:
    """Store a car's state."""
    w.cars[me, F_X] = car.x
    w.cars[me, F_Y] = car.y
    w.cars[me, F_Z] = car.z
    w.cars[me, F_YAW] = car.yaw
    w.cars[me, F_LOAD] = car.load
    w.cars[me, F_LOAD_YAW] = car.load_yaw
    w.cars[me, F_SLOPE] = car.slope


@compiled
def exchange(w: World, me: int, car: Pose, lifting: bool) -> None:
    """Take up the object in the own cell, a slope with its gear, or put the load there."""
    kind = kind_at(w, car.x, car.y, car.z) if lifting else car.load
    yaw = yaw_at(w, car.x, car.y, car.z) if lifting else car.load_yaw
    put(w, car.x, car.y, car.z, AIR if lifting else kind, 0 if lifting else yaw)
    if kind == FSLOPE:
        gear = AIR if lifting else GEAR
        put_gear(w, car.x + dir_x(yaw), car.y + dir_y(yaw), car.z, gear, 0 if lifting else yaw)
    if kind == BLOCK and not lifting:
        set_landing(w, car.x, car.y, car.z, derived_landing(w, car.x, car.y, car.z))
    load, load_yaw = (kind, yaw if kind == FSLOPE else 0) if lifting else (AIR, 0)
    write_pose(w, me, Pose(car.x, car.y, car.z, car.yaw, load, load_yaw, car.slope))
    set_occupant(w, car.x, car.y, car.z - 1, me)


@compiled
def swing(w: World, car: Pose, folding: bool) -> None:
    """Turn the ramp in the own cell into a folded slope, or a folded slope into a ramp behind the car.

    The landing of a folded ramp is unmarked even if another ramp leans there (docs/rules.md#landing-forgotten).
    """
    yaw = (car.yaw + 2) & 3
    x, y = car.x + dir_x(yaw), car.y + dir_y(yaw)
    put(w, car.x, car.y, car.z, FSLOPE if folding else BODY, yaw)
    put(w, x, y, car.z, AIR if folding else FOOT, 0 if folding else yaw)
    if folding:
        put_gear(w, x, y, car.z, GEAR, yaw)
    set_occupant(w, x, y, car.z - 1, NOTHING if folding else OBJECT)
    set_landing(w, car.x + dir_x(car.yaw), car.y + dir_y(car.yaw), car.z, not folding)


@compiled
def drive(w: World, me: int, car: Pose, m: int) -> None:
    """Drive to the next cell in direction m."""
    new = moved(w, car, m)
    # A gear left behind counts as an object here, though not elsewhere (docs/rules.md#gear-mark).
    left_air = kind_at(w, car.x, car.y, car.z) == AIR
    set_occupant(w, car.x, car.y, car.z - 1, NOTHING if left_air else OBJECT)
    set_occupant(w, new.x, new.y, new.z - 1, me)
    write_pose(w, me, new)


@compiled(inline=False)
def apply(w: World, me: int, action: int) -> None:
    """Carry out an action that is legal; the diagonal moves never are, and STOP changes nothing."""
    car = pose_of(w, me)
    if FIRST_MOVE <= action <= LAST_MOVE:
        drive(w, me, car, move_direction(action))
    elif action in (ROTATE_LEFT, ROTATE_RIGHT):
        write_pose(w, me, turned(car, 1 if action == ROTATE_LEFT else -1))
    elif action in (LIFT, DROP):
        exchange(w, me, car, action == LIFT)
    elif action in (FOLD, UNFOLD):
        swing(w, car, action == FOLD)


@compiled
def act(w: World, me: int, action: int) -> bool:
    """Carry out an action if it is legal now, else leave the world as it is; return whether it was."""
    if legal_actions(w, me, pose_of(w, me), action, action) == 0:
        return False
    apply(w, me, action)
    return True
