"""Reading a Grid from poses, whatever anybody asked for, and comparing it with the predicted one.

Positions and quaternions are in the world frame of :mod:`craftsim.discrete.geometry`; the frame of every part has its
origin on the floor under its centre, z up, a slope's x downhill.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.arrays import Floats
from craftsim.compiled.jit import plain
from craftsim.discrete.geometry import (
    CELL_PITCH_M,
    DIRECTIONS,
    INCLINE_RAD,
    LEVEL_HEIGHT_M,
    yaw_angle,
)
from craftsim.discrete.grid import SECOND_PART, CarField, Cell, Grid, Kind, beside
from craftsim.discrete.kernel.rotation import body_axes
from craftsim.discrete.kernel.state import AIR, BODY, FOOT, FSLOPE, GEAR, KIND, YAW
from craftsim.errors import InputError

PLACE_TOLERANCE_M: Final = 0.025
"""Distance from its cell's centre at which a thing still counts as in it: well inside the robot's room to correct."""
HEIGHT_TOLERANCE_M: Final = 0.010
"""Distance from a level's floor at which a thing still counts as standing on it: a third of the lift of a load."""
HEADING_TOLERANCE_RAD: Final = 0.15
"""Angle from a grid yaw at which a heading is still read as it."""
TILT_TOLERANCE_RAD: Final = 0.05
"""Angle from level, or from the incline, at which a thing still counts as standing."""
HINGE_TOLERANCE_RAD: Final = 0.05
"""Angle of a hinge from fully open or closed; the flap's lip is then 16 mm from its place."""
SEAT_TOLERANCE_M: Final = 0.005
"""Distance of a carried thing from its car's centre line: ten times the play that the boss leaves it."""
LIFT_RANGE_M: Final = (0.016, 0.050)
"""Height of a load above its car that counts as carried; a board lifts blocks by 0.032, slopes by 0.042."""

HEADING_NAMES: Final = ("+x", "+y", "-x", "-y")
"""The four grid yaws as map directions."""

Vector = Sequence[float]
Axes = tuple[Vector, Vector, Vector]
"""Axes of a turned body: forward, left and up, (x, y, z) each in the world frame."""
_axes_of: Final[Callable[..., Axes]] = plain(body_axes)
_cached: Final = lru_cache(maxsize=4096)
"""Cache for resting things: they sleep, and their poses stay equal to the last bit."""
_POSE: Final = struct.Struct("7d")
"""A position and a quaternion."""
_Seat = tuple[int, Axes, float, float]
"""The seat of a carried object: the car, its axes, the distance from its centre line and the height above it."""


@dataclass(frozen=True)
class Poses:
    """Measured poses of everything that moves, in world coordinates.

    Shapes: positions (n, 3) in metres, quaternions (n, 4) with w first.
    """

    car_positions: Floats
    car_quaternions: Floats
    kinds: tuple[Kind, ...]
    """Kind of each object: BLOCK, FLAG, or FSLOPE for a slope in any state."""
    positions: Floats
    quaternions: Floats
    hinges: Floats
    """(n,) hinge angle of each object in radians: 0 unfolded, pi folded; nan for what has no hinge."""

    def name(self, index: int) -> str:
        """Return the name of an object for people, counted by kind: ``block 0``, ``flag 0``, ``slope 1``."""
        kind = self.kinds[index]
        word = "slope"
        if kind != Kind.FSLOPE:
            word = kind.name.lower()
        return f"{word} {self.kinds[:index].count(kind)}"


class CellFit(NamedTuple):
    """The cell that a car or an object was read to be in, and its distance from the ideal place."""

    cell: Cell
    """The cell; of a carried object that of its car."""
    offset_m: float
    """Horizontal distance from the cell's centre; of a carried object from its car's centre line."""
    heading_rad: float
    """Heading minus the nearest grid yaw's, in (-pi/4, pi/4]; of a carried object in its car's frame."""
    carrier: int | None
    """The car that carries it, if any."""
    height_m: float
    """Height above the floor of the cell, or above the middle of the incline there; of a carried object above its car's
    origin, square to the car's deck."""
    tilt_rad: float
    """Angle from level, of a car on a slope from the incline, of a carried object from its car."""
    hinge_rad: float
    """Angle of the hinge of a slope from fully open or closed, whichever is nearer."""
    reach_m: float
    """Distance by which an object comes nearer to any neighbouring cell than where it should stand or be carried:
    place, heading and lean together. 0 for a car."""


