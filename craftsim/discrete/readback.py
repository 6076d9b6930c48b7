"""Reading a Grid from poses: what the world looks like now, whatever anybody asked for.

Positions and quaternions are in the world frame of :mod:`craftsim.discrete.geometry`; the frame of every part has its
origin on the floor under its centre, z up, a slope's x downhill.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete import reading as found
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kernel.jit import records

_PROBLEMS: Final = {
    found.OFF_CENTRE: "{name} is {:.0f} mm from the centre of ({:.0f}, {:.0f})",
    found.OUTSIDE: "{name} is outside the area, at ({:.0f}, {:.0f})",
    found.OFF_FLOOR: "{name} is {:+.0f} mm from the floor of level {:.0f}",
    found.OFF_LEVELS: "{name} is on level {:.0f}, outside 1..{:.0f}",
    found.CAR_TURNED: "{name} heads {:+.2f} rad away from yaw {:.0f}",
    found.CAR_LEANS: "{name} leans: pitch {:+.2f} rad, roll {:.2f} rad",
    found.HALF_OPEN: "{name} is half open: its hinge stands at {:.2f} rad",
    found.SECOND_LOAD: "{name} is a second load on car {:.0f}",
    found.OFF_SEAT: "{name} sits {:.0f} mm off its seat on car {:.0f}",
    found.LOAD_TURNED: "{name} is turned by {:+.2f} rad on car {:.0f}",
    found.LEANS: "{name} leans by {:.2f} rad",
    found.TURNED: "{name} is turned by {:+.2f} rad",
    found.REACHES_OUT: "{name} reaches outside the area, into ({:.0f}, {:.0f}, {:.0f})",
    found.SHARES: "{name} shares the cell ({:.0f}, {:.0f}, {:.0f}) with a {kind}",
}
"""What is wrong with a thing, in words."""


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
        """Return a copy whose poses may be written to."""
        cars, things = self.car_positions.copy(), self.positions.copy()
        turned = self.car_quaternions.copy(), self.quaternions.copy()
        return Poses(cars, turned[0], self.kinds, things, turned[1], self.hinges.copy())

    def name(self, index: int) -> str:
        """Return the name of an object for people, counted by kind: ``block 0``, ``flag 0``, ``slope 1``."""
        kind = self.kinds[index]
        word = "slope" if kind == Kind.FSLOPE else kind.name.lower()
        return f"{word} {self.kinds[:index].count(kind)}"


class Placed(NamedTuple):
    """Where a car or an object was read to be, and how far it is from the ideal place."""

    cell: tuple[int, int, int]
    """(x, y, z); of a carried object the cell of its car."""
    offset_m: float
    """Horizontal distance from the cell's centre; of a carried object from its car's centre line."""
    heading_rad: float
    """Heading minus the nearest grid yaw's, in (-pi/4, pi/4]; of a carried object in its car's frame."""
    carrier: int | None = None
    """The car that carries it, if any."""
    height_m: float = 0.0
    """Height above the floor of the cell, or above the middle of the incline there; of a carried object above its car's
    origin, square to the car's deck."""
    tilt_rad: float = 0.0
    """How far it leans away from level, or a car on a slope from the incline; of a carried object from its car."""
    hinge_rad: float = 0.0
    """How far the hinge of a slope is from fully open or closed, whichever is nearer."""
    reach_m: float = 0.0
    """By how much an object comes nearer to any neighbouring cell than where it should stand or be carried: place,
    heading and lean together. 0 for a car."""


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
    n_cars, n = len(poses.car_positions), len(poses.car_positions) + len(poses.positions)
    grid = Grid.empty(size, n_cars)
    grid.kind[tuple(walls.T)] = Kind.WALL
    world = grid.world()
    reads, problems = records(n, found.READ), records(n * found.MOST_PROBLEMS, found.PROBLEM)
    n_problems = found.read_things(
        world,
        np.concatenate((poses.car_positions, poses.positions)),
        np.concatenate((poses.car_quaternions, poses.quaternions)),
        np.array(poses.kinds, np.int64),
        poses.hinges,
        reads,
        problems,
    )
    things = [_placed(*read) for read in reads.tolist()]
    words = tuple(_in_words(poses, *problem) for problem in problems[:n_problems].tolist())
    return Reading(grid, tuple(things[:n_cars]), tuple(things[n_cars:]), words)


def _placed(
    x: int, y: int, z: int, carrier: int, ahead_m: float, aside_m: float, heading_rad: float, *others: float
) -> Placed:
    """Return what a READ record says; ``others`` are height, tilt, hinge and reach."""
    offset_m = math.hypot(ahead_m, aside_m)
    return Placed((x, y, z), offset_m, heading_rad, carrier if carrier >= 0 else None, *others)


def _in_words(poses: Poses, what: int, thing: int, details: NDArray[np.float64]) -> str:
    n_cars = len(poses.car_positions)
    name = f"car {thing}" if thing < n_cars else poses.name(thing - n_cars)
    return _PROBLEMS[what].format(*details, name=name, kind=Kind(int(details[3])).name.lower())
