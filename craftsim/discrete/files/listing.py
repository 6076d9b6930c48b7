"""What a blueprint lists, and what it leaves to chance."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from craftsim.discrete.grid import Cell, Kind


@dataclass(frozen=True)
class ListedObject:
    """An object with its place; a slope is listed once, by its FSLOPE or BODY cell."""

    kind: Kind
    cell: Cell
    yaw: int
    line: int
    """Line of the file that lists it."""


@dataclass(frozen=True)
class ListedCar:
    """A car with its place; load and slope state are additions of ours, for worlds saved while they run."""

    car: int
    cell: Cell
    yaw: int
    load: Kind
    load_yaw: int
    slope: int
    line: int


@dataclass(frozen=True)
class Override:
    """A cell of a saved world that the listed objects do not account for."""

    cell: Cell
    kind: Kind
    yaw: int


@dataclass(frozen=True)
class Snapshot:
    """What a world saved while it runs has beyond its listed objects: odd cells and marks that differ."""

    cells: tuple[Override, ...]
    top: tuple[tuple[Cell, int], ...]
    back: tuple[tuple[Cell, int], ...]


@dataclass(frozen=True)
class Listing:
    """The contents of a start file; what the counts have beyond the listed objects and cars is drawn at random."""

    path: Path
    size: Cell
    """(L, W, H) in cells."""
    n_blocks: int
    n_slopes: int
    n_cars: int
    objects: tuple[ListedObject, ...]
    cars: tuple[ListedCar, ...]
    goal: Cell | None
    notes: tuple[str, ...]
    """What the file has that is accepted and ignored, in plain words."""
    snapshot: Snapshot | None

    @property
    def is_fixed(self) -> bool:
        """Whether nothing is left to chance."""
        numbers = (self.n_blocks, self.n_slopes, self.n_cars)
        return numbers == (self.listed(Kind.BLOCK), self.listed(Kind.FSLOPE, Kind.BODY), len(self.cars))

    def listed(self, *kinds: Kind) -> int:
        """Return how many objects of some kinds are listed, carried and odd ones included."""
        odd = self.snapshot.cells if self.snapshot else ()
        present = [o.kind for o in self.objects] + [c.load for c in self.cars] + [o.kind for o in odd]
        return sum(kind in kinds for kind in present)