@dataclass(frozen=True)
class Reading:
    """A Grid read from poses, with its inexact and impossible places."""

    grid: Grid
    cars: tuple[CellFit, ...]
    objects: tuple[CellFit, ...]
    """In the order of the poses."""
    problems: tuple[str, ...] = ()
    """Poses that could not be read as a grid, in words; empty when everything is in a cell."""

    @cached_property
    def standing(self) -> tuple[tuple[int, Cell, Cell | None], ...]:
        """The objects that no car carries: index, cell, and the cell of the foot where an unfolded slope stands."""
        standing = []
        for index, fit in enumerate(self.objects):
            if fit.carrier is not None:
                continue
            foot = None
            if self.grid.cells[fit.cell][KIND] == BODY:
                foot = cells_at(self.grid, fit.cell)[1]
            standing.append((index, fit.cell, foot))
        return tuple(standing)

    @cached_property
    def bounded(self) -> Floats:
        """(n, 2) of each object: ``reach_m``, and how far it leans or, where that is more, its hinge stands open."""
        bounds = [(fit.reach_m, max(fit.tilt_rad, fit.hinge_rad)) for fit in self.objects]
        return np.array(bounds).reshape(-1, 2)


def cells_at(grid: Grid, cell: Cell) -> list[Cell]:
    """Return a cell, and the second one of the slope that stands there."""
    if grid.kind_at(cell) not in SECOND_PART:
        return [cell]
    return [cell, beside(cell, int(grid.yaw[cell]))]


def nearest_yaw(heading: float) -> tuple[int, float]:
    """Return the grid yaw nearest to a heading in radians, and the heading's excess over it in (-pi/4, pi/4]."""
    yaw = round(heading / (math.pi / 2)) % 4
    return yaw, math.remainder(heading - yaw_angle(yaw), math.tau)


def read_grid(poses: Poses, size: Cell, walls: NDArray[np.integer]) -> Reading:
    """Return the Grid of a size (L, W, H) that poses show; ``walls`` are the cells (n, 3) of fixed obstacles.

    Quaternions may have any length. Raises InputError for numbers that are not finite, and for quaternions of zeros.
    """
    n_cars = len(poses.car_positions)
    grid = Grid.empty(size, n_cars)
    if len(walls):
        grid.kind[tuple(walls.T)] = Kind.WALL
    cars: list[CellFit] = []
    objects = []
    problems = []
    rows = []
    car_axes = []
    for pose in _packed(poses.car_positions, poses.car_quaternions):
        fit, row, axes, notes = _read_car(size, pose)
        if notes:
            problems += [f"car {len(cars)} {note}" for note in notes]
        cars.append(fit)
        rows.append(row)
        car_axes.append(axes)
    if n_cars:
        grid.cars[:] = rows
    seats = _seats(poses, car_axes)
    packed = _packed(poses.positions, poses.quaternions)
    measured = zip(map(int, poses.kinds), packed, poses.hinges.tolist(), strict=True)
    for index, (kind, pose, hinge) in enumerate(measured):
        if index in seats:
            fit, notes = _read_carried(grid, kind, pose, hinge, seats[index])
        else:
            # nan is equal to nothing that is kept
            if kind != FSLOPE:
                hinge = 0.0
            fit, yaw, fit_notes = _read_standing(size, kind, pose, hinge)
            notes = (*fit_notes, *_stand(grid.cells, kind, fit.cell, yaw, hinge))
        objects.append(fit)
        if notes:
            problems += [f"{poses.name(index)} {note}" for note in notes]
    grid.derive_marks()
    return Reading(grid, tuple(cars), tuple(objects), tuple(problems))


def _packed(positions: Floats, quaternions: Floats) -> list[bytes]:
    """Return poses as bytes, by which what has been read of those that rest is found without making lists of each."""
    rows = np.ascontiguousarray(np.column_stack([positions, quaternions]), np.float64)
    packed: list[bytes] = rows.view(f"V{_POSE.size}").ravel().tolist()
    return packed


