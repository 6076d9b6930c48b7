"""Reading a Grid from poses: what the world looks like now, whatever anybody asked for.

Positions and quaternions are in the world frame of :mod:`craftsim.discrete.geometry`; the frame of every part has its
origin on the floor under its centre, z up, a slope's x downhill.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import (
    CELL_PITCH_M,
    DIRECTIONS,
    INCLINE_RAD,
    LEVEL_HEIGHT_M,
    yaw_angle,
)
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.rotation import Axis, body_axes

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


@dataclass(frozen=True)
class Poses:
    """Measured poses of everything that moves, in world coordinates.

    Shapes: positions (n, 3) in metres, quaternions (n, 4) with w first.
    """

    car_positions: NDArray[np.float64]
    car_quaternions: NDArray[np.float64]
    kinds: tuple[Kind, ...]
    """Of each object: BLOCK, FLAG, or FSLOPE for a slope in any state."""
    positions: NDArray[np.float64]
    quaternions: NDArray[np.float64]
    hinges: NDArray[np.float64]
    """(n,) hinge angle of each object in radians: 0 unfolded, pi folded; nan for what has no hinge."""

    def copy(self) -> Poses:
        """Return a copy whose positions may be written to."""
        return replace(self, car_positions=self.car_positions.copy(), positions=self.positions.copy())

    def name(self, index: int) -> str:
        """Return the name of an object for people, counted by kind: ``block 0``, ``flag 0``, ``slope 1``."""
        kind = self.kinds[index]
        word = "slope" if kind == Kind.FSLOPE else kind.name.lower()
        return f"{word} {self.kinds[:index].count(kind)}"


@dataclass(frozen=True)
class Placed:
    """Where a car or an object was read to be, and how far it is from the ideal place."""

    cell: tuple[int, int, int]
    """(x, y, z); of a carried object the cell of its car."""
    offset_m: float
    """Horizontal distance from the cell's centre; of a carried object from its car's centre line."""
    heading_rad: float
    """Heading minus the nearest grid yaw's, in (-pi/4, pi/4]."""
    carrier: int | None = None
    """The car that carries it, if any."""
    height_m: float = 0.0
    """Height above the floor of the cell, or above the middle of the incline there; 0 for a carried object."""


@dataclass(frozen=True)
class Reading:
    """A Grid read from poses, with what is inexact or impossible about it."""

    grid: Grid
    cars: tuple[Placed, ...]
    objects: tuple[Placed, ...]
    """In the order of the poses."""
    problems: tuple[str, ...] = field(default=())
    """What could not be read as a grid, in words; empty when everything stands in a cell."""


def read_grid(poses: Poses, size: tuple[int, int, int], walls: NDArray[np.integer]) -> Reading:
    """Return the Grid that the poses show.

    Args:
        poses: what was measured.
        size: (L, W, H) of the map.
        walls: (n, 3) cells of fixed obstacles, in the Grid's own coordinates (level 1 is z = 1).
    """
    grid = Grid.empty(size, len(poses.car_positions))
    for x, y, z in walls:
        grid.kind[x, y, z] = Kind.WALL
    problems: list[str] = []
    frames = _frames(poses.car_positions, poses.car_quaternions)
    cars = tuple(_read_car(grid, frame, i, problems) for i, frame in enumerate(frames))
    things = _frames(poses.positions, poses.quaternions)
    objects = tuple(_read_object(grid, poses, frames, thing, i, problems) for i, thing in enumerate(things))
    grid.derive_marks()
    return Reading(grid, cars, objects, tuple(problems))


_Frame = tuple[list[float], tuple[Axis, Axis, Axis]]
"""A position, and the axes (forward, left, up) there."""


def _frames(positions: NDArray[np.float64], quaternions: NDArray[np.float64]) -> list[_Frame]:
    turned = (body_axes(*quaternion) for quaternion in quaternions.tolist())
    return list(zip(positions.tolist(), turned, strict=True))


def nearest_yaw(heading: float) -> tuple[int, float]:
    """Return the grid yaw nearest to a heading in radians, and the heading's excess over it in (-pi/4, pi/4]."""
    yaw = round(heading / (math.pi / 2)) % 4
    return yaw, math.remainder(heading - yaw_angle(yaw), math.tau)


def _place(grid: Grid, name: str, position: list[float], problems: list[str]) -> tuple[int, int, float]:
    """Return the column of a position and its distance from the column's centre, noting what is wrong with it."""
    x, y = math.floor(position[0] / CELL_PITCH_M), math.floor(position[1] / CELL_PITCH_M)
    offset = math.hypot(position[0] - (x + 0.5) * CELL_PITCH_M, position[1] - (y + 0.5) * CELL_PITCH_M)
    if offset > PLACE_TOLERANCE_M:
        problems.append(f"{name} is {offset * 1e3:.0f} mm from the centre of ({x}, {y})")
    length, width, _ = grid.size
    if not (0 <= x < length and 0 <= y < width):
        problems.append(f"{name} is outside the area, at ({x}, {y})")
        x, y = min(max(x, 0), length - 1), min(max(y, 0), width - 1)
    return x, y, offset


def _level(name: str, height: float, top: int, problems: list[str]) -> tuple[int, float]:
    """Return the level up to ``top`` whose floor is nearest to a height in metres, and the height above that floor.

    A thing that does not stand on it is noted.
    """
    level = round(height / LEVEL_HEIGHT_M) + 1
    excess = height - (level - 1) * LEVEL_HEIGHT_M
    if abs(excess) > HEIGHT_TOLERANCE_M:
        problems.append(f"{name} is {excess * 1e3:+.0f} mm from the floor of level {level}")
    if not 1 <= level <= top:
        problems.append(f"{name} is on level {level}, outside 1..{top}")
    return min(max(level, 1), top), excess


