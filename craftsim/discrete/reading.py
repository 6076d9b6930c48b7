"""Reading a Grid from poses, compiled: which cell each car and object stands in, and what is wrong with that."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, INCLINE_RAD, LEVEL_HEIGHT_M
from craftsim.discrete.kernel.jit import Record, compiled
from craftsim.discrete.kernel.state import (
    AIR,
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
    YAW,
    World,
    derive_marks,
    dir_x,
    dir_y,
)
from craftsim.discrete.rotation import Axis, body_axes, wrap

PLACE_TOLERANCE_M: Final = 0.025
"""How far from its cell's centre a thing may be and still count as in it: well inside the robot's room to correct."""
HEIGHT_TOLERANCE_M: Final = 0.010
"""How far from a level's floor a thing may be and still count as standing on it: a third of the lift of a load."""
HEADING_TOLERANCE_RAD: Final = 0.15
"""How far from a grid yaw a heading may be and still be read as it."""
TILT_TOLERANCE_RAD: Final = 0.05
"""How far from level, or from the incline, a thing may lean and still count as standing."""
HINGE_TOLERANCE_RAD: Final = 0.05
"""How far from fully open or closed a hinge may be; the flap's lip is then 16 mm from its place."""
SEAT_TOLERANCE_M: Final = 0.005
"""How far a carried thing may be from its car's centre line: ten times what the boss leaves it to play."""
LIFT_RANGE_M: Final = (0.016, 0.050)
"""Height of a load above its car that counts as carried; a board lifts blocks by 0.032, slopes by 0.042."""


READ: Final = np.dtype(
    [
        *((name, "i8") for name in ("x", "y", "z", "carrier")),
        *((name, "f8") for name in ("ahead_m", "aside_m", "heading_rad", "height_m")),
        *((name, "f8") for name in ("tilt_rad", "hinge_rad", "reach_m")),
    ],
    align=True,
)
"""Where a thing was read to be: its cell, its carrier or -1, its place there, heading, height, tilt, hinge, and how far
it reaches out of its cell."""

(
    OFF_CENTRE,
    OUTSIDE,
    OFF_FLOOR,
    OFF_LEVELS,
    CAR_TURNED,
    CAR_LEANS,
    HALF_OPEN,
    SECOND_LOAD,
    OFF_SEAT,
    LOAD_TURNED,
    LEANS,
    TURNED,
    REACHES_OUT,
    SHARES,
) = range(14)
"""What can be wrong with a thing."""

MOST_PROBLEMS: Final = 9
"""Of one thing, at most."""

PROBLEM: Final = np.dtype([("what", "i8"), ("thing", "i8"), ("details", "f8", (4,))], align=True)
"""What is wrong with which thing, cars first, and the numbers that say so."""

Numbers = NDArray[np.integer]
Floats = NDArray[np.float64]
Records = NDArray[np.void]


@compiled
def read_things(
    w: World,
    positions: Floats,
    quaternions: Floats,
    kinds: Numbers,
    hinges: Floats,
    reads: Records,
    problems: Records,
) -> int:
    """Put all cars and objects into a world of ground and walls, with their marks; return how many problems there are.

    Args:
        w: the world.
        positions: (n, 3) of cars, then objects.
        quaternions: (n, 4).
        kinds: of objects, FSLOPE for a slope in any state.
        hinges: of objects, in radians.
        reads: (n,) READ, is written.
        problems: (n * MOST_PROBLEMS,) PROBLEM, is written.
    """
    n_cars, found = len(w.cars), 0
    for i in range(n_cars):
        found = _read_car(w, i, positions[i], _axes(quaternions[i]), reads[i], problems, found)
    for i in range(n_cars, len(positions)):
        kind, hinge = kinds[i - n_cars], hinges[i - n_cars]
        found = _read_object(w, i, positions, quaternions, kind, hinge, reads, problems, found)
    derive_marks(w)
    return found


@compiled
def _axes(quaternion: Floats) -> tuple[Axis, Axis, Axis]:
    return body_axes(quaternion[0], quaternion[1], quaternion[2], quaternion[3])


@compiled
def _dot(a: Axis, b: Axis) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def nearest_yaw(heading: float) -> tuple[int, float]:
    """Return the grid yaw nearest to a heading in radians, and the heading's excess over it in (-pi/4, pi/4]."""
    yaw = round(heading / (math.pi / 2)) % 4
    return yaw, wrap(heading - (yaw if yaw < 3 else -1) * (math.pi / 2))


@compiled
def _note(
    problems: Records,
    found: int,
    what: int,
    thing: int,
    a: float,
    b: float = 0.0,
    c: float = 0.0,
    d: float = 0.0,
) -> int:
    problem = problems[found]
    problem.what, problem.thing, details = what, thing, problem.details
    details[0], details[1], details[2], details[3] = a, b, c, d
    return found + 1


