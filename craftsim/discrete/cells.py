"""What the compiled rules see of one world: its cells, its cars and the two marks that legality depends on.

Cells are (x, y, z); z = 0 is the ground layer. Everything beside the map is wall, everything above it is air.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kinds import CarField, Kind

AIR = int(Kind.AIR)
GROUND = int(Kind.GROUND)
WALL = int(Kind.WALL)
BLOCK = int(Kind.BLOCK)
FLAG = int(Kind.FLAG)
FSLOPE = int(Kind.FSLOPE)
GEAR = int(Kind.GEAR)
BODY = int(Kind.BODY)
FOOT = int(Kind.FOOT)

NOTHING = -1
OBJECT = -2

F_X = int(CarField.X)
F_Y = int(CarField.Y)
F_Z = int(CarField.Z)
F_YAW = int(CarField.YAW)
F_LOAD = int(CarField.LOAD)
F_LOAD_YAW = int(CarField.LOAD_YAW)
F_SLOPE = int(CarField.SLOPE)


class RuleFlags(NamedTuple):
    """The differences between the rule sets, each read in one place of the rules; off is as published."""

    derived_marks: bool = False
    """Marks follow from what is there instead of from past events."""
    swinging_flap: bool = False
    """FOLD and UNFOLD need room for the flap on its way (docs/rules.md#flap)."""
    turning_load: bool = False
    """A load turns only where no car stands beside it and no load leans in beside it (docs/rules.md#turning-load)."""
    leaning_load: bool = False
    """A load needs room on a ramp, below it and beside one that leans there (docs/rules.md#leaning-load)."""
    own_ramp: bool = False
    """On a ramp a car goes on along that ramp alone, and over no crest (docs/rules.md#own-ramp)."""
    second_ramp: bool = False
    """Who drives from a ramp's top onto the foot of a second ramp is then on that (docs/rules.md#second-ramp)."""
    ramp_below_gear: bool = False
    """A ramp below a gear is driven down in its own direction only (docs/rules.md#through-a-gear)."""
    run_out: bool = False
    """Who comes down a ramp does not drive under a block or flag right behind its foot (docs/rules.md#run-out)."""
    reaching_load: bool = False
    """Loads and flaps keep clear of loads that reach in from another level (docs/rules.md#reaching-load)."""
    overhead_wall: bool = False
    """A wall overhead keeps loads, flaps and climbing cars away (docs/rules.md#overhead-wall)."""
    crossing_gear: bool = False
    """A slope is lifted and set down only where its gear crosses nothing (docs/rules.md#crossing-gear)."""
    lasting_gears: bool = False
    """A gear gives way to what stands, and lasts as long as its slope (docs/rules.md#lift-erases-gear-cell)."""


class World(NamedTuple):
    """The arrays of one world, shaped as in :class:`craftsim.discrete.grid.Grid`, and the flags it obeys."""

    kind: NDArray[np.int8]
    yaw: NDArray[np.int8]
    top: NDArray[np.int16]
    back: NDArray[np.bool_]
    cars: NDArray[np.int64]
    flags: RuleFlags


class Pose(NamedTuple):
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
    return 1 if d == 0 else (-1 if d == 2 else 0)


@compiled
def dir_y(d: int) -> int:
    """Return the y component of the unit step in direction d (any integer, taken modulo 4)."""
    d = d & 3
    return 1 if d == 1 else (-1 if d == 3 else 0)


@compiled
def inside(w: World, x: int, y: int, z: int) -> bool:
    """Return whether (x, y, z) is a stored cell, the ground layer included."""
    return 0 <= x < w.kind.shape[0] and 0 <= y < w.kind.shape[1] and 0 <= z < w.kind.shape[2]


@compiled
def kind_at(w: World, x: int, y: int, z: int) -> int:
    """Return the kind in a cell: wall beside the map, air above it."""
    if x < 0 or y < 0 or x >= w.kind.shape[0] or y >= w.kind.shape[1]:
        return WALL
    if z >= w.kind.shape[2]:
        return AIR
    return int(np.int64(w.kind[x, y, z]))


@compiled
def yaw_at(w: World, x: int, y: int, z: int) -> int:
    """Return the yaw of the object in a stored cell."""
    return int(np.int64(w.yaw[x, y, z]))


@compiled
def pose_of(w: World, car: int) -> Pose:
    """Return the state of a car."""
    return Pose(
        w.cars[car, F_X],
        w.cars[car, F_Y],
        w.cars[car, F_Z],
        w.cars[car, F_YAW],
        w.cars[car, F_LOAD],
        w.cars[car, F_LOAD_YAW],
        w.cars[car, F_SLOPE],
    )


@compiled
def standable(kind: int) -> bool:
    """Return whether a car or an object can stand on a kind."""
    return kind in (GROUND, BLOCK)


@compiled
def is_air_or_gear(kind: int) -> bool:
    """Return whether a kind leaves room: nothing there, or a gear."""
    return kind in (AIR, GEAR)


@compiled
def derived_top(w: World, x: int, y: int, z: int, ignored: int) -> int:
    """Return what is really on a cell: a car's id (``ignored`` is not seen), OBJECT or NOTHING.

    Gears and walls in the cell above count as nothing. Of two cars in one cell the higher id is returned.
    """
    for car in range(w.cars.shape[0] - 1, -1, -1):
        if car != ignored and w.cars[car, F_X] == x and w.cars[car, F_Y] == y and w.cars[car, F_Z] == z + 1:
            return car
    above = kind_at(w, x, y, z + 1)
    if above in (AIR, GEAR, WALL):
        return NOTHING
    return OBJECT


@compiled
def derived_back(w: World, x: int, y: int, z: int) -> bool:
    """Return whether a cell is the landing of a ramp: a neighbour in direction d holds a body with yaw d."""
    for d in range(4):
        nx, ny = x + dir_x(d), y + dir_y(d)
        if kind_at(w, nx, ny, z) == BODY and yaw_at(w, nx, ny, z) == d:
            return True
    return False


@compiled
def top_at(w: World, x: int, y: int, z: int, me: int) -> int:
    """Return the mark "what is on me" of a cell as car ``me`` reads it (never itself, when derived)."""
    if not inside(w, x, y, z):
        return NOTHING
    if w.flags.derived_marks:
        return derived_top(w, x, y, z, me)
    return int(np.int64(w.top[x, y, z]))


@compiled
def back_at(w: World, x: int, y: int, z: int) -> bool:
    """Return the mark "I am the landing of a ramp" of a cell."""
    if not inside(w, x, y, z):
        return False
    if w.flags.derived_marks:
        return kind_at(w, x, y, z) == BLOCK and derived_back(w, x, y, z)
    return bool(w.back[x, y, z])


@compiled
def derive_marks(w: World) -> None:
    """Overwrite both marks of every cell with what follows from the visible state."""
    for x in range(w.kind.shape[0]):
        for y in range(w.kind.shape[1]):
            for z in range(w.kind.shape[2]):
                above = kind_at(w, x, y, z + 1)
                w.top[x, y, z] = NOTHING if above in (AIR, GEAR, WALL) else OBJECT
                w.back[x, y, z] = w.kind[x, y, z] == BLOCK and derived_back(w, x, y, z)
    for car in range(w.cars.shape[0]):
        if inside(w, w.cars[car, F_X], w.cars[car, F_Y], w.cars[car, F_Z] - 1):
            w.top[w.cars[car, F_X], w.cars[car, F_Y], w.cars[car, F_Z] - 1] = car


@compiled
def world_at(worlds: World, i: int) -> World:
    """Return one world of a batch, whose arrays have a leading dimension over worlds."""
    return World(worlds.kind[i], worlds.yaw[i], worlds.top[i], worlds.back[i], worlds.cars[i], worlds.flags)