def _unpacked(pose: bytes) -> tuple[Vector, Vector]:
    """Return the position and the quaternion of a pose."""
    x, y, z, *quaternion = _POSE.unpack(pose)
    return (x, y, z), quaternion


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _arc(function: Callable[[float], float], value: float) -> float:
    """Return the arcsine or arccosine of a number that may lie beyond 1 by rounding."""
    return function(max(-1.0, min(1.0, value)))


def _axes_at(position: Vector, quaternion: Vector) -> Axes:
    """Return the axes of a machine. Raises InputError for a pose that none can have.

    Comparisons with nan would find nothing wrong with it.
    """
    squared_length = sum(component * component for component in quaternion)
    if not (math.isfinite(sum(position)) and 0.0 < squared_length < math.inf):
        raise InputError(
            f"a machine is at {[*position]} and turned by {[*quaternion]}; allowed: finite numbers, and a quaternion "
            "that is not zero"
        )
    return _axes_of(*quaternion)


def _column(size: Cell, position: Vector, notes: list[str]) -> tuple[int, int, float]:
    """Return the column of the map in which a position is, and how far from its centre."""
    x = math.floor(position[0] / CELL_PITCH_M)
    y = math.floor(position[1] / CELL_PITCH_M)
    offset = math.hypot(
        position[0] - (x + 0.5) * CELL_PITCH_M, position[1] - (y + 0.5) * CELL_PITCH_M
    )
    if offset > PLACE_TOLERANCE_M:
        notes.append(f"is {offset * 1e3:.0f} mm from the centre of ({x}, {y})")
    length, width, _ = size
    if not (0 <= x < length and 0 <= y < width):
        notes.append(f"is outside the area, at ({x}, {y})")
    return min(max(x, 0), length - 1), min(max(y, 0), width - 1), offset


def _level(height: float, top: int, notes: list[str]) -> tuple[int, float]:
    """Return the level up to ``top`` whose floor is nearest to a height in metres, and the height above that floor."""
    level = round(height / LEVEL_HEIGHT_M) + 1
    excess = height - (level - 1) * LEVEL_HEIGHT_M
    if abs(excess) > HEIGHT_TOLERANCE_M:
        notes.append(f"is {excess * 1e3:+.0f} mm from the floor of level {level}")
    if not 1 <= level <= top:
        notes.append(f"is on level {level}, outside 1..{top}")
    return min(max(level, 1), top), excess


@_cached
def _read_car(size: Cell, pose: bytes) -> tuple[CellFit, tuple[int, ...], Axes, tuple[str, ...]]:
    """Return how a car fits into a map of a size, its row of the grid, its axes, and what is wrong with it."""
    position, quaternion = _unpacked(pose)
    forward, sideways, up = axes = _axes_at(position, quaternion)
    notes: list[str] = []
    x, y, offset = _column(size, position, notes)
    yaw, turned = nearest_yaw(math.atan2(forward[1], forward[0]))
    if abs(turned) > HEADING_TOLERANCE_RAD:
        notes.append(f"heads {turned:+.2f} rad away from yaw {yaw}")
    pitch = _arc(math.asin, forward[2])
    roll = abs(_arc(math.asin, sideways[2]))
    on_slope = abs(pitch) > INCLINE_RAD / 2
    off_incline = abs(pitch)
    if on_slope:
        off_incline -= INCLINE_RAD
    if roll > TILT_TOLERANCE_RAD or abs(off_incline) > TILT_TOLERANCE_RAD or up[2] < 0:
        notes.append(f"leans: pitch {pitch:+.2f} rad, roll {roll:.2f} rad")
    height = position[2]
    slope = 0
    if on_slope:
        if (height / LEVEL_HEIGHT_M) % 1.0 < 0.5:
            slope = 1
            height -= LEVEL_HEIGHT_M * 0.25
        else:
            slope = 2
            height += LEVEL_HEIGHT_M * 0.25
    z, excess = _level(height, size[2] + 1, notes)  # a car may be above the top level
    tilt = math.sqrt(off_incline * off_incline + roll * roll)
    fit = CellFit((x, y, z), offset, turned, None, excess, tilt, 0.0, 0.0)
    return fit, (x, y, z, yaw, AIR, 0, slope), axes, tuple(notes)