def _read_car(grid: Grid, frame: _Frame, car: int, problems: list[str]) -> Placed:
    name, (position, (forward, left, up)) = f"car {car}", frame
    x, y, offset = _place(grid, name, position, problems)
    yaw, excess = nearest_yaw(math.atan2(forward[1], forward[0]))
    if abs(excess) > HEADING_TOLERANCE_RAD:
        problems.append(f"{name} heads {excess:+.2f} rad away from yaw {yaw}")
    pitch = math.asin(max(-1.0, min(1.0, forward[2])))
    roll = abs(math.asin(max(-1.0, min(1.0, left[2]))))
    on_slope = abs(pitch) > INCLINE_RAD / 2
    if (
        roll > TILT_TOLERANCE_RAD
        or abs(abs(pitch) - on_slope * INCLINE_RAD) > TILT_TOLERANCE_RAD
        or up[2] < 0
    ):
        problems.append(f"{name} leans: pitch {pitch:+.2f} rad, roll {roll:.2f} rad")
    slope = 0
    height = position[2]
    if on_slope:
        lower = (height / LEVEL_HEIGHT_M) % 1.0 < 0.5
        slope = 1 if lower else 2
        height += LEVEL_HEIGHT_M * (-0.25 if lower else 0.25)
    grid.cars[car, [CarField.X, CarField.Y, CarField.YAW, CarField.SLOPE]] = x, y, yaw, slope
    level, above = _level(name, height, grid.size[2] + 1, problems)  # a car may be above the top level
    grid.cars[car, CarField.Z] = level
    return Placed((x, y, level), offset, excess, height_m=above)


def _carrier(cars: list[_Frame], position: list[float]) -> tuple[int, float] | None:
    """Return the car that carries a thing at this position, and how far that is from the car's centre line."""
    for car, (base, axes) in enumerate(cars):
        x, y, z = position[0] - base[0], position[1] - base[1], position[2] - base[2]
        ahead, aside, above = (axis[0] * x + axis[1] * y + axis[2] * z for axis in axes)
        offset = math.hypot(ahead, aside)
        if LIFT_RANGE_M[0] < above < LIFT_RANGE_M[1] and offset < CELL_PITCH_M / 4:
            return car, offset
    return None


def _read_object(
    grid: Grid, poses: Poses, cars: list[_Frame], thing: _Frame, index: int, problems: list[str]
) -> Placed:
    kind, name = poses.kinds[index], poses.name(index)
    position, (forward, _, up) = thing
    yaw, excess = nearest_yaw(math.atan2(forward[1], forward[0]))
    folded = kind != Kind.FSLOPE or poses.hinges[index] > math.pi / 2
    if kind == Kind.FSLOPE:
        wrong = poses.hinges[index] - (math.pi if folded else 0.0)
        if abs(wrong) > HINGE_TOLERANCE_RAD:
            problems.append(f"{name} is half open: its hinge stands at {poses.hinges[index]:.2f} rad")
    carried = _carrier(cars, position)
    if carried is not None:
        car, offset = carried
        if grid.cars[car, CarField.LOAD] != Kind.AIR:
            problems.append(f"{name} is a second load on car {car}")
        grid.cars[car, CarField.LOAD] = kind
        grid.cars[car, CarField.LOAD_YAW] = yaw if kind == Kind.FSLOPE else 0
        if offset > SEAT_TOLERANCE_M:
            problems.append(f"{name} sits {offset * 1e3:.0f} mm off its seat on car {car}")
        if abs(excess) > HEADING_TOLERANCE_RAD:
            problems.append(f"{name} is turned by {excess:+.2f} rad on car {car}")
        x, y, z = (int(grid.cars[car, f]) for f in (CarField.X, CarField.Y, CarField.Z))
        return Placed((x, y, z), offset, excess, car)
    x, y, offset = _place(grid, name, position, problems)
    level, above = _level(name, position[2], grid.size[2], problems)
    tilt = math.acos(max(-1.0, min(1.0, up[2])))
    if tilt > TILT_TOLERANCE_RAD:
        problems.append(f"{name} leans by {tilt:.2f} rad")
    if abs(excess) > HEADING_TOLERANCE_RAD:
        problems.append(f"{name} is turned by {excess:+.2f} rad")
    if kind == Kind.FSLOPE:
        ahead = x + DIRECTIONS[yaw, 0], y + DIRECTIONS[yaw, 1]
        _put(grid, (x, y, level), Kind.FSLOPE if folded else Kind.BODY, yaw, name, problems)
        _put(grid, (*ahead, level), Kind.GEAR if folded else Kind.FOOT, yaw, name, problems)
    else:
        _put(grid, (x, y, level), kind, 0, name, problems)
    return Placed((x, y, level), offset, excess, height_m=above)


def _put(
    grid: Grid, cell: tuple[int, int, int], kind: Kind, yaw: int, name: str, problems: list[str]
) -> None:
    length, width, _ = grid.size
    if not (0 <= cell[0] < length and 0 <= cell[1] < width):
        problems.append(f"{name} reaches outside the area, into {tuple(int(c) for c in cell)}")
        return
    there = Kind(grid.kind[cell])
    if there == kind == Kind.GEAR:
        yaw = min(yaw, int(grid.yaw[cell]))  # the rules show this one of two gears as well
    if there == Kind.GEAR:
        there = Kind.AIR  # a gear leaves room for what stands in its cell
    if there != Kind.AIR and kind == Kind.GEAR:
        return
    if there != Kind.AIR:
        problems.append(f"{name} shares the cell {tuple(int(c) for c in cell)} with a {there.name.lower()}")
        return
    grid.kind[cell] = kind
    grid.yaw[cell] = yaw
