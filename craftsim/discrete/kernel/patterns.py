"""Learned preconditions: patterns of what is around a car that forbid an action, as rows of numbers.

The frame of a pattern is the direction of a move, else the car's heading: so moves in all directions have patterns in
common. A cell is named by how far it is ahead, to the left
and up from the car's. What is there is a word of bits: the one of its thing, that of a car, and those of gears that
reach in and of loads that lean in, by the direction they point in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import compiled, plain
from craftsim.discrete.kernel import codes as code
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    BODY,
    F_LOAD,
    F_LOAD_YAW,
    F_SLOPE,
    F_X,
    F_Y,
    F_Z,
    FLAG,
    FOOT,
    FSLOPE,
    GEAR,
    CarState,
    World,
    car_field,
    car_in,
    dir_x,
    dir_y,
    downhill_of,
    kind_at,
    leaning_directions,
    yaw_at,
)

VERBS = ("MOVE", "LIFT", "DROP", "FOLD", "UNFOLD", "ROTATE_LEFT", "ROTATE_RIGHT")
"""Actions of patterns, by number."""
NO_VERB = -1

# The things in a cell; slopes, bodies and feet have four bits each, by the direction that they point in. A gear is no
# thing of its own, since a cell shows only one.
OUTSIDE_BIT = 1
BLOCK_BIT = 4
FLAG_BIT = 5
FSLOPE_BIT = 6
BODY_BIT = 10
FOOT_BIT = 14
N_THINGS = 18
# Another car there: without a load, with a block or flag, and with a slope; each off slopes and on one.
CAR_BIT = N_THINGS
N_CARS = 6
GEAR_BIT = CAR_BIT + N_CARS
LEAN_BIT = GEAR_BIT + 4
N_BITS = LEAN_BIT + 4

THING_BITS = (1 << N_THINGS) - 1
CAR_BITS = ((1 << N_CARS) - 1) << CAR_BIT
GEAR_BITS = 15 << GEAR_BIT
LEAN_BITS = 15 << LEAN_BIT

# The car itself: its load, its stance (flat, on a foot or above a body, up or down), its level, its heading.
N_LOADS = 4
N_STANCES = 5
N_LEVELS = 2
N_OWN = N_LOADS * N_STANCES * N_LEVELS * 4
"""States of a car, numbered by load, then stance, level and heading."""

REACH_CELLS = 3
"""Most cells ahead or aside of the car in a pattern."""
LOWEST = -2
HIGHEST = 2
"""Levels in a pattern, relative to the car's."""
SIDE = 2 * REACH_CELLS + 1
N_CELLS = SIDE * SIDE * (HIGHEST - LOWEST + 1)

# Patterns in an array: for each verb and state of the car the places where its list of patterns begins and ends; then
# the lists. In a list patterns with the same first cell are a group: how far that is ahead, left and up, all bits that
# they look for there, and the length of the group. Of each pattern follow its number, its bits of the first cell, and
# the number of its other cells; of each of these how far it is ahead, left and up, and the bits of which it has at
# least one.
GROUP_HEAD = 5
PATTERN_HEAD = 3
CELL_ENTRIES = 4


@compiled
def verb_of(action: int) -> int:
    """Return the number of an action's verb, NO_VERB for what has no patterns."""
    if code.FIRST_MOVE <= action <= code.LAST_MOVE:
        return 0
    if action <= code.ROTATE_RIGHT:
        return 1 + action
    return NO_VERB


@compiled
def frame_of(car: CarState, action: int) -> int:
    """Return the direction that is ahead in the frame of an action."""
    if code.FIRST_MOVE <= action <= code.LAST_MOVE:
        return code.MOVE_DIRECTIONS[action - code.FIRST_MOVE]
    return car.yaw


