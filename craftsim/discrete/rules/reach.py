"""What reaches out of its cell: gears, loads that lean on a ramp, and a flap that swings.

Gears are found by their slopes, standing or carried, since a cell shows only one gear. A load on a ramp leans downhill
with its car, by 40 to 60 mm, into the next cell. What comes straight towards its gear or it has room there, what moves
at a right angle to it has not.
"""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import (
    AIR,
    BODY,
    CROSSING_GEAR,
    F_LOAD,
    F_LOAD_YAW,
    F_SLOPE,
    F_X,
    F_Y,
    F_Z,
    FOOT,
    FSLOPE,
    GEAR,
    Pose,
    World,
    car_field,
    dir_x,
    dir_y,
    inside,
    is_air_or_gear,
    kind_at,
    yaw_at,
)


@compiled
def car_in(w: World, me: int, x: int, y: int, z: int, only_loaded: bool) -> bool:
    """Return whether another car, or another loaded car, is in a cell."""
    for other in range(w.cars.shape[0]):
        if other == me or (only_loaded and car_field(w, other, F_LOAD) == AIR):
            continue
        if car_field(w, other, F_X) == x and car_field(w, other, F_Y) == y and car_field(w, other, F_Z) == z:
            return True
    return False


@compiled
def carried_gear_in(w: World, me: int, x: int, y: int, z: int, tolerated_yaw: int) -> bool:
    """Return whether another car carries a gear in a cell; ``tolerated_yaw`` (-1: none) is not seen."""
    for other in range(w.cars.shape[0]):
        if (
            other == me
            or car_field(w, other, F_LOAD) != FSLOPE
            or car_field(w, other, F_Z) != z
            or car_field(w, other, F_LOAD_YAW) == tolerated_yaw
        ):
            continue
        if (
            car_field(w, other, F_X) + dir_x(car_field(w, other, F_LOAD_YAW)) == x
            and car_field(w, other, F_Y) + dir_y(car_field(w, other, F_LOAD_YAW)) == y
        ):
            return True
    return False


@compiled
def standing_gear_in(w: World, x: int, y: int, z: int) -> int:
    """Return the yaw of the gear of a standing slope in a cell, the least if there are two; -1 if there is none."""
    for yaw in range(4):
        sx, sy = x - dir_x(yaw), y - dir_y(yaw)
        if kind_at(w, sx, sy, z) == FSLOPE and yaw_at(w, sx, sy, z) == yaw:
            return yaw
    return -1


@compiled
def gear_across(w: World, me: int, x: int, y: int, z: int, along: int) -> bool:
    """Return whether a gear, standing or carried, reaches into a cell at a right angle to the direction ``along``."""
    for side in (along + 1, along + 3):
        yaw = side & 3
        sx, sy = x - dir_x(yaw), y - dir_y(yaw)
        if kind_at(w, sx, sy, z) == FSLOPE and yaw_at(w, sx, sy, z) == yaw:
            return True
        for other in range(w.cars.shape[0]):
            if other == me or car_field(w, other, F_LOAD) != FSLOPE or car_field(w, other, F_LOAD_YAW) != yaw:
                continue
            if (
                car_field(w, other, F_X) == sx
                and car_field(w, other, F_Y) == sy
                and car_field(w, other, F_Z) == z
            ):
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
        if other == me or car_field(w, other, F_SLOPE) == 0 or car_field(w, other, F_LOAD) == AIR:
            continue
        ox, oy, oz = car_field(w, other, F_X), car_field(w, other, F_Y), car_field(w, other, F_Z)
        if oz != z or abs(ox - x) + abs(oy - y) != 1:
            continue
        downhill = downhill_of(w, ox, oy, oz, car_field(w, other, F_SLOPE))
        if (
            downhill >= 0
            and downhill != tolerated
            and ox + dir_x(downhill) == x
            and oy + dir_y(downhill) == y
        ):
            return True
    return False


