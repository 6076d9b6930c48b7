"""When a move to a neighbouring column is legal, on the flat, under objects, and up and down slopes."""

from __future__ import annotations

from craftsim.discrete.rules.cells import (
    AIR,
    BLOCK,
    BODY,
    F_LOAD,
    F_LOAD_YAW,
    F_X,
    F_Y,
    F_Z,
    FLAG,
    FOOT,
    FSLOPE,
    GEAR,
    NOTHING,
    Pose,
    World,
    dir_x,
    dir_y,
    is_air_or_gear,
    kind_at,
    standable,
    top_at,
    yaw_at,
)
from craftsim.discrete.rules.compiled import compiled


@compiled
def carried_gear_in(w: World, me: int, x: int, y: int, z: int, tolerated_yaw: int) -> bool:
    """Return whether another car carries a gear in a cell; ``tolerated_yaw`` (-1: none) is not seen."""
    for other in range(w.cars.shape[0]):
        if (
            other == me
            or w.cars[other, F_LOAD] != FSLOPE
            or w.cars[other, F_Z] != z
            or w.cars[other, F_LOAD_YAW] == tolerated_yaw
        ):
            continue
        if (
            w.cars[other, F_X] + dir_x(w.cars[other, F_LOAD_YAW]) == x
            and w.cars[other, F_Y] + dir_y(w.cars[other, F_LOAD_YAW]) == y
        ):
            return True
    return False


@compiled
def car_in(w: World, me: int, x: int, y: int, z: int, only_loaded: bool) -> bool:
    """Return whether another car, or another loaded car, is in a cell."""
    for other in range(w.cars.shape[0]):
        if other == me or (only_loaded and w.cars[other, F_LOAD] == AIR):
            continue
        if w.cars[other, F_X] == x and w.cars[other, F_Y] == y and w.cars[other, F_Z] == z:
            return True
    return False


@compiled
def load_has_room(w: World, me: int, car: Pose, m: int) -> bool:
    """Return whether the load of a car on the flat can be carried along in direction m."""
    if carried_gear_in(w, me, car.x + dir_x(m), car.y + dir_y(m), car.z, -1):
        return False
    if car.load != FSLOPE:
        return True
    sx, sy = car.x + dir_x(car.yaw + 2) + dir_x(m), car.y + dir_y(car.yaw + 2) + dir_y(m)
    facing = (car.load_yaw + 2) & 3
    swept = kind_at(w, sx, sy, car.z)
    if not is_air_or_gear(swept) or (swept == GEAR and yaw_at(w, sx, sy, car.z) != facing):
        return False
    return not car_in(w, me, sx, sy, car.z, True) and not carried_gear_in(w, me, sx, sy, car.z, facing)


@compiled
def descent_legal(w: World, me: int, car: Pose, m: int) -> bool:
    """Drive down onto the slope whose body is below the target cell.

    Of the landing only the mark under it is looked at (docs/rules.md#landing-not-inspected).
    """
    own = kind_at(w, car.x, car.y, car.z)
    if own != AIR and own != BLOCK and own != FLAG:
        return False
    x1, y1 = car.x + dir_x(m), car.y + dir_y(m)
    if m != car.yaw or m != yaw_at(w, x1, y1, car.z - 1) or top_at(w, x1, y1, car.z - 1, me) != NOTHING:
        return False
    x2, y2 = x1 + dir_x(m), y1 + dir_y(m)
    if top_at(w, x2, y2, car.z - 2, me) >= 0:
        return False
    x3, y3 = x2 + dir_x(m), y2 + dir_y(m)
    return standable(kind_at(w, x3, y3, car.z - 2)) and top_at(w, x3, y3, car.z - 2, me) == NOTHING


@compiled
def ascent_legal(w: World, me: int, car: Pose, m: int) -> bool:
    """Drive up onto the slope whose foot is in the target cell; a landing must stand behind its body."""
    x1, y1 = car.x + dir_x(m), car.y + dir_y(m)
    if kind_at(w, car.x, car.y, car.z) != AIR or m != car.yaw or (m + 2) & 3 != yaw_at(w, x1, y1, car.z):
        return False
    x2, y2 = x1 + dir_x(m), y1 + dir_y(m)
    if top_at(w, x1, y1, car.z - 1, me) >= 0 or top_at(w, x2, y2, car.z, me) != NOTHING:
        return False
    x3, y3 = x2 + dir_x(m), y2 + dir_y(m)
    if not standable(kind_at(w, x3, y3, car.z)) or top_at(w, x3, y3, car.z, me) >= 0:
        return False
    over = kind_at(w, x3, y3, car.z + 1)
    return over == AIR or (over in (BLOCK, FLAG) and car.load == AIR)


@compiled
def move_legal(w: World, me: int, car: Pose, m: int) -> bool:
    """Return whether car ``me``, were it in the state ``car``, could move in direction m (0..3)."""
    forward = m == car.yaw
    backward = (m + 2) & 3 == car.yaw
    nx, ny = car.x + dir_x(m), car.y + dir_y(m)
    target = kind_at(w, nx, ny, car.z)
    below = kind_at(w, nx, ny, car.z - 1)
    if car.slope != 0:
        if not forward:
            return False
        # On a ramp the next half is entered without looking for cars (docs/rules.md#shared-cell).
        if (car.slope == 1 and target == BODY) or (car.slope == 2 and below == FOOT):
            return True
    own = kind_at(w, car.x, car.y, car.z)
    if own in (FSLOPE, BODY) and not forward:
        return False
    if own in (BLOCK, FLAG) and not (forward or backward):
        return False
    if not standable(below) and below != BODY:
        return False
    if car_in(w, me, nx, ny, car.z, False):
        return False
    loaded = car.load != AIR
    if loaded and car.slope == 0 and not load_has_room(w, me, car, m):
        return False
    if target == AIR:
        return below != BODY or descent_legal(w, me, car, m)
    if target in (BLOCK, FLAG):
        return not loaded and (forward or backward)
    if target in (FSLOPE, BODY):
        return not loaded and backward and car.yaw == (yaw_at(w, nx, ny, car.z) + 2) & 3
    if target == GEAR:
        # What is below a gear is not looked at (docs/rules.md#through-a-gear).
        return not loaded
    if target == FOOT:
        return ascent_legal(w, me, car, m)
    return False
