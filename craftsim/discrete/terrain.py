"""What the map shows of a car's way: the ground under it, and how much room there is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import INCLINE_RAD
from craftsim.discrete.grid import CarField, Grid, Kind


def incline_under(grid: Grid, car: NDArray[np.int64]) -> float:
    """Return the angle in radians by which the ground raises a car's nose: positive uphill, 0 on the flat.

    Args:
        grid: the world.
        car: (7,) a row of ``grid.cars`` or of another grid with the same slopes.
    """
    x, y, z, yaw, _, _, slope = car.tolist()
    if slope == 0:
        return 0.0
    downhill = int(grid.yaw[x, y, z if slope == 1 else z - 1])
    return -INCLINE_RAD if yaw == downhill else INCLINE_RAD


def inclines_of(before: Grid, after: Grid, car: int) -> tuple[float, float]:
    """Return how far the ground raises a car's nose where it stands before and where it stands after an action."""
    return incline_under(before, before.cars[car]), incline_under(before, after.cars[car])


def is_tight(before: Grid, after: Grid, car: int) -> bool:
    """Return whether a car's way leads under something, or takes a load past something.

    A lowered board clears what it passes under by a millimetre, and loads pass each other at two.
    """
    cells = [tuple(grid.cars[car, :3].tolist()) for grid in (before, after)]
    cells = [cell for cell in cells if cell[2] < before.kind.shape[2]]  # above the top there is nothing
    if before.cars[car, CarField.LOAD] == Kind.AIR:
        return any(before.kind[cell] != Kind.AIR for cell in cells)
    others = np.arange(before.n_cars) != car
    for x, y, z in cells:
        around = before.kind[max(x - 1, 0) : x + 2, max(y - 1, 0) : y + 2, z]
        near = np.abs(before.cars[others, :2] - (x, y)).max(axis=1, initial=0) <= 1
        if (around != Kind.AIR).any() or (near & (before.cars[others, CarField.Z] == z)).any():
            return True
    return False