def _seats(poses: Poses, car_axes: list[Axes]) -> dict[int, _Seat]:
    """Return the carried objects with the first car that carries each, its axes, and where it is in their frame."""
    apart = poses.positions[:, None] - poses.car_positions
    is_near = (abs(apart[..., 0]) < CELL_PITCH_M / 2) & (abs(apart[..., 1]) < CELL_PITCH_M / 2)
    seats: dict[int, _Seat] = {}
    for index, car in zip(*(places.tolist() for places in is_near.nonzero()), strict=True):
        along, aside, above = (_dot(axis, apart[index, car].tolist()) for axis in car_axes[car])
        lifted = LIFT_RANGE_M[0] < above < LIFT_RANGE_M[1]
        if lifted and math.sqrt(along * along + aside * aside) < CELL_PITCH_M / 4:
            seats.setdefault(index, (car, car_axes[car], math.hypot(along, aside), above))
    return seats


def _turned(kind: int, axes: Axes, hinge: float) -> tuple[int, float, float, list[str]]:
    """Return an object's yaw, its turn away from that, how far its hinge is from a stop, and what is wrong."""
    forward = axes[0]
    yaw, turned = nearest_yaw(math.atan2(forward[1], forward[0]))
    if kind == FSLOPE and not math.isfinite(hinge):
        raise InputError(f"the hinge of a slope is at {hinge}; allowed: finite numbers")
    folded = kind != FSLOPE or hinge > math.pi / 2
    ajar = 0.0
    if kind == FSLOPE:
        ajar = abs(hinge - (math.pi if folded else 0.0))
    notes = []
    if ajar > HINGE_TOLERANCE_RAD:
        notes = [f"is half open: its hinge stands at {hinge:.2f} rad"]
    return yaw, turned, ajar, notes


def _read_carried(
    grid: Grid, kind: int, pose: bytes, hinge: float, seat: _Seat
) -> tuple[CellFit, tuple[str, ...]]:
    """Return how an object sits on a car of a world that has its cars, and what is wrong with it; load the car."""
    position, quaternion = _unpacked(pose)
    axes = _axes_at(position, quaternion)
    yaw, turned, ajar, notes = _turned(kind, axes, hinge)
    forward, _, up = axes
    car, car_axes, offset, height = seat
    row = grid.cars[car]
    x, y, z, car_yaw, load, _, slope = row.tolist()
    if load != AIR:
        notes.append(f"is a second load on car {car}")
    row[CarField.LOAD] = kind
    row[CarField.LOAD_YAW] = 0
    if kind == FSLOPE:
        row[CarField.LOAD_YAW] = yaw
    if offset > SEAT_TOLERANCE_M:
        notes.append(f"sits {offset * 1e3:.0f} mm off its seat on car {car}")
    if abs(turned) > HEADING_TOLERANCE_RAD:
        notes.append(f"is turned by {turned:+.2f} rad on car {car}")
    _, heading = nearest_yaw(math.atan2(_dot(car_axes[1], forward), _dot(car_axes[0], forward)))
    tilt = _arc(math.acos, _dot(car_axes[2], up))
    nose_up = 0.0
    if slope:
        nose_up = math.copysign(INCLINE_RAD, car_axes[0][2])
    lean = [-math.sin(nose_up) * step for step in DIRECTIONS[car_yaw].tolist()]
    reach = _reach(position, (x, y, z), turned, up, height, lean)
    return CellFit((x, y, z), offset, heading, car, height, tilt, ajar, reach), tuple(notes)


@_cached
def _read_standing(
    size: Cell, kind: int, pose: bytes, hinge: float
) -> tuple[CellFit, int, tuple[str, ...]]:
    """Return how an object that no car carries fits into a map of a size, its yaw, and what is wrong with it."""
    position, quaternion = _unpacked(pose)
    axes = _axes_at(position, quaternion)
    yaw, turned, ajar, notes = _turned(kind, axes, hinge)
    up = axes[2]
    x, y, offset = _column(size, position, notes)
    z, height = _level(position[2], size[2], notes)
    tilt = _arc(math.acos, up[2])
    if tilt > TILT_TOLERANCE_RAD:
        notes.append(f"leans by {tilt:.2f} rad")
    if abs(turned) > HEADING_TOLERANCE_RAD:
        notes.append(f"is turned by {turned:+.2f} rad")
    reach = _reach(position, (x, y, z), turned, up, 0.0, [0.0, 0.0])
    return CellFit((x, y, z), offset, turned, None, height, tilt, ajar, reach), yaw, tuple(notes)