@compiled
def _place(w: World, thing: int, position: Floats, read: Record, problems: Records, found: int) -> int:
    """Find the column of a position, and its place there."""
    x, y = math.floor(position[0] / CELL_PITCH_M), math.floor(position[1] / CELL_PITCH_M)
    ahead, aside = position[0] - (x + 0.5) * CELL_PITCH_M, position[1] - (y + 0.5) * CELL_PITCH_M
    read.ahead_m, read.aside_m = ahead, aside
    offset = math.sqrt(ahead * ahead + aside * aside)
    if offset > PLACE_TOLERANCE_M:
        found = _note(problems, found, OFF_CENTRE, thing, offset * 1e3, x, y)
    length, width = w.cells.shape[0], w.cells.shape[1]
    if not (0 <= x < length and 0 <= y < width):
        found = _note(problems, found, OUTSIDE, thing, x, y)
    read.x, read.y = min(max(x, 0), length - 1), min(max(y, 0), width - 1)
    return found


@compiled
def _level(thing: int, height: float, top: int, read: Record, problems: Records, found: int) -> int:
    """Find the level up to ``top`` whose floor is nearest to a height in metres, and the height above that floor."""
    level = round(height / LEVEL_HEIGHT_M) + 1
    excess = height - (level - 1) * LEVEL_HEIGHT_M
    if abs(excess) > HEIGHT_TOLERANCE_M:
        found = _note(problems, found, OFF_FLOOR, thing, excess * 1e3, level)
    if not 1 <= level <= top:
        found = _note(problems, found, OFF_LEVELS, thing, level, top)
    read.z, read.height_m = min(max(level, 1), top), excess
    return found


@compiled
def _read_car(
    w: World,
    car: int,
    position: Floats,
    axes: tuple[Axis, Axis, Axis],
    read: Record,
    problems: Records,
    found: int,
) -> int:
    forward, left, up = axes
    found = _place(w, car, position, read, problems, found)
    yaw, excess = nearest_yaw(math.atan2(forward[1], forward[0]))
    if abs(excess) > HEADING_TOLERANCE_RAD:
        found = _note(problems, found, CAR_TURNED, car, excess, yaw)
    pitch = math.asin(max(-1.0, min(1.0, forward[2])))
    roll = abs(math.asin(max(-1.0, min(1.0, left[2]))))
    on_slope = abs(pitch) > INCLINE_RAD / 2
    incline = INCLINE_RAD if on_slope else 0.0
    read.tilt_rad = math.sqrt((abs(pitch) - incline) ** 2 + roll * roll)
    read.hinge_rad = read.reach_m = 0.0
    if roll > TILT_TOLERANCE_RAD or abs(abs(pitch) - incline) > TILT_TOLERANCE_RAD or up[2] < 0:
        found = _note(problems, found, CAR_LEANS, car, pitch, roll)
    slope, height = 0, position[2]
    if on_slope:
        lower = (height / LEVEL_HEIGHT_M) % 1.0 < 0.5
        slope = 1 if lower else 2
        height += LEVEL_HEIGHT_M * (-0.25 if lower else 0.25)
    # A car may be above the top level.
    found = _level(car, height, w.cells.shape[2], read, problems, found)
    read.heading_rad, read.carrier = excess, -1
    row = w.cars[car]
    row[F_X], row[F_Y], row[F_Z], row[F_YAW], row[F_SLOPE] = read.x, read.y, read.z, yaw, slope
    return found


@compiled
def _find_carrier(positions: Floats, quaternions: Floats, n_cars: int, thing: int, read: Record) -> None:
    """Find the car that carries a thing, if any, how far that is from the car's centre line, and how high above it."""
    read.carrier = -1
    at = positions[thing]
    for car in range(n_cars):
        base = positions[car]
        x, y, z = at[0] - base[0], at[1] - base[1], at[2] - base[2]
        forward, left, up = _axes(quaternions[car])
        above = up[0] * x + up[1] * y + up[2] * z
        if not LIFT_RANGE_M[0] < above < LIFT_RANGE_M[1]:
            continue
        ahead = forward[0] * x + forward[1] * y + forward[2] * z
        aside = left[0] * x + left[1] * y + left[2] * z
        if math.sqrt(ahead * ahead + aside * aside) < CELL_PITCH_M / 4:
            read.carrier, read.ahead_m, read.aside_m, read.height_m = car, ahead, aside, above
            return