@compiled
def own_number(w: World, car: CarState, frame: int) -> int:
    """Return the number of a car's state in a frame."""
    load = 0
    if car.load == BLOCK:
        load = 1
    elif car.load == FLAG:
        load = 2
    elif car.load == FSLOPE:
        load = 3
    stance = 0
    if car.slope != 0:
        stance = 2 * car.slope - 1
        if downhill_of(w, car.x, car.y, car.z, car.slope) == car.yaw:
            stance += 1
    level = 0
    if car.z > 1:
        level = 1
    return load + N_LOADS * (stance + N_STANCES * (level + N_LEVELS * ((car.yaw - frame) & 3)))


@compiled
def thing_bit(w: World, x: int, y: int, z: int, frame: int) -> int:
    """Return the bit of the thing in a cell."""
    if x < 0 or y < 0 or x >= w.cells.shape[0] or y >= w.cells.shape[1] or z < 0:
        return 1 << OUTSIDE_BIT
    kind = kind_at(w, x, y, z)
    if kind in (AIR, GEAR):
        return 1
    if kind <= FLAG:
        return 2 << kind
    first = FSLOPE_BIT
    if kind == BODY:
        first = BODY_BIT
    elif kind == FOOT:
        first = FOOT_BIT
    return 1 << (first + ((yaw_at(w, x, y, z) - frame) & 3))


@compiled
def car_bit_of(w: World, other_car: int) -> int:
    """Return the bit of another car."""
    load = car_field(w, other_car, F_LOAD)
    number = 0
    if load == FSLOPE:
        number = 4
    elif load != AIR:
        number = 2
    if w.cars[other_car, F_SLOPE] != 0:
        number += 1
    return 1 << (CAR_BIT + number)


@compiled
def car_bit(w: World, me: int, x: int, y: int, z: int) -> int:
    """Return the bit of another car in a cell; 0 for none."""
    other_car = car_in(w, me, x, y, z, False)
    if other_car < 0:
        return 0
    return car_bit_of(w, other_car)


@compiled
def shown_by_cars(w: World, me: int, car: CarState) -> int:
    """Return the bits that other cars near a car may show in any cell."""
    visible = 0
    reach = REACH_CELLS + 1
    for other_car in range(w.cars.shape[0]):
        if (
            other_car == me
            or abs(w.cars[other_car, F_X] - car.x) > reach
            or abs(w.cars[other_car, F_Y] - car.y) > reach
        ):
            continue
        visible |= car_bit_of(w, other_car)
        if w.cars[other_car, F_LOAD] != AIR and w.cars[other_car, F_SLOPE] != 0:
            visible |= LEAN_BITS
    return visible


@compiled
def gear_bits(w: World, me: int, x: int, y: int, z: int, frame: int) -> int:
    """Return the bits of the gears, standing or carried, that reach into a cell."""
    bits = 0
    for yaw in range(4):
        sx = x - dir_x(yaw)
        sy = y - dir_y(yaw)
        inside = 0 <= sx < w.cells.shape[0] and 0 <= sy < w.cells.shape[1] and z >= 0
        if inside and kind_at(w, sx, sy, z) == FSLOPE and yaw_at(w, sx, sy, z) == yaw:
            bits |= 1 << (GEAR_BIT + ((yaw - frame) & 3))
    for other_car in range(w.cars.shape[0]):
        if other_car == me or w.cars[other_car, F_LOAD] != FSLOPE or w.cars[other_car, F_Z] != z:
            continue
        yaw = car_field(w, other_car, F_LOAD_YAW)
        gx = w.cars[other_car, F_X] + dir_x(yaw)
        gy = w.cars[other_car, F_Y] + dir_y(yaw)
        if gx == x and gy == y:
            bits |= 1 << (GEAR_BIT + ((yaw - frame) & 3))
    return bits


@compiled
def lean_bits(w: World, me: int, x: int, y: int, z: int, frame: int) -> int:
    """Return the bits of other cars' loads that lean into a cell, downhill from a ramp."""
    directions = leaning_directions(w, me, x, y, z)
    bits = 0
    for direction in range(4):
        if directions >> direction & 1:
            bits |= 1 << (LEAN_BIT + ((direction - frame) & 3))
    return bits


