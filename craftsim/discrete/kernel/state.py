"""One world for the compiled rules: its cells, its cars, the two marks that legality depends on, and what reaches out
of its cell; and the changes that an action makes, the event-driven marks included (docs/rules.md#marks).

Cells are (x, y, z); z = 0 is the ground layer. Everything beside the map is wall, everything above it is air.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import compiled
from craftsim.discrete.kernel import codes as code
from craftsim.discrete.kinds import CarField, CellField, Correction, Kind

AIR, GROUND, WALL, BLOCK, FLAG, FSLOPE, GEAR, BODY, FOOT, *_ = map(int, Kind)

SUPPORTS = (GROUND, BLOCK)
"""Kinds that a car or an object can stand on."""
ROOMY = (AIR, GEAR)
"""Kinds that leave room: nothing, or a gear."""

NOTHING = -1
OBJECT = -2

KIND, YAW, OCCUPANT, LANDING = map(int, CellField)
F_X, F_Y, F_Z, F_YAW, F_LOAD, F_LOAD_YAW, F_SLOPE = map(int, CarField)

DERIVED_MARKS, SWINGING_FLAP, TURNING_LOAD, LEANING_LOAD, OWN_RAMP, SECOND_RAMP, *_ = map(
    int, Correction
)
*_, RAMP_BELOW_GEAR, RUN_OUT, REACHING_LOAD, OVERHEAD_WALL, CROSSING_GEAR, LASTING_GEARS = map(
    int, Correction
)

Cells = NDArray[np.int16]
"""(L, W, H + 1, 4): fields as in CellField; of a batch with a leading axis."""
Cars = NDArray[np.int16]
"""(n, 7): fields as in CarField; the same."""


Patterns = NDArray[np.int64]
"""(n,): learned preconditions, as :mod:`craftsim.discrete.kernel.patterns` lays them out; empty for none."""
NO_PATTERNS: Patterns = np.zeros(0, np.int64)


class World(NamedTuple):
    """One world, or with a leading axis a batch, and the corrections and patterns of the rules that hold in it."""

    cells: Cells
    cars: Cars
    corrections: int
    """A bit each, as in Correction."""
    patterns: Patterns


class CarState(NamedTuple):
    """The state of one car, real or imagined by the planner; fields as in CarField."""

    x: int
    y: int
    z: int
    yaw: int
    load: int
    load_yaw: int
    slope: int


@compiled
def dir_x(d: int) -> int:
    """Return the x component of the unit step in direction d (any integer, taken modulo 4)."""
    d = d & 3
    if d == 0:
        return 1
    if d == 2:
        return -1
    return 0


@compiled
def dir_y(d: int) -> int:
    """Return the y component of the unit step in direction d (any integer, taken modulo 4)."""
    d = d & 3
    if d == 1:
        return 1
    if d == 3:
        return -1
    return 0


@compiled
def inside(w: World, x: int, y: int, z: int) -> bool:
    """Return whether (x, y, z) is a stored cell, the ground layer included."""
    return 0 <= x < w.cells.shape[0] and 0 <= y < w.cells.shape[1] and 0 <= z < w.cells.shape[2]


@compiled
def kind_at(w: World, x: int, y: int, z: int) -> int:
    """Return the kind in a cell: wall beside the map, air above it."""
    if x < 0 or y < 0 or x >= w.cells.shape[0] or y >= w.cells.shape[1]:
        return WALL
    if z >= w.cells.shape[2]:
        return AIR
    return int(np.int64(w.cells[x, y, z, KIND]))


@compiled
def yaw_at(w: World, x: int, y: int, z: int) -> int:
    """Return the yaw of the object in a stored cell."""
    return int(np.int64(w.cells[x, y, z, YAW]))


@compiled
def car_field(w: World, car: int, field: int) -> int:
    """Return a field of a car."""
    return int(np.int64(w.cars[car, field]))


@compiled
def state_of_car(w: World, car: int) -> CarState:
    """Return the state of a car."""
    return CarState(
        car_field(w, car, F_X),
        car_field(w, car, F_Y),
        car_field(w, car, F_Z),
        car_field(w, car, F_YAW),
        car_field(w, car, F_LOAD),
        car_field(w, car, F_LOAD_YAW),
        car_field(w, car, F_SLOPE),
    )


@compiled
def derived_landing(w: World, x: int, y: int, z: int) -> bool:
    """Return whether a cell is the landing of a ramp: a neighbour in direction d holds a body with yaw d."""
    for d in range(4):
        nx = x + dir_x(d)
        ny = y + dir_y(d)
        if kind_at(w, nx, ny, z) == BODY and yaw_at(w, nx, ny, z) == d:
            return True
    return False


@compiled
def occupant_of(w: World, x: int, y: int, z: int, me: int) -> int:
    """Return what is on a cell as car ``me`` sees it: a car's number, OBJECT or NOTHING.

    By the mark "what is on me", or, where marks are derived, what is really there: never ``me`` itself, of two cars in
    one cell the higher number, and nothing where there is a gear or a wall.
    """
    if not inside(w, x, y, z):
        return NOTHING
    if not w.corrections & DERIVED_MARKS:
        return int(np.int64(w.cells[x, y, z, OCCUPANT]))
    for car in range(w.cars.shape[0] - 1, -1, -1):
        if (
            car != me
            and w.cars[car, F_X] == x
            and w.cars[car, F_Y] == y
            and w.cars[car, F_Z] == z + 1
        ):
            return car
    if kind_at(w, x, y, z + 1) in (AIR, GEAR, WALL):
        return NOTHING
    return OBJECT


@compiled
def is_landing(w: World, x: int, y: int, z: int) -> bool:
    """Return whether a cell is the landing of a ramp: by its mark, or, where marks are derived, really."""
    if not inside(w, x, y, z):
        return False
    if not w.corrections & DERIVED_MARKS:
        return bool(w.cells[x, y, z, LANDING] != 0)
    return kind_at(w, x, y, z) == BLOCK and derived_landing(w, x, y, z)


@compiled
def derive_marks(w: World) -> None:
    """Overwrite both marks of every cell with what follows from the visible state."""
    for x in range(w.cells.shape[0]):
        for y in range(w.cells.shape[1]):
            for z in range(w.cells.shape[2]):
                above = kind_at(w, x, y, z + 1)
                w.cells[x, y, z, OCCUPANT] = NOTHING if above in (AIR, GEAR, WALL) else OBJECT
                w.cells[x, y, z, LANDING] = w.cells[x, y, z, KIND] == BLOCK and derived_landing(
                    w, x, y, z
                )
    for car in range(w.cars.shape[0]):
        x = car_field(w, car, F_X)
        y = car_field(w, car, F_Y)
        z = car_field(w, car, F_Z)
        if inside(w, x, y, z - 1):
            w.cells[x, y, z - 1, OCCUPANT] = car


# What reaches out of its cell: cars, gears, and loads that lean on a ramp or stand into the next level. Gears are found
# by their slopes, standing or carried, since a cell shows only one gear. A load on a ramp leans downhill with its car,
# by 40 to 60 mm, into the next cell: what comes straight towards its gear or it has room there, what moves at a right
# angle to it has not. Heights are those of the machines' swept volumes (``craftsim audit clearance``).

LIP_MM = 10
"""Height above its floor at which the lip of a flap passes the border of the foot's cell."""
GEAR_MM = 115
"""Height above its floor, less what a load on a foot leaves, at which the gear of a carried slope begins."""


