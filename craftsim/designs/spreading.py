"""Things spread over a free floor such that a car can get at each of them, and away with it.

The free floor stays in one piece, and everything touches it. Whether a cell can be taken is seen from the eight around
it alone: those of its free neighbours that are joined there stay joined.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import DIRECTIONS

Column = tuple[int, int]
"""(x, y)."""

_AROUND: Final = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
"""The eight neighbours in a circle; those with an edge in common are the even ones."""


class FreeFloor:
    """A floor on which things take cells."""

    def __init__(self, free: NDArray[np.bool_]) -> None:
        """Take (L, W): where things may be put, and cars drive; beside it is nothing."""
        # A border saves all tests for the edge.
        self._free = np.pad(free, 1)
        self._kept = np.zeros_like(self._free)
        self._things = np.zeros_like(self._free)

    @property
    def free(self) -> NDArray[np.bool_]:
        """(L, W): what is free still."""
        return self._free[1:-1, 1:-1]

    def keep(self, column: Column) -> None:
        """Let a free cell stay so."""
        self._kept[column[0] + 1, column[1] + 1] = True

    def turning_places(self) -> NDArray[np.int64]:
        """Return (n, 2): the cells with eight free ones around them, where a car can turn with a slope."""
        length, width = self.free.shape
        shifted = [self._free[1 + dx : 1 + dx + length, 1 + dy : 1 + dy + width] for dx, dy in _AROUND]
        return np.argwhere(self.free & np.all(shifted, axis=0))

    def neighbours(self) -> NDArray[np.int64]:
        """Return (L, W): how many of the four cells beside each are free."""
        length, width = self.free.shape
        found = np.zeros(self.free.shape, np.int64)
        for dx, dy in DIRECTIONS.tolist():
            found += self._free[1 + dx : 1 + dx + length, 1 + dy : 1 + dy + width]
        return found

    def take(self, *columns: Column) -> bool:
        """Take cells for one thing, the first of which a car must get at; return whether that was possible."""
        taken: list[Column] = []
        for column in columns:
            if not self._can_go(column):
                break
            self._free[column[0] + 1, column[1] + 1] = False
            taken.append(column)
        if len(taken) == len(columns) and self._touched(columns[0]) and all(map(self._leaves_touched, taken)):
            self._things[columns[0][0] + 1, columns[0][1] + 1] = True
            return True
        for x, y in taken:
            self._free[x + 1, y + 1] = True
        return False

    def give_back(self, *columns: Column) -> None:
        """Free the cells of a thing again that were taken last."""
        for x, y in columns:
            self._free[x + 1, y + 1] = True
            self._things[x + 1, y + 1] = False

    def _can_go(self, column: Column) -> bool:
        """Return whether a cell is free, not kept, and no bridge between parts of the free floor."""
        x, y = column[0] + 1, column[1] + 1
        if not self._free[x, y] or self._kept[x, y]:
            return False
        circle = [bool(self._free[x + dx, y + dy]) for dx, dy in _AROUND]
        # A free neighbour begins a new piece where the way back around the circle to the last one is not free.
        pieces = sum(circle[i] and not (circle[i - 1] and circle[i - 2]) for i in range(0, 8, 2))
        return pieces <= 1 and any(circle[::2])

    def _leaves_touched(self, column: Column) -> bool:
        """Return whether the things beside a cell that is taken touch the free floor still."""
        beside = [(column[0] + dx, column[1] + dy) for dx, dy in DIRECTIONS.tolist()]
        return all(self._touched((x, y)) for x, y in beside if self._things[x + 1, y + 1])

    def _touched(self, column: Column) -> bool:
        x, y = column[0] + 1, column[1] + 1
        return any(self._free[x + dx, y + dy] for dx, dy in DIRECTIONS.tolist())
