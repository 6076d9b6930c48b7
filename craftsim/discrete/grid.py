"""The state of one grid world as integer arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.cells import RuleFlags, World, derive_marks
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.kinds import CarField, Kind

__all__ = ["KINDS_WITH_YAW", "SECOND_PART", "CarField", "Cell", "Grid", "Kind", "beside"]


KINDS_WITH_YAW: Final = (Kind.FSLOPE, Kind.GEAR, Kind.BODY, Kind.FOOT)

SECOND_PART: Final = {Kind.FSLOPE: Kind.GEAR, Kind.BODY: Kind.FOOT}
"""What a slope has in the next cell in direction of its yaw."""

Cell = tuple[int, int, int]
"""(x, y, z)."""


def beside(cell: Cell, yaw: int) -> Cell:
    """Return the next cell in direction yaw (any integer, taken modulo 4)."""
    dx, dy = DIRECTIONS[yaw % 4]
    return cell[0] + int(dx), cell[1] + int(dy), cell[2]


@dataclass(eq=False)
class Grid:
    """One world: what is in each cell, where the cars are, and the marks kept with each cell.

    Cells are (x, y, z) with 0 <= x < L, 0 <= y < W and 0 <= z <= H; z = 0 is the ground layer, 1 the floor.

    Example:
        >>> import craftsim
        >>> grid = craftsim.Grid.empty((3, 2, 1), n_cars=1)  # the car at (0, 0, 1), heading +x
        >>> grid.kind[1, 0, 1] = craftsim.Kind.BLOCK
        >>> grid.derive_marks()
        >>> grid.size, grid.n_cars
        ((3, 2, 1), 1)
    """

    kind: NDArray[np.int8]
    """(L, W, H + 1): a Kind per cell."""
    yaw: NDArray[np.int8]
    """(L, W, H + 1): 0..3 for kinds that have a yaw, else 0."""
    cars: NDArray[np.int64]
    """(n, 7): one row a car, columns as CarField."""
    top: NDArray[np.int16]
    """(L, W, H + 1): the mark "what is on me": -1 nothing, -2 an object, k >= 0 car k."""
    back: NDArray[np.bool_]
    """(L, W, H + 1): the mark "I am the landing of a ramp"; only ever true for blocks."""

    @classmethod
    def empty(cls, size: Cell, n_cars: int = 0) -> Grid:
        """Return a world of size (L, W, H) with bare ground; its cars wait to be placed, all at (0, 0, 1)."""
        length, width, height = size
        shape = (length, width, height + 1)
        kind = np.zeros(shape, np.int8)
        kind[:, :, 0] = Kind.GROUND
        cars = np.zeros((n_cars, len(CarField)), np.int64)
        cars[:, CarField.Z] = 1
        top = np.full(shape, -1, np.int16)
        return cls(kind, np.zeros(shape, np.int8), cars, top, np.zeros(shape, np.bool_))

    @property
    def size(self) -> Cell:
        """(L, W, H) in cells; H does not count the ground layer."""
        length, width, layers = self.kind.shape
        return length, width, layers - 1

    @property
    def n_cars(self) -> int:
        """Number of cars."""
        return len(self.cars)

    def kind_at(self, cell: Cell) -> Kind:
        """Return what is in a cell of the map, or above the map, where there is air and a car may be."""
        return Kind(self.kind[cell]) if cell[2] <= self.size[2] else Kind.AIR

    def copy(self) -> Grid:
        """Return a world that shares nothing with this one."""
        return Grid(self.kind.copy(), self.yaw.copy(), self.cars.copy(), self.top.copy(), self.back.copy())

    def derive_marks(self) -> None:
        """Overwrite both marks with what follows from the visible state."""
        derive_marks(World(self.kind, self.yaw, self.top, self.back, self.cars, RuleFlags()))

    def same_visible(self, other: Grid) -> bool:
        """Return whether objects and cars are equal; marks are not compared."""
        return (
            np.array_equal(self.kind, other.kind)
            and np.array_equal(self.yaw, other.yaw)
            and np.array_equal(self.cars, other.cars)
        )

    def same_marks(self, other: Grid) -> bool:
        """Return whether both marks are equal in every cell."""
        return np.array_equal(self.top, other.top) and np.array_equal(self.back, other.back)