@compiled
def load_fits(w: World, me: int, old: Pose, new: Pose) -> bool:
    """Return whether a load fits on a ramp, off a ramp, and beside a load that leans on one.

    On the upper half it would meet gears that hang above body or foot from the side; and where it ends up leaning,
    nothing may be but a gear that points at it.
    """
    for half in (old, new):
        if half.slope == 2 and not below_gears(w, me, half):
            return False
        if half.slope == 1 and gear_across(
            w, me, half.x, half.y, half.z, downhill_of(w, half.x, half.y, half.z, 1)
        ):
            return False
    if new.slope == 0:
        gx, gy = new.x + dir_x(new.load_yaw), new.y + dir_y(new.load_yaw)
        if new.load == FSLOPE and leans_into(w, me, gx, gy, new.z, (new.load_yaw + 2) & 3):
            return False
        return not (
            leans_into(w, me, new.x, new.y, new.z, -1) or carried_gear_in(w, me, new.x, new.y, new.z, -1)
        )
    downhill = downhill_of(w, new.x, new.y, new.z, new.slope)
    x, y = new.x + dir_x(downhill), new.y + dir_y(downhill)
    if not is_air_or_gear(kind_at(w, x, y, new.z)) and not (x == old.x and y == old.y):
        return False
    return not (
        car_in(w, me, x, y, new.z, True)
        or gear_across(w, me, x, y, new.z, downhill)
        or leans_into(w, me, x, y, new.z, (downhill + 2) & 3)
    )


@compiled
def below_gears(w: World, me: int, car: Pose) -> bool:
    """Return whether no gear reaches in from a side above the ramp on whose upper half a car is."""
    downhill = downhill_of(w, car.x, car.y, car.z, 2)
    x, y = car.x + dir_x(downhill), car.y + dir_y(downhill)
    for z in (car.z - 1, car.z):
        if gear_across(w, me, x, y, z, downhill):
            return False
    return not gear_across(w, me, car.x, car.y, car.z, downhill)


@compiled
def flap_has_room(w: World, me: int, car: Pose, yaw: int) -> bool:
    """Return whether the flap of the slope in a car's cell can swing: its lip goes 12 mm beyond the foot's cell.

    There may stand an unloaded car, a foot whose low end is towards this one's, and a gear that points at it.
    """
    fx, fy = car.x + dir_x(yaw), car.y + dir_y(yaw)
    bx, by = fx + dir_x(yaw), fy + dir_y(yaw)
    facing = (yaw + 2) & 3
    beyond = kind_at(w, bx, by, car.z) if inside(w, bx, by, car.z) else AIR
    if beyond not in (AIR, GEAR) and not (beyond == FOOT and yaw_at(w, bx, by, car.z) == facing):
        return False
    if car_in(w, me, fx, fy, car.z, False) or car_in(w, me, bx, by, car.z, True):
        return False
    if leans_into(w, me, car.x, car.y, car.z, -1) or leans_into(w, me, fx, fy, car.z, -1):
        return False
    if leans_into(w, me, bx, by, car.z, facing) or gear_across(w, me, bx, by, car.z, yaw):
        return False
    for z in (car.z, car.z + 1):
        if gear_across(w, me, fx, fy, z, yaw):
            return False
    return not gear_across(w, me, car.x, car.y, car.z + 1, yaw)


@compiled
def gear_has_room(w: World, me: int, car: Pose, yaw: int) -> bool:
    """Return whether the gear of a slope that is lifted or set down in a car's cell crosses nothing in the next one."""
    if not w.corrections & CROSSING_GEAR:
        return True
    x, y = car.x + dir_x(yaw), car.y + dir_y(yaw)
    if gear_across(w, me, x, y, car.z, yaw) or car_in(w, me, x, y, car.z, True):
        return False
    return kind_at(w, x, y, car.z) != FOOT or (yaw_at(w, x, y, car.z) - yaw) & 1 == 0
