"""Starts of many episodes side by side: their worlds, and what is to be built in each."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.cells import RuleFlags, World
from craftsim.discrete.files.design import Design, Target
from craftsim.discrete.grid import Grid, Kind

Targets = NDArray[np.int64]
"""(..., T, 5): what is to be built, rows (kind, x, y, z, yaw); yaw -1 where it does not matter, kind 0 in rows that are
not needed."""


NO_TARGETS: Final[Targets] = np.zeros((1, 0, 5), np.int64)
"""Of one world in which nothing is to be built."""


class Starts(NamedTuple):
    """How n episodes begin; the arrays of worlds are as in Grid, with a leading dimension."""

    kind: NDArray[np.int8]
    yaw: NDArray[np.int8]
    top: NDArray[np.int16]
    back: NDArray[np.bool_]
    cars: NDArray[np.int64]
    designs: Targets
    """(n, T, 5)."""

    @classmethod
    def of(cls, grids: Sequence[Grid], designs: Targets) -> Starts:
        """Return the starts of some worlds, one or more; ``designs`` (n, T, 5), or (T, 5) for all of them."""
        return cls(
            np.stack([grid.kind for grid in grids]),
            np.stack([grid.yaw for grid in grids]),
            np.stack([grid.top for grid in grids]),
            np.stack([grid.back for grid in grids]),
            np.stack([grid.cars for grid in grids]),
            np.broadcast_to(designs, (len(grids), *designs.shape[-2:])).copy(),
        )

    @property
    def worlds(self) -> World:
        """The worlds, as measures look at them."""
        return World(self.kind, self.yaw, self.top, self.back, self.cars, RuleFlags())

    def take(self, rows: NDArray[np.integer]) -> Starts:
        """Return copies of some of them."""
        return Starts(*(array[rows] for array in self))

    def put(self, rows: NDArray[np.integer], others: Starts) -> None:
        """Replace some of them by others, each by the one of the same place."""
        for name in self._fields:
            getattr(self, name)[rows] = getattr(others, name)

    def grid(self, i: int) -> Grid:
        """Return a copy of one world."""
        return Grid(self.kind[i], self.yaw[i], self.cars[i], self.top[i], self.back[i]).copy()

    def design(self, i: int, name: str) -> Design:
        """Return what is to be built in one world."""
        rows = self.designs[i].tolist()
        return Design(Path(name), tuple(Target(Kind(kind), (x, y, z)) for kind, x, y, z, _ in rows if kind))

    def digests(self) -> list[bytes]:
        """Return a digest (SHA-256) of each start with its design; cars are alike, whatever their numbers."""
        found = []
        for i in range(len(self.kind)):
            cars, design = self.cars[i], self.designs[i]
            one = hashlib.sha256(repr(self.kind[i].shape).encode())
            one.update(self.kind[i].tobytes() + self.yaw[i].tobytes())
            one.update(cars[np.lexsort(cars.T)].tobytes())
            one.update(design[design[:, 0] != 0].tobytes())
            found.append(one.digest())
        return found


class StartSource(Protocol):
    """What the starts of a task's episodes come from."""

    def draw(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n starts; the generator decides all that is drawn."""
