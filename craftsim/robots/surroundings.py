"""Where in a world its cars and what they handle can be at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import Cell

_AROUND_M: Final = 10.0
"""Around the world: what is further off was not measured there, however badly."""


@dataclass(frozen=True)
class Surroundings:
    """The surroundings of a world."""

    size: Cell
    """Of the world, in cells."""

    def holds(self, x: float, y: float, z: float) -> bool:
        """Return whether something can be at this position, in metres.

        Example:
            >>> Surroundings((3, 1, 1)).holds(0.2, -5.0, 0.1), Surroundings((3, 1, 1)).holds(40.0, 0.0, 0.1)
            (True, False)
        """
        nx, ny, nz = self.size
        ends = zip((x, y, z), (nx * CELL_PITCH_M, ny * CELL_PITCH_M, nz * LEVEL_HEIGHT_M), strict=True)
        return all(-_AROUND_M <= place <= end + _AROUND_M for place, end in ends)
