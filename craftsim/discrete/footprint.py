"""What an action needs of the world while it runs: the cells it sweeps, and the objects it relies on or changes.

Two actions of different cars may run at the same time when neither sweeps space that the other sweeps, neither changes
an object that the other relies on, and no two loads in motion pass side by side, where 2.5 mm of air are too little
for two moving machines. What each of the 15 actions needs is compiled (:mod:`craftsim.discrete.kernel.claims`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Self

import numpy as np

from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import CarField, Cell, Grid
from craftsim.discrete.kernel.claims import CHANGES, LOADS, MOST, RELIES, SPACE, Claims, write_claims
from craftsim.discrete.kernel.jit import seldom

_write_claims = seldom(write_claims)
_PARTS: Final = {"space": SPACE, "changes": CHANGES, "relies": RELIES, "loads": LOADS}


@dataclass(frozen=True)
class Footprint:
    """The cells (x, y, z) that matter to one action."""

    space: frozenset[Cell] = frozenset()
    """Swept by the car, its load or a flap."""
    changes: frozenset[Cell] = frozenset()
    """Whose object the action takes, puts down or turns."""
    relies: frozenset[Cell] = frozenset()
    """Whose object must stay as it is: what is stood on, driven under or out of."""
    loads: frozenset[Cell] = frozenset()
    """Through which a load moves, sideways play and all."""

    @classmethod
    def built_in(cls, grid: Grid, car: int, action: int) -> Self:
        """Return what a legal action of the 15 needs in a world; STOP needs what the car needs where it stands."""
        rows = np.empty((MOST, 4), np.int16)
        count = _write_claims(grid.cells, grid.cars, 0, car, int(action), rows)
        found = [((x, y, z), bits) for x, y, z, bits in rows[:count].tolist()]
        return cls(*(frozenset(cell for cell, bits in found if bits & part) for part in _PARTS.values()))

    def claims(self) -> Claims:
        """Return (cells, 4): the rows (x, y, z, bits) of :mod:`craftsim.discrete.kernel.claims`."""
        bits: dict[Cell, int] = {}
        for name, part in _PARTS.items():
            for cell in getattr(self, name):
                bits[cell] = bits.get(cell, 0) | part
        return np.array([(*cell, bits[cell]) for cell in sorted(bits)], np.int16).reshape(-1, 4)

    def __or__(self, other: Footprint) -> Footprint:
        return Footprint(
            self.space | other.space,
            self.changes | other.changes,
            self.relies | other.relies,
            self.loads | other.loads,
        )

    @cached_property
    def beside_loads(self) -> frozenset[Cell]:
        """The cells of the loads and their neighbours on the same level."""
        steps = ((0, 0), *DIRECTIONS.tolist())
        return frozenset((x + dx, y + dy, z) for x, y, z in self.loads for dx, dy in steps)


def cell_of(grid: Grid, car: int) -> Cell:
    """Return the cell of a car."""
    x, y, z = grid.cars[car, : CarField.YAW].tolist()
    return x, y, z
