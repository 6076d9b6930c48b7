"""What reaches in from another level: loads on the level below and on ramps above, and walls overhead.

The heights are those of the machines' swept volumes (``craftsim clearance``).
"""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import (
    AIR,
    F_LOAD,
    F_SLOPE,
    F_X,
    F_Y,
    F_Z,
    FSLOPE,
    OVERHEAD_WALL,
    REACHING_LOAD,
    WALL,
    Pose,
    World,
    car_field,
    dir_x,
    dir_y,
    kind_at,
)
from craftsim.discrete.rules.reach import downhill_of, leans_into

LIP_MM = 10
"""Height above its floor at which the lip of a flap passes the border of the foot's cell."""
GEAR_MM = 115
"""Height above its floor, less what a load on a foot leaves, at which the gear of a carried slope begins."""


@compiled
def wall_over(w: World, x: int, y: int, z: int) -> bool:
    """Return whether a wall is right above a cell, where a lifted load would meet it."""
    return w.corrections & OVERHEAD_WALL != 0 and kind_at(w, x, y, z + 1) == WALL


@compiled
def reach_mm(load: int, slope: int) -> int:
    """Return how far the load of a car on the flat (0), a foot (1) or above a body (2) stands into the level above."""
    if slope == 1:
        return 113 if load != FSLOPE else 123
    return 32 if load != FSLOPE else 42


@compiled
def reaches_up(w: World, me: int, x: int, y: int, z: int, height_mm: int) -> bool:
    """Return whether another car's load stands into a cell from the level below, up to this height above its floor.

    One that leans into the cell below does so by less than 50 mm.
    """
    for other in range(w.cars.shape[0]):
        if other == me or car_field(w, other, F_LOAD) == AIR:
            continue
        if (
            car_field(w, other, F_X) != x
            or car_field(w, other, F_Y) != y
            or car_field(w, other, F_Z) != z - 1
        ):
            continue
        if reach_mm(car_field(w, other, F_LOAD), car_field(w, other, F_SLOPE)) >= height_mm:
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


@compiled
def load_clears_levels(w: World, me: int, old: Pose, new: Pose) -> bool:
    """Return whether a load that moves meets none that reaches up from the level below or leans over from above."""
    if not w.corrections & REACHING_LOAD:
        return True
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
def turn_clears_levels(w: World, me: int, car: Pose) -> bool:
    """Return whether a load that turns meets none that reaches up from the level below or leans over from above."""
    if not w.corrections & REACHING_LOAD:
        return True
    legs_mm = reach_mm(car.load, 0)
    for d in range(4):
        x, y = car.x + dir_x(d), car.y + dir_y(d)
        if reaches_up(w, me, x, y, car.z, legs_mm) or leans_into(w, me, x, y, car.z + 1, -1):
            return False
    return not below_leaning(w, me, car)


@compiled
def flap_clears_levels(w: World, me: int, car: Pose, yaw: int) -> bool:
    """Return whether a flap, 0.43 m high on its way, meets no wall overhead, and no load of another level."""
    fx, fy = car.x + dir_x(yaw), car.y + dir_y(yaw)
    for z in (car.z, car.z + 1):
        if wall_over(w, car.x, car.y, z) or wall_over(w, fx, fy, z):
            return False
    if not w.corrections & REACHING_LOAD:
        return True
    for z in (car.z + 1, car.z + 2):
        if leans_into(w, me, car.x, car.y, z, -1) or leans_into(w, me, fx, fy, z, -1):
            return False
    return not reaches_up(w, me, fx + dir_x(yaw), fy + dir_y(yaw), car.z, LIP_MM)


@compiled
def load_below_walls(w: World, old: Pose, new: Pose) -> bool:
    """Return whether no wall is above a load on its way, or above where it leans on a ramp's foot."""
    if wall_over(w, old.x, old.y, old.z) or wall_over(w, new.x, new.y, new.z):
        return False
    if new.slope != 1:
        return True
    downhill = downhill_of(w, new.x, new.y, new.z, 1)
    return not wall_over(w, new.x + dir_x(downhill), new.y + dir_y(downhill), new.z)
