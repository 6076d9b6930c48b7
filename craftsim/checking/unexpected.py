"""Contacts that an action does not explain: the first place to look when it goes wrong."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from craftsim.checking.contact_log import Contact
from craftsim.discrete.footprint import cell_of
from craftsim.discrete.grid import SECOND_PART, Cell, Grid, Kind, beside
from craftsim.discrete.readback import Poses, Reading
from craftsim.models.overlaps import GROUND, WALL


def unexpected_contacts(
    contacts: Collection[Contact],
    poses: Poses,
    before: Reading,
    predicted: Grid,
    own: Collection[str],
    cars: Collection[int],
) -> tuple[Contact, ...]:
    """Return the contacts of a car and its things that were not there at the start and that the prediction does not
    explain, hardest first.

    A car and what it handles may touch each other, and what bears them where they are and where they should be.

    Args:
        contacts: what touched.
        poses: of the start, for the names of the objects.
        before: the start as it was read.
        predicted: the world that the rules predict.
        own: the car that is asked about, and what it handles, by name.
        cars: those that act, itself included.
    """
    contacts = [c for c in contacts if not c.at_start and (c.first in own or c.second in own)]
    if not contacts:
        return ()
    bearers = _bearers(poses, before)
    known: set[frozenset[str]] = set()
    for car in cars:
        name = f"car {car}"
        way = [cell_of(before.grid, car), cell_of(predicted, car)]
        places = {name: way}
        for index in handled(before, predicted, car):
            places[poses.name(index)] = [part for cell in way for part in _parts(predicted, cell)]
            places[poses.name(index)] += _parts(before.grid, way[0])
        known |= {frozenset((a, b)) for a in places for b in places}
        for thing, cells in places.items():
            below = [(x, y, z - 1) for x, y, z in cells]
            known |= {frozenset((thing, bearers[cell])) for cell in below if cell in bearers}
        ramps = [cell for cell in way if before.grid.kind_at(cell) in (Kind.FOOT, Kind.BODY)]
        known |= {frozenset((name, bearers[cell])) for cell in ramps}
    strange = [c for c in contacts if frozenset((c.first, c.second)) not in known]
    return tuple(sorted(strange, key=lambda contact: -contact.peak_n))


def handled(before: Reading, predicted: Grid, car: int) -> list[int]:
    """Return the objects, by their index, that an action is about: the car's load, what it takes, turns or shoves."""
    cell = cell_of(before.grid, car)
    loads = [index for index, thing in enumerate(before.objects) if thing.carrier == car]
    return [*loads, *_changing(before, predicted, cell), *shoved(before, predicted, car)]


def shoved(before: Reading, predicted: Grid, car: int) -> list[int]:
    """Return the objects, by their index, in whose place the car should be after its action."""
    there = cell_of(predicted, car)
    return [] if there == cell_of(before.grid, car) else _changing(before, predicted, there)


def under(before: Reading, predicted: Grid, car: int) -> list[int]:
    """Return the objects, by their index, that a car stands and drives on, down to the ground.

    A car on the foot of a slope is in the same cell as the foot, and on the slope all the same.
    """
    stands = sorted((cell_of(before.grid, car), cell_of(predicted, car)))
    tops = {cell[:2]: cell[2] for cell in stands}
    return [
        index
        for index, thing in enumerate(before.objects)
        if thing.carrier is None
        and (thing.cell[2] < tops.get(thing.cell[:2], 0) or _foot(before.grid, thing.cell) in stands)
    ]


def _foot(grid: Grid, cell: Cell) -> Cell | None:
    """Return the cell of the foot of the unfolded slope whose body stands in a cell; None where there is none."""
    return _parts(grid, cell)[1] if grid.kind_at(cell) == Kind.BODY else None


def _changing(before: Reading, predicted: Grid, cell: Cell) -> list[int]:
    """Return the objects that stand in a cell which should hold something else afterwards."""
    if before.grid.kind_at(cell) == predicted.kind_at(cell):
        return []
    things = enumerate(before.objects)
    return [index for index, thing in things if thing.carrier is None and thing.cell == cell]


def _parts(grid: Grid, cell: Cell) -> list[Cell]:
    """Return a cell, and the second one of the slope that stands there."""
    if grid.kind_at(cell) not in SECOND_PART:
        return [cell]
    return [cell, beside(cell, int(grid.yaw[cell]))]


def _bearers(poses: Poses, reading: Reading) -> dict[Cell, str]:
    """Return the name of what fills each cell, the ground included; a carried object fills none."""
    grid = reading.grid
    found: dict[Cell, str] = {(int(x), int(y), 0): GROUND for x, y in np.ndindex(*grid.kind.shape[:2])}
    found |= {(int(x), int(y), int(z)): WALL for x, y, z in np.argwhere(grid.kind == Kind.WALL)}
    for index, thing in enumerate(reading.objects):
        if thing.carrier is None:
            found |= dict.fromkeys(_parts(grid, thing.cell), poses.name(index))
    return found