@compiled(inline=False)
def bits_beyond_things(
    w: World, me: int, x: int, y: int, z: int, frame: int, looked_for: int
) -> int:
    """Return the bits of cars, gears and leaning loads that a cell has, as far as they are looked for."""
    bits = 0
    if looked_for & CAR_BITS:
        bits |= car_bit(w, me, x, y, z)
    if looked_for & GEAR_BITS:
        bits |= gear_bits(w, me, x, y, z, frame)
    if looked_for & LEAN_BITS:
        bits |= lean_bits(w, me, x, y, z, frame)
    return bits & looked_for


@compiled
def bits_in(w: World, me: int, car: CarState, frame: int, cell: int, visible: int) -> int:
    """Return the bits of the cell at a place of the array of patterns, as far as they are looked for.

    ``visible`` are the bits that other cars may show.
    """
    dx = dir_x(frame)
    dy = dir_y(frame)
    forward = w.patterns[cell]
    aside = w.patterns[cell + 1]
    x = car.x + forward * dx - aside * dy
    y = car.y + forward * dy + aside * dx
    z = car.z + w.patterns[cell + 2]
    looked_for = w.patterns[cell + 3]
    bits = 0
    if looked_for & THING_BITS:
        bits = thing_bit(w, x, y, z, frame) & looked_for
    if looked_for & (visible | GEAR_BITS):
        bits |= bits_beyond_things(w, me, x, y, z, frame, looked_for)
    return bits


@compiled(inline=False)
def why_learned(w: World, me: int, car: CarState, action: int) -> int:
    """Return the reason of the first pattern that forbids an action, with its number as the detail; 0 for none."""
    verb = verb_of(action)
    if verb == NO_VERB:
        return code.LEGAL
    frame = frame_of(car, action)
    row = 2 * (verb * N_OWN + own_number(w, car, frame))
    group = w.patterns[row]
    end = w.patterns[row + 1]
    if group == end:
        return code.LEGAL
    visible = shown_by_cars(w, me, car)
    while group < end:
        group_end = group + w.patterns[group + 4]
        bits = bits_in(w, me, car, frame, group, visible)
        place = group + GROUP_HEAD
        if bits == 0:
            place = group_end
        while place < group_end:
            cell = place + PATTERN_HEAD
            after = cell + CELL_ENTRIES * w.patterns[place + 2]
            matches = bits & w.patterns[place + 1] != 0
            while matches and cell < after:
                matches = bits_in(w, me, car, frame, cell, visible) != 0
                cell += CELL_ENTRIES
            if matches:
                return int(code.PATTERN_MATCHES | w.patterns[place] << code.DETAIL_BITS)
            place = after
        group = group_end
    return code.LEGAL


@compiled
def write_surroundings(
    w: World, me: int, car: CarState, action: int, out: NDArray[np.int64]
) -> None:
    """Write the bits of all cells around a car (N_CELLS,) in the frame of an action, and last the number of its state.

    Cells are in the order of ahead, left and up, each from its least on.
    """
    frame = frame_of(car, action)
    n = 0
    for forward in range(-REACH_CELLS, REACH_CELLS + 1):
        for aside in range(-REACH_CELLS, REACH_CELLS + 1):
            x = car.x + forward * dir_x(frame) - aside * dir_y(frame)
            y = car.y + forward * dir_y(frame) + aside * dir_x(frame)
            for z in range(car.z + LOWEST, car.z + HIGHEST + 1):
                out[n] = (
                    thing_bit(w, x, y, z, frame)
                    | car_bit(w, me, x, y, z)
                    | gear_bits(w, me, x, y, z, frame)
                    | lean_bits(w, me, x, y, z, frame)
                )
                n += 1
    out[n] = own_number(w, car, frame)


@plain
def cell_bits(w: World, me: int, x: int, y: int, z: int, frame: int) -> int:
    """Return all bits of a cell."""
    return int(
        thing_bit(w, x, y, z, frame)
        | car_bit(w, me, x, y, z)
        | gear_bits(w, me, x, y, z, frame)
        | lean_bits(w, me, x, y, z, frame)
    )
