"""What reaches out of its cell: cars, gears, and loads that lean on a ramp or stand into the next level.

Gears are found by their slopes, standing or carried, since a cell shows only one gear. A load on a ramp leans downhill
with its car, by 40 to 60 mm, into the next cell: what comes straight towards its gear or it has room there, what moves
at a right angle to it has not. Heights are those of the machines' swept volumes (``craftsim clearance``).
"""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import (
    AIR,
    BODY,
    F_LOAD,
    F_LOAD_YAW,
    F_SLOPE,
    F_X,
    F_Y,
    F_Z,
    FOOT,
    FSLOPE,
    Pose,
    World,
    car_field,
    dir_x,
    dir_y,
    kind_at,
    yaw_at,
)

LIP_MM = 10
"""Height above its floor at which the lip of a flap passes the border of the foot's cell."""
GEAR_MM = 115
"""Height above its floor, less what a load on a foot leaves, at which the gear of a carried slope begins."""


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


@compiled(inline=False)
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


@compiled(inline=False)
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
