"""When LIFT, DROP, FOLD, UNFOLD, a turn or STOP is legal; docs/rules.md explains the oddities."""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    BODY,
    F_LOAD,
    F_LOAD_YAW,
    F_X,
    F_Y,
    F_Z,
    FLAG,
    FSLOPE,
    GEAR,
    NOTHING,
    REACHING_LOAD,
    SWINGING_FLAP,
    TURNING_LOAD,
    Pose,
    World,
    back_at,
    car_field,
    dir_x,
    dir_y,
    is_air_or_gear,
    kind_at,
    standable,
    top_at,
    yaw_at,
)
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules.levels import below_leaning, flap_clears_levels, turn_clears_levels, wall_over
from craftsim.discrete.rules.reach import flap_has_room, gear_has_room, leans_into

ROTATE_LEFT = int(Action.ROTATE_LEFT)
ROTATE_RIGHT = int(Action.ROTATE_RIGHT)
FIRST_MOVE = int(Action.MOVE_FORWARD)
LAST_MOVE = int(Action.MOVE_RIGHT)
STOP = int(Action.STOP)
N_ACTIONS = len(Action)


@compiled
def move_direction(action: int) -> int:
    """Return the direction 0..3 of one of the four move actions 6..9 (+y, -y, -x, +x)."""
    step = action - FIRST_MOVE
    return 1 if step == 0 else (3 if step == 1 else (2 if step == 2 else 0))


@compiled
def lift_legal(w: World, me: int, car: Pose) -> bool:
    """LIFT: no load, something to lift in the own cell, and nothing on it."""
    if car.load != AIR:
        return False
    own = kind_at(w, car.x, car.y, car.z)
    if own not in (BLOCK, FLAG, FSLOPE):
        return False
    if top_at(w, car.x, car.y, car.z, me) != NOTHING or wall_over(w, car.x, car.y, car.z):
        return False
    if w.corrections & REACHING_LOAD and below_leaning(w, me, car):
        return False
    return own != FSLOPE or gear_has_room(w, me, car, yaw_at(w, car.x, car.y, car.z))


@compiled
def drop_legal(w: World, me: int, car: Pose) -> bool:
    """DROP: a load and a cell for it, whatever that cell holds (docs/rules.md#drop-overwrites)."""
    if car.load == AIR or car.z >= w.cells.shape[2]:
        return False
    return car.load != FSLOPE or gear_has_room(w, me, car, car.load_yaw)


@compiled
def swing_legal(w: World, me: int, car: Pose, slope_yaw: int) -> bool:
    """FOLD and UNFOLD: room for the flap, which CraftEnv's rules do not look for (docs/rules.md#flap)."""
    if w.corrections & SWINGING_FLAP and not flap_has_room(w, me, car, slope_yaw):
        return False
    return flap_clears_levels(w, me, car, slope_yaw)


@compiled
def fold_legal(w: World, me: int, car: Pose) -> bool:
    """FOLD: an unfolded slope in the own cell with nothing on its body and no car on its foot."""
    if kind_at(w, car.x, car.y, car.z) != BODY or top_at(w, car.x, car.y, car.z, me) != NOTHING:
        return False
    slope_yaw = yaw_at(w, car.x, car.y, car.z)
    if top_at(w, car.x + dir_x(slope_yaw), car.y + dir_y(slope_yaw), car.z - 1, me) >= 0:
        return False
    return swing_legal(w, me, car, slope_yaw)


@compiled
def unfold_legal(w: World, me: int, car: Pose) -> bool:
    """UNFOLD: a folded slope in the own cell, room and support for the foot, and no landing of a ramp below."""
    if car.load != AIR or kind_at(w, car.x, car.y, car.z) != FSLOPE:
        return False
    slope_yaw = yaw_at(w, car.x, car.y, car.z)
    nx, ny = car.x + dir_x(slope_yaw), car.y + dir_y(slope_yaw)
    if not is_air_or_gear(kind_at(w, nx, ny, car.z)) or not standable(kind_at(w, nx, ny, car.z - 1)):
        return False
    if back_at(w, nx, ny, car.z - 1) or back_at(w, car.x, car.y, car.z - 1):
        return False
    return swing_legal(w, me, car, slope_yaw)


@compiled
def rotate_legal(w: World, me: int, car: Pose, turn: int) -> bool:
    """Turn by +1 or -1: unloaded not under a slope; loaded only with room all round for the load."""
    if car.load == AIR:
        own = kind_at(w, car.x, car.y, car.z)
        return own not in (FSLOPE, BODY)
    if not turn_clears_levels(w, me, car):
        return False
    for d in range(4):
        nx, ny = car.x + dir_x(d), car.y + dir_y(d)
        neighbour = kind_at(w, nx, ny, car.z)
        if neighbour == GEAR:
            if yaw_at(w, nx, ny, car.z) != (d + 2) & 3:
                return False
        elif neighbour != AIR:
            return False
        if w.corrections & TURNING_LOAD and leans_into(w, me, nx, ny, car.z, (d + 2) & 3):
            return False
        if wall_over(w, nx, ny, car.z):
            return False
    carries_slope = car.load == FSLOPE
    corner_x = car.x + dir_x(car.load_yaw) + dir_x(car.load_yaw + turn)
    corner_y = car.y + dir_y(car.load_yaw) + dir_y(car.load_yaw + turn)
    if carries_slope and not is_air_or_gear(kind_at(w, corner_x, corner_y, car.z)):
        return False
    for other in range(w.cars.shape[0]):
        if other == me or car_field(w, other, F_Z) != car.z:
            continue
        bare = car_field(w, other, F_LOAD) == AIR
        next_to_me = abs(car_field(w, other, F_X) - car.x) + abs(car_field(w, other, F_Y) - car.y) == 1
        if next_to_me and (not bare or w.corrections & TURNING_LOAD):
            return False
        if bare:
            continue
        if carries_slope and car_field(w, other, F_X) == corner_x and car_field(w, other, F_Y) == corner_y:
            return False
        if car_field(w, other, F_LOAD) == FSLOPE:
            gear_yaw = car_field(w, other, F_LOAD_YAW)
            gx, gy = car_field(w, other, F_X) + dir_x(gear_yaw), car_field(w, other, F_Y) + dir_y(gear_yaw)
            beside = abs(gx - car.x) + abs(gy - car.y) == 1
            points_at_me = gx + dir_x(gear_yaw) == car.x and gy + dir_y(gear_yaw) == car.y
            if beside and not points_at_me:
                return False
    return True