@compiled
def car_in(w: World, me: int, x: int, y: int, z: int, only_loaded: bool) -> int:
    """Return another car, or another loaded car, in a cell; -1 if there is none."""
    for other_car in range(w.cars.shape[0]):
        if other_car == me or (only_loaded and w.cars[other_car, F_LOAD] == AIR):
            continue
        if (
            w.cars[other_car, F_X] == x
            and w.cars[other_car, F_Y] == y
            and w.cars[other_car, F_Z] == z
        ):
            return other_car
    return -1


@compiled
def carried_gear_in(w: World, me: int, x: int, y: int, z: int, tolerated_yaw: int) -> bool:
    """Return whether another car carries a gear in a cell; ``tolerated_yaw`` (-1: none) is not seen."""
    for other_car in range(w.cars.shape[0]):
        if other_car == me or w.cars[other_car, F_LOAD] != FSLOPE or w.cars[other_car, F_Z] != z:
            continue
        yaw = car_field(w, other_car, F_LOAD_YAW)
        reaches = (
            w.cars[other_car, F_X] + dir_x(yaw) == x and w.cars[other_car, F_Y] + dir_y(yaw) == y
        )
        if reaches and yaw != tolerated_yaw:
            return True
    return False


@compiled(inline=False)
def gear_across(w: World, me: int, x: int, y: int, z: int, along: int) -> bool:
    """Return whether a gear, standing or carried, reaches into a cell at a right angle to the direction ``along``."""
    for side in range(2):
        yaw = (along + 1 + 2 * side) & 3
        sx = x - dir_x(yaw)
        sy = y - dir_y(yaw)
        if kind_at(w, sx, sy, z) == FSLOPE and yaw_at(w, sx, sy, z) == yaw:
            return True
        for other_car in range(w.cars.shape[0]):
            if (
                other_car == me
                or w.cars[other_car, F_LOAD] != FSLOPE
                or w.cars[other_car, F_LOAD_YAW] != yaw
            ):
                continue
            if (
                w.cars[other_car, F_X] == sx
                and w.cars[other_car, F_Y] == sy
                and w.cars[other_car, F_Z] == z
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


@compiled(inline=False)
def leaning_directions(w: World, me: int, x: int, y: int, z: int) -> int:
    """Return a bit for each direction in which another car's load leans into a cell, downhill from a ramp."""
    directions = 0
    for other_car in range(w.cars.shape[0]):
        if other_car == me or w.cars[other_car, F_SLOPE] == 0 or w.cars[other_car, F_LOAD] == AIR:
            continue
        ox = car_field(w, other_car, F_X)
        oy = car_field(w, other_car, F_Y)
        oz = car_field(w, other_car, F_Z)
        if oz != z or abs(ox - x) + abs(oy - y) != 1:
            continue
        downhill = downhill_of(w, ox, oy, oz, car_field(w, other_car, F_SLOPE))
        reaches = ox + dir_x(downhill) == x and oy + dir_y(downhill) == y
        if downhill >= 0 and reaches:
            directions |= 1 << downhill
    return directions


@compiled
def leans_into(w: World, me: int, x: int, y: int, z: int, tolerated: int) -> bool:
    """Return whether another car's load leans into a cell; the direction ``tolerated`` (-1: none) is not seen."""
    directions = leaning_directions(w, me, x, y, z)
    if tolerated >= 0:
        directions &= ~(1 << tolerated)
    return directions != 0


@compiled
def reaches_up(w: World, me: int, x: int, y: int, z: int, height_mm: int) -> bool:
    """Return whether another car's load stands into a cell from the level below, up to this height above its floor.

    One that leans into the cell below does so by less than 50 mm.
    """
    for other_car in range(w.cars.shape[0]):
        if other_car == me or w.cars[other_car, F_LOAD] == AIR:
            continue
        if (
            w.cars[other_car, F_X] != x
            or w.cars[other_car, F_Y] != y
            or w.cars[other_car, F_Z] != z - 1
        ):
            continue
        top_mm = 113 if w.cars[other_car, F_SLOPE] == 1 else 32
        if w.cars[other_car, F_LOAD] == FSLOPE:
            top_mm += 10
        if top_mm >= height_mm:
            return True
    return height_mm < 50 and leans_into(w, me, x, y, z - 1, -1)


@compiled
def below_leaning(w: World, me: int, car: CarState) -> bool:
    """Return whether another car's load leans over that of a car, from a ramp one level above."""
    if leans_into(w, me, car.x, car.y, car.z + 1, -1):
        return True
    if car.slope != 1:
        return False
    downhill = downhill_of(w, car.x, car.y, car.z, 1)
    return leans_into(w, me, car.x + dir_x(downhill), car.y + dir_y(downhill), car.z + 1, -1)


# What actions change


@compiled
def moved(w: World, car: CarState, m: int) -> CarState:
    """Return a car's state after a move in direction m: onto, along or off a slope, or on the flat."""
    x = car.x + dir_x(m)
    y = car.y + dir_y(m)
    kind = kind_at(w, x, y, car.z)
    below = kind_at(w, x, y, car.z - 1)
    z = car.z
    slope = 0
    if kind == FOOT and (car.slope == 0 or (w.corrections & SECOND_RAMP and car.slope == 2)):
        slope = 1
    elif car.slope == 1 and kind == BODY:
        z = car.z + 1
        slope = 2
    elif car.slope == 0 and below == BODY:
        slope = 2
    elif car.slope == 2 and below == FOOT:
        z = car.z - 1
        slope = 1
    return CarState(x, y, z, car.yaw, car.load, car.load_yaw, slope)


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
def _put_gear(w: World, x: int, y: int, z: int, kind: int, yaw: int) -> None:
    """Put a gear into a cell, or with AIR take one away, whatever is there (docs/rules.md#lift-erases-gear-cell).

    When gears last, the cell shows one only where nothing stands, and as long as a slope beside it has its gear there:
    that of the least yaw if there are two.
    """
    if not w.corrections & LASTING_GEARS:
        put(w, x, y, z, kind, yaw)
        return
    if kind_at(w, x, y, z) not in ROOMY:
        return
    kind = AIR
    yaw = 0
    for d in range(3, -1, -1):
        sx = x - dir_x(d)
        sy = y - dir_y(d)
        if kind_at(w, sx, sy, z) == FSLOPE and yaw_at(w, sx, sy, z) == d:
            kind = GEAR
            yaw = d
    put(w, x, y, z, kind, yaw)


@compiled
def _set_occupant(w: World, x: int, y: int, z: int, mark: int) -> None:
    """Set the mark "what is on me" of a cell."""
    if inside(w, x, y, z):
        w.cells[x, y, z, OCCUPANT] = mark


@compiled
def after(w: World, car: CarState, action: int) -> CarState:
    """Return a car's state after an action, which is legal; a carried slope turns with its car."""
    if code.FIRST_MOVE <= action <= code.LAST_MOVE:
        return moved(w, car, code.MOVE_DIRECTIONS[action - code.FIRST_MOVE])
    yaw = car.yaw
    load = car.load
    load_yaw = car.load_yaw
    if action in (code.ROTATE_LEFT, code.ROTATE_RIGHT):
        turn = 1 if action == code.ROTATE_LEFT else -1
        yaw = (yaw + turn) & 3
        load_yaw = (load_yaw + turn) & 3 if load == FSLOPE else 0
    elif action == code.LIFT:
        load = kind_at(w, car.x, car.y, car.z)
        load_yaw = yaw_at(w, car.x, car.y, car.z) if load == FSLOPE else 0
    elif action == code.DROP:
        load = AIR
        load_yaw = 0
    return CarState(car.x, car.y, car.z, yaw, load, load_yaw, car.slope)


@compiled
def apply(w: World, me: int, action: int) -> None:
    """Carry out an action that is legal; the diagonal moves never are, and STOP changes nothing."""
    car = state_of_car(w, me)
    new = after(w, car, action)
    row = w.cars[me]
    row[F_X], row[F_Y], row[F_Z], row[F_YAW], row[F_LOAD], row[F_LOAD_YAW], row[F_SLOPE] = new
    if code.FIRST_MOVE <= action <= code.LAST_MOVE:
        # A gear left behind counts as an object here, though not elsewhere (docs/rules.md#gear-mark).
        left_air = kind_at(w, car.x, car.y, car.z) == AIR
        _set_occupant(w, car.x, car.y, car.z - 1, NOTHING if left_air else OBJECT)
        _set_occupant(w, new.x, new.y, new.z - 1, me)
    elif action in (code.LIFT, code.DROP):
        # The object in the own cell, a slope with its gear, is taken up, or the load is put there.
        if action == code.LIFT:
            kind = new.load
            gear_x = car.x + dir_x(new.load_yaw)
            gear_y = car.y + dir_y(new.load_yaw)
            gear = AIR
            gear_yaw = 0
            put(w, car.x, car.y, car.z, AIR, 0)
        else:
            kind = car.load
            gear_x = car.x + dir_x(car.load_yaw)
            gear_y = car.y + dir_y(car.load_yaw)
            gear = GEAR
            gear_yaw = car.load_yaw
            put(w, car.x, car.y, car.z, kind, car.load_yaw)
        if kind == FSLOPE:
            _put_gear(w, gear_x, gear_y, car.z, gear, gear_yaw)
        if action == code.DROP and kind == BLOCK and inside(w, car.x, car.y, car.z):
            w.cells[car.x, car.y, car.z, LANDING] = derived_landing(w, car.x, car.y, car.z)
        _set_occupant(w, car.x, car.y, car.z - 1, me)
    elif action in (code.FOLD, code.UNFOLD):
        # The ramp in the own cell becomes a folded slope, or a folded slope a ramp behind the car. The landing of a
        # folded ramp is unmarked even if another ramp leans there (docs/rules.md#landing-forgotten).
        folding = action == code.FOLD
        yaw = (car.yaw + 2) & 3
        x = car.x + dir_x(yaw)
        y = car.y + dir_y(yaw)
        if folding:
            put(w, car.x, car.y, car.z, FSLOPE, yaw)
            put(w, x, y, car.z, AIR, 0)
            _put_gear(w, x, y, car.z, GEAR, yaw)
            _set_occupant(w, x, y, car.z - 1, NOTHING)
        else:
            put(w, car.x, car.y, car.z, BODY, yaw)
            put(w, x, y, car.z, FOOT, yaw)
            _set_occupant(w, x, y, car.z - 1, OBJECT)
        x = car.x + dir_x(car.yaw)
        y = car.y + dir_y(car.yaw)
        if kind_at(w, x, y, car.z) == BLOCK:
            w.cells[x, y, car.z, LANDING] = not folding