def _stand(cells: NDArray[np.int16], kind: int, cell: Cell, yaw: int, hinge: float) -> list[str]:
    """Put an object that no car carries into the cells of a world; return what is wrong with its place."""
    length, width = cells.shape[:2]
    parts = [(kind, cell, 0)]
    if kind == FSLOPE:
        if hinge > math.pi / 2:
            first = FSLOPE
            second = GEAR
        else:
            first = BODY
            second = FOOT
        parts = [(first, cell, yaw), (second, beside(cell, yaw), yaw)]
    notes = []
    for part_kind, place, turn in parts:
        if not (0 <= place[0] < length and 0 <= place[1] < width):
            notes.append(f"reaches outside the area, into {place}")
            continue
        fields = cells[place]
        present = int(fields[KIND])
        turn_shown = turn
        if present != AIR:
            if part_kind == GEAR and present == GEAR:
                turn_shown = min(
                    turn, int(fields[YAW])
                )  # the rules show this one of two gears as well
            elif present != GEAR:
                if part_kind != GEAR:  # a gear leaves room for what stands in its cell
                    notes.append(f"shares the cell {place} with a {Kind(present).name.lower()}")
                continue
        fields[KIND] = part_kind
        fields[YAW] = turn_shown
    return notes


def _reach(
    position: Vector, cell: Cell, turned: float, up: Vector, lifted: float, lean: Vector
) -> float:
    """Return how much nearer to a neighbouring cell an object comes than where it should stand or be carried, at most.

    Its box is taken to be a cell long and wide and a level high, of an unfolded slope over its body. It should be
    lifted by so much along an axis that leans by ``lean`` in x and y.
    """
    furthest = 0.0
    for axis in (0, 1):
        low = position[axis] - (cell[axis] + 0.5) * CELL_PITCH_M - lifted * lean[axis]
        furthest = max(furthest, abs(low), abs(low + LEVEL_HEIGHT_M * (up[axis] - lean[axis])))
    return CELL_PITCH_M / 2 * abs(turned) + furthest


def describe_differences(predicted: Grid, read: Grid) -> list[str]:
    """Return one line for each cell and each car in which two Grids of one size differ."""
    return _describe(predicted, read, *find_changes(predicted, read))


def own_differences(before: Grid, predicted: Grid, read: Grid, car: int) -> list[str]:
    """Return a line for each thing that a car's action was to change and that reads otherwise than predicted."""
    cells, cars = find_changes(predicted, read)
    if not cells.any() and not cars[car]:
        return []
    intended, _ = find_changes(before, predicted)
    return _describe(predicted, read, cells & intended, cars & (np.arange(len(cars)) == car))


def find_changes(first: Grid, second: Grid) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which cells (L, W, H + 1) hold something else, and which cars (n,) differ."""
    cells = (first.kind != second.kind) | (first.yaw != second.yaw)
    return cells, (first.cars != second.cars).any(axis=1)


def _describe(
    predicted: Grid, read: Grid, cells: NDArray[np.bool_], cars: NDArray[np.bool_]
) -> list[str]:
    lines = []
    for cell in map(tuple, np.argwhere(cells).tolist()):
        predicted_words = f"{Kind(predicted.kind[cell]).name.lower()} yaw {predicted.yaw[cell]}"
        read_words = f"{Kind(read.kind[cell]).name.lower()} yaw {read.yaw[cell]}"
        lines.append(f"cell {cell}: predicted {predicted_words}, read {read_words}")
    for car in np.flatnonzero(cars).tolist():
        lines.append(
            f"car {car}: predicted {describe_car(predicted, car)}, read {describe_car(read, car)}"
        )
    return lines


def describe_car(grid: Grid, car: int) -> str:
    """Return a car's cell, heading, load and place on a slope in brief, such as ``2,3,1 +y block``."""
    x, y, z, yaw, load, load_yaw, slope = grid.cars[car].tolist()
    words = [f"{x},{y},{z} {HEADING_NAMES[yaw]}"]
    if load != Kind.AIR:
        load_words = Kind(load).name.lower()
        if load == Kind.FSLOPE:
            load_words += HEADING_NAMES[load_yaw]
        words.append(load_words)
    if slope:
        words.append("low" if slope == 1 else "high")
    return " ".join(words)
