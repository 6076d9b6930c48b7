"""What a legal action changes, the event-driven marks included (docs/rules.md#marks)."""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    BODY,
    F_LOAD,
    F_LOAD_YAW,
    F_SLOPE,
    F_X,
    F_Y,
    F_YAW,
    F_Z,
    FOOT,
    FSLOPE,
    GEAR,
    KIND,
    LANDING,
    LASTING_GEARS,
    NOTHING,
    OBJECT,
    OCCUPANT,
    YAW,
    Pose,
    World,
    derived_back,
    dir_x,
    dir_y,
    inside,
    is_air_or_gear,
    kind_at,
    yaw_at,
)
from craftsim.discrete.rules.moves import moved
from craftsim.discrete.rules.reach import standing_gear_in


@compiled
def put(w: World, x: int, y: int, z: int, kind: int, yaw: int) -> None:
    """Replace whatever is in a cell (docs/rules.md#drop-overwrites); the newcomer's marks start blank.

    Cells beside the map stay wall.
    """
    if inside(w, x, y, z):
        w.cells[x, y, z, KIND] = kind
        w.cells[x, y, z, YAW] = yaw
        w.cells[x, y, z, OCCUPANT] = NOTHING
        w.cells[x, y, z, LANDING] = False


@compiled
def put_gear(w: World, x: int, y: int, z: int, kind: int, yaw: int) -> None:
    """Put a gear into a cell, or with AIR take one away, whatever is there (docs/rules.md#lift-erases-gear-cell).

    When gears last, the cell shows one only where nothing stands, and as long as a slope beside it has its gear there.
    """
    if not w.corrections & LASTING_GEARS:
        put(w, x, y, z, kind, yaw)
    elif is_air_or_gear(kind_at(w, x, y, z)):
        gear = standing_gear_in(w, x, y, z)
        put(w, x, y, z, GEAR if gear >= 0 else AIR, max(gear, 0))


@compiled
def mark_top(w: World, x: int, y: int, z: int, mark: int) -> None:
    """Set the mark "what is on me" of a cell."""
    if inside(w, x, y, z):
        w.cells[x, y, z, OCCUPANT] = mark


@compiled
def mark_back(w: World, x: int, y: int, z: int, mark: bool) -> None:
    """Set the mark "I am the landing of a ramp" of a cell; only blocks carry it."""
    if kind_at(w, x, y, z) == BLOCK:
        w.cells[x, y, z, LANDING] = mark


@compiled
def lift(w: World, me: int, car: Pose) -> None:
    """Take up the object in the own cell, a slope with its gear."""
    kind = kind_at(w, car.x, car.y, car.z)
    yaw = yaw_at(w, car.x, car.y, car.z)
    put(w, car.x, car.y, car.z, AIR, 0)
    if kind == FSLOPE:
        put_gear(w, car.x + dir_x(yaw), car.y + dir_y(yaw), car.z, AIR, 0)
    w.cars[me, F_LOAD] = kind
    w.cars[me, F_LOAD_YAW] = yaw if kind == FSLOPE else 0
    mark_top(w, car.x, car.y, car.z - 1, me)


@compiled
def drop(w: World, me: int, car: Pose) -> None:
    """Put the load into the own cell."""
    put(w, car.x, car.y, car.z, car.load, car.load_yaw)
    if car.load == FSLOPE:
        put_gear(w, car.x + dir_x(car.load_yaw), car.y + dir_y(car.load_yaw), car.z, GEAR, car.load_yaw)
    if car.load == BLOCK:
        mark_back(w, car.x, car.y, car.z, derived_back(w, car.x, car.y, car.z))
    w.cars[me, F_LOAD] = AIR
    w.cars[me, F_LOAD_YAW] = 0
    mark_top(w, car.x, car.y, car.z - 1, me)


@compiled
def unfold(w: World, car: Pose) -> None:
    """Turn the folded slope in the own cell into a ramp behind the car."""
    yaw = (car.yaw + 2) & 3
    x, y = car.x + dir_x(yaw), car.y + dir_y(yaw)
    put(w, car.x, car.y, car.z, BODY, yaw)
    put(w, x, y, car.z, FOOT, yaw)
    mark_top(w, x, y, car.z - 1, OBJECT)
    mark_back(w, car.x + dir_x(car.yaw), car.y + dir_y(car.yaw), car.z, True)


@compiled
def fold(w: World, car: Pose) -> None:
    """Turn the ramp in the own cell into a folded slope.

    Its landing is unmarked even if another ramp leans there (docs/rules.md#landing-forgotten).
    """
    yaw = (car.yaw + 2) & 3
    x, y = car.x + dir_x(yaw), car.y + dir_y(yaw)
    put(w, car.x, car.y, car.z, FSLOPE, yaw)
    put(w, x, y, car.z, AIR, 0)
    put_gear(w, x, y, car.z, GEAR, yaw)
    mark_top(w, x, y, car.z - 1, NOTHING)
    mark_back(w, car.x + dir_x(car.yaw), car.y + dir_y(car.yaw), car.z, False)


@compiled
def turned(car: Pose, turn: int) -> Pose:
    """Return a car's state after a turn by +1 or -1; a carried slope turns with it."""
    load_yaw = (car.load_yaw + turn) & 3 if car.load == FSLOPE else 0
    return Pose(car.x, car.y, car.z, (car.yaw + turn) & 3, car.load, load_yaw, car.slope)


@compiled
def write_pose(w: World, me: int, car: Pose) -> None:
    """Store a car's position, yaw, carried yaw and slope state."""
    w.cars[me, F_X] = car.x
    w.cars[me, F_Y] = car.y
    w.cars[me, F_Z] = car.z
    w.cars[me, F_YAW] = car.yaw
    w.cars[me, F_LOAD_YAW] = car.load_yaw
    w.cars[me, F_SLOPE] = car.slope


@compiled
def move(w: World, me: int, car: Pose, direction: int) -> None:
    """Drive to the next cell in a direction 0..3."""
    new = moved(w, car, direction)
    # A gear left behind counts as an object here, though not elsewhere (docs/rules.md#gear-mark).
    left_air = kind_at(w, car.x, car.y, car.z) == AIR
    mark_top(w, car.x, car.y, car.z - 1, NOTHING if left_air else OBJECT)
    mark_top(w, new.x, new.y, new.z - 1, me)
    write_pose(w, me, new)


@compiled
def rotate(w: World, me: int, car: Pose, turn: int) -> None:
    """Turn on the spot by +1 (left) or -1 (right)."""
    write_pose(w, me, turned(car, turn))
