"""Starts of many episodes side by side: their worlds, and what is to be built in each."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.design import Design, Target
from craftsim.discrete.grid import Grid, Kind

Targets = NDArray[np.int64]
"""(..., T, 5): what is to be built, rows (kind, x, y, z, yaw); yaw -1 where it does not matter, kind 0 in rows that are
not needed."""


NO_TARGETS: Final[Targets] = np.zeros((1, 0, 5), np.int64)
"""Of one world in which nothing is to be built."""


class Starts(NamedTuple):
    """How n episodes begin."""

    grids: Grid
    """A batch of n worlds."""
    designs: Targets
    """(n, T, 5)."""

    @classmethod
    def of(cls, grids: Sequence[Grid], designs: Targets) -> Starts:
        """Return the starts of some worlds, one or more; ``designs`` (n, T, 5), or (T, 5) for all of them."""
        return cls(Grid.stack(grids), np.broadcast_to(designs, (len(grids), *designs.shape[-2:])).copy())

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.designs)

    def take(self, rows: NDArray[np.integer]) -> Starts:
        """Return copies of some of them."""
        return Starts(self.grids[rows], self.designs[rows])

    def put(self, rows: NDArray[np.integer], others: Starts) -> None:
        """Replace some of them by others, each by the one of the same place."""
        self.grids.cells[rows], self.grids.cars[rows] = others.grids.cells, others.grids.cars
        self.designs[rows] = others.designs

    def grid(self, i: int) -> Grid:
        """Return a copy of one world."""
        return self.grids[i].copy()

    def design(self, i: int, name: str) -> Design:
        """Return what is to be built in one world."""
        rows = self.designs[i].tolist()
        return Design(Path(name), tuple(Target(Kind(kind), (x, y, z)) for kind, x, y, z, _ in rows if kind))

    def digests(self) -> list[bytes]:
        """Return a digest (SHA-256) of each start with its design; cars are alike, whatever their numbers."""
        found, arrays = [], self.grids.to_arrays()
        for kind, yaw, cars, design in zip(
            *(arrays[name] for name in ("kind", "yaw", "cars")), self.designs, strict=True
        ):
            one = hashlib.sha256(repr(kind.shape).encode())
            one.update(kind.tobytes() + yaw.tobytes())
            one.update(cars[np.lexsort(cars.T)].tobytes())
            one.update(design[design[:, 0] != 0].tobytes())
            found.append(one.digest())
        return found


class StartSource(Protocol):
    """What the starts of a task's episodes come from."""

    def draw(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n starts; the generator decides all that is drawn."""
