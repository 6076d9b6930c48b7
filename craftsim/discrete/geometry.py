"""Places of grid cells in the world: the published pitch and level height of CraftEnv.

Frames: x forward (grid yaw 0), y left, z up; the grid's corner (0, 0) is the world's origin and level 1 stands on
z = 0.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

CELL_PITCH_M: Final = 0.3225
"""Distance between the centres of two neighbouring cells, in x and in y (published)."""

LEVEL_HEIGHT_M: Final = 0.185
"""Distance between the floors of two levels (published)."""

INCLINE_RAD: Final = math.atan(LEVEL_HEIGHT_M / (2 * CELL_PITCH_M))
"""Angle of an unfolded slope: one level over two cells, 16.0 degrees (derived)."""

DIRECTIONS: Final[NDArray[np.int64]] = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
"""Unit steps (dx, dy) of the four grid yaws 0..3: +x, +y, -x, -y. Shape (4, 2)."""


def cell_position(x: float, y: float, z: float) -> NDArray[np.float64]:
    """Return the world position in metres, shape (3,), of the centre of the floor of cell (x, y, level z)."""
    return np.array([(x + 0.5) * CELL_PITCH_M, (y + 0.5) * CELL_PITCH_M, (z - 1) * LEVEL_HEIGHT_M])


def yaw_angle(yaw: int) -> float:
    """Return the heading in radians, in (-pi, pi], of a grid yaw 0..3."""
    return float((0.0, np.pi / 2, np.pi, -np.pi / 2)[yaw % 4])
