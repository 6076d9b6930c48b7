"""When a move to a neighbouring column is legal, on the flat, under objects, and up and down slopes."""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    BODY,
    FLAG,
    FOOT,
    FSLOPE,
    GEAR,
    LEANING_LOAD,
    NOTHING,
    OWN_RAMP,
    RAMP_BELOW_GEAR,
    RUN_OUT,
    SECOND_RAMP,
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
from craftsim.discrete.rules.levels import load_below_walls, load_clears_levels, wall_over
from craftsim.discrete.rules.reach import car_in, carried_gear_in, load_fits


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
    if wall_over(w, x2, y2, car.z):
        return False
    over = kind_at(w, x3, y3, car.z + 1)
    return over == AIR or (over in (BLOCK, FLAG) and car.load == AIR)


@compiled
def goes_on(w: World, me: int, car: Pose, m: int) -> bool:
    """Return whether a car on a ramp that moves forward comes to its other half.

    CraftEnv's rules take any body before a foot, and any foot below a top, for the same ramp's, and do not look for
    cars there (docs/rules.md#own-ramp, docs/rules.md#shared-cell).
    """
    nx, ny = car.x + dir_x(m), car.y + dir_y(m)
    up = car.slope == 1 and kind_at(w, nx, ny, car.z) == BODY
    down = car.slope == 2 and kind_at(w, nx, ny, car.z - 1) == FOOT
    if up and wall_over(w, nx, ny, car.z):
        return False
    if not w.corrections & OWN_RAMP:
        return up or down
    if up:
        return yaw_at(w, nx, ny, car.z) == (m + 2) & 3 and not car_in(w, me, nx, ny, car.z + 1, False)
    return down and yaw_at(w, nx, ny, car.z - 1) == m and not car_in(w, me, nx, ny, car.z - 1, False)


@compiled
def move_legal(w: World, me: int, car: Pose, m: int) -> bool:
    """Return whether car ``me``, were it in the state ``car``, could move in direction m (0..3)."""
    forward = m == car.yaw
    backward = (m + 2) & 3 == car.yaw
    nx, ny = car.x + dir_x(m), car.y + dir_y(m)
    target = kind_at(w, nx, ny, car.z)
    below = kind_at(w, nx, ny, car.z - 1)
    loaded = car.load != AIR
    if loaded and w.corrections & LEANING_LOAD and not load_fits(w, me, car, moved(w, car, m)):
        return False
    if loaded and not (
        load_below_walls(w, car, moved(w, car, m)) and load_clears_levels(w, me, car, moved(w, car, m))
    ):
        return False
    if car.slope != 0:
        if not forward:
            return False
        if goes_on(w, me, car, m):
            return True
        if w.corrections & OWN_RAMP and below == BODY:
            return False
    own = kind_at(w, car.x, car.y, car.z)
    if own in (FSLOPE, BODY) and not forward:
        return False
    if own in (BLOCK, FLAG) and not (forward or backward):
        return False
    if not standable(below) and below != BODY:
        return False
    if car_in(w, me, nx, ny, car.z, False):
        return False
    if loaded and car.slope == 0 and not load_has_room(w, me, car, m):
        return False
    if target == AIR:
        return below != BODY or descent_legal(w, me, car, m)
    if target in (BLOCK, FLAG):
        if w.corrections & RUN_OUT and car.slope == 1:
            return False
        return not loaded and (forward or backward)
    if target in (FSLOPE, BODY):
        return not loaded and backward and car.yaw == (yaw_at(w, nx, ny, car.z) + 2) & 3
    if target == GEAR:
        # CraftEnv's rules do not look at what is below a gear (docs/rules.md#through-a-gear).
        through = not w.corrections & RAMP_BELOW_GEAR or below != BODY or descent_legal(w, me, car, m)
        return not loaded and through
    if target == FOOT:
        return ascent_legal(w, me, car, m)
    return False
