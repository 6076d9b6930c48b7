"""What an action changes, the event-driven marks included (docs/rules.md#marks)."""

from __future__ import annotations

from craftsim.discrete.kernel import codes as code
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
    ROOMY,
    SECOND_RAMP,
    YAW,
    Pose,
    World,
    derived_landing,
    dir_x,
    dir_y,
    inside,
    kind_at,
    pose_of,
    yaw_at,
)


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
    if kind_at(w, x, y, z) not in ROOMY:
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
def after(w: World, car: Pose, action: int) -> Pose:
    """Return a car's state after an action, which is legal; a carried slope turns with its car."""
    if code.FIRST_MOVE <= action <= code.LAST_MOVE:
        return moved(w, car, code.MOVE_DIRECTIONS[action - code.FIRST_MOVE])
    yaw, load, load_yaw = car.yaw, car.load, car.load_yaw
    if action in (code.ROTATE_LEFT, code.ROTATE_RIGHT):
        turn = 1 if action == code.ROTATE_LEFT else -1
        yaw, load_yaw = (yaw + turn) & 3, (load_yaw + turn) & 3 if load == FSLOPE else 0
    elif action == code.LIFT:
        load = kind_at(w, car.x, car.y, car.z)
        load_yaw = yaw_at(w, car.x, car.y, car.z) if load == FSLOPE else 0
    elif action == code.DROP:
        load, load_yaw = AIR, 0
    return Pose(car.x, car.y, car.z, yaw, load, load_yaw, car.slope)


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
def apply(w: World, me: int, action: int) -> None:
    """Carry out an action that is legal; the diagonal moves never are, and STOP changes nothing."""
    car = pose_of(w, me)
    new = after(w, car, action)
    if code.FIRST_MOVE <= action <= code.LAST_MOVE:
        # A gear left behind counts as an object here, though not elsewhere (docs/rules.md#gear-mark).
        left_air = kind_at(w, car.x, car.y, car.z) == AIR
        set_occupant(w, car.x, car.y, car.z - 1, NOTHING if left_air else OBJECT)
        set_occupant(w, new.x, new.y, new.z - 1, me)
        write_pose(w, me, new)
    elif action in (code.ROTATE_LEFT, code.ROTATE_RIGHT):
        write_pose(w, me, new)
    elif action in (code.LIFT, code.DROP):
        # The object in the own cell, a slope with its gear, is taken up, or the load is put there.
        lifting = action == code.LIFT
        kind, yaw = (new.load, new.load_yaw) if lifting else (car.load, car.load_yaw)
        put(w, car.x, car.y, car.z, AIR if lifting else kind, 0 if lifting else yaw)
        if kind == FSLOPE:
            gear = AIR if lifting else GEAR
            put_gear(w, car.x + dir_x(yaw), car.y + dir_y(yaw), car.z, gear, 0 if lifting else yaw)
        if kind == BLOCK and not lifting and inside(w, car.x, car.y, car.z):
            w.cells[car.x, car.y, car.z, LANDING] = derived_landing(w, car.x, car.y, car.z)
        write_pose(w, me, new)
        set_occupant(w, car.x, car.y, car.z - 1, me)
    elif action in (code.FOLD, code.UNFOLD):
        # The ramp in the own cell becomes a folded slope, or a folded slope a ramp behind the car. The landing of a
        # folded ramp is unmarked even if another ramp leans there (docs/rules.md#landing-forgotten).
        folding, yaw = action == code.FOLD, (car.yaw + 2) & 3
        x, y = car.x + dir_x(yaw), car.y + dir_y(yaw)
        put(w, car.x, car.y, car.z, FSLOPE if folding else BODY, yaw)
        put(w, x, y, car.z, AIR if folding else FOOT, 0 if folding else yaw)
        if folding:
            put_gear(w, x, y, car.z, GEAR, yaw)
        set_occupant(w, x, y, car.z - 1, NOTHING if folding else OBJECT)
        x, y = car.x + dir_x(car.yaw), car.y + dir_y(car.yaw)
        if kind_at(w, x, y, car.z) == BLOCK:
            w.cells[x, y, car.z, LANDING] = not folding
