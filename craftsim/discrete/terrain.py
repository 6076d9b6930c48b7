"""The ground that the map shows under a car."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import INCLINE_RAD
from craftsim.discrete.grid import Grid


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