@compiled
def _read_object(
    w: World,
    thing: int,
    positions: Floats,
    quaternions: Floats,
    kind: int,
    hinge: float,
    reads: Records,
    problems: Records,
    found: int,
) -> int:
    read = reads[thing]
    forward, _, up = _axes(quaternions[thing])
    yaw, excess = nearest_yaw(math.atan2(forward[1], forward[0]))
    folded = kind != FSLOPE or hinge > math.pi / 2
    read.hinge_rad = abs(hinge - (math.pi if folded else 0.0)) if kind == FSLOPE else 0.0
    if read.hinge_rad > HINGE_TOLERANCE_RAD:
        found = _note(problems, found, HALF_OPEN, thing, hinge)
    _find_carrier(positions, quaternions, len(w.cars), thing, read)
    if read.carrier >= 0:
        car_forward, car_left, car_up = _axes(quaternions[read.carrier])
        ahead, aside = _dot(car_forward, forward), _dot(car_left, forward)
        _, read.heading_rad = nearest_yaw(math.atan2(aside, ahead))
        read.tilt_rad = math.acos(max(-1.0, min(1.0, _dot(car_up, up))))
        found = _read_load(w, thing, kind, yaw, excess, read, problems, found)
        nose = (
            INCLINE_RAD * ((car_forward[2] > 0.0) - (car_forward[2] < 0.0))
            if w.cars[read.carrier, F_SLOPE]
            else 0.0
        )
        yaw = w.cars[read.carrier, F_YAW]
        lean_x, lean_y = -math.sin(nose) * dir_x(yaw), -math.sin(nose) * dir_y(yaw)
        read.reach_m = _reach(positions[thing], excess, up, read, lean_x, lean_y)
        return found
    read.heading_rad = excess
    found = _place(w, thing, positions[thing], read, problems, found)
    found = _level(thing, positions[thing, 2], w.cells.shape[2] - 1, read, problems, found)
    read.tilt_rad = math.acos(max(-1.0, min(1.0, up[2])))
    if read.tilt_rad > TILT_TOLERANCE_RAD:
        found = _note(problems, found, LEANS, thing, read.tilt_rad)
    if abs(excess) > HEADING_TOLERANCE_RAD:
        found = _note(problems, found, TURNED, thing, excess)
    read.reach_m = _reach(positions[thing], excess, up, read, 0.0, 0.0)
    x, y, z = read.x, read.y, read.z
    if kind != FSLOPE:
        return _put(w, thing, x, y, z, kind, 0, problems, found)
    found = _put(w, thing, x, y, z, FSLOPE if folded else BODY, yaw, problems, found)
    x, y = x + dir_x(yaw), y + dir_y(yaw)
    return _put(w, thing, x, y, z, GEAR if folded else FOOT, yaw, problems, found)


@compiled
def _reach(position: Floats, excess: float, up: Axis, read: Record, lean_x: float, lean_y: float) -> float:
    """Return how much nearer to a neighbouring cell a thing comes than where it should stand or be carried, at most.

    Its box is taken to be a cell long and wide and a level high, and its axis to lean by ``lean`` where all is right.
    Of an unfolded slope this is the box over its body.
    """
    lifted = read.height_m if read.carrier >= 0 else 0.0
    x = position[0] - (read.x + 0.5) * CELL_PITCH_M - lifted * lean_x
    y = position[1] - (read.y + 0.5) * CELL_PITCH_M - lifted * lean_y
    above_x, above_y = x + LEVEL_HEIGHT_M * (up[0] - lean_x), y + LEVEL_HEIGHT_M * (up[1] - lean_y)
    return CELL_PITCH_M / 2 * abs(excess) + max(abs(x), abs(y), abs(above_x), abs(above_y))


@compiled
def _read_load(
    w: World, thing: int, kind: int, yaw: int, excess: float, read: Record, problems: Records, found: int
) -> int:
    car = read.carrier
    row = w.cars[car]
    if row[F_LOAD] != AIR:
        found = _note(problems, found, SECOND_LOAD, thing, car)
    row[F_LOAD], row[F_LOAD_YAW] = kind, yaw if kind == FSLOPE else 0
    offset = math.sqrt(read.ahead_m * read.ahead_m + read.aside_m * read.aside_m)
    if offset > SEAT_TOLERANCE_M:
        found = _note(problems, found, OFF_SEAT, thing, offset * 1e3, car)
    if abs(excess) > HEADING_TOLERANCE_RAD:
        found = _note(problems, found, LOAD_TURNED, thing, excess, car)
    read.x, read.y, read.z = row[F_X], row[F_Y], row[F_Z]
    return found


@compiled
def _put(
    w: World, thing: int, x: int, y: int, z: int, kind: int, yaw: int, problems: Records, found: int
) -> int:
    if not (0 <= x < w.cells.shape[0] and 0 <= y < w.cells.shape[1]):
        return _note(problems, found, REACHES_OUT, thing, x, y, z)
    there = w.cells[x, y, z, KIND]
    if kind == GEAR:
        if there == GEAR:
            yaw = min(yaw, w.cells[x, y, z, YAW])  # the rules show this one of two gears as well
        elif there != AIR:
            return found  # a gear leaves room for what stands in its cell
    elif there not in (AIR, GEAR):
        return _note(problems, found, SHARES, thing, x, y, z, there)
    w.cells[x, y, z, KIND], w.cells[x, y, z, YAW] = kind, yaw
    return found
