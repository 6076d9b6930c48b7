"""What may be near an action: each thing and car that a world can hold, in every way that it can stand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Final

from craftsim.discrete.grid import Cell, Kind, beside
from craftsim.validation.contexts.context import DIRECTION_NAMES
from craftsim.validation.neighbourhoods.scenery import Scenery

_REACH: Final = 2
"""Columns away from the acting car; a flap's lip reaches into the second."""
_LEVELS: Final = (-1, 0, 1, 2)


_NOTHING: Final = Scenery()


@dataclass(frozen=True)
class Occupant:
    """What may be a neighbour, in cell (0, 0) of level 0."""

    name: str
    """Such as ``block``, ``fslope-left`` or ``car+block-low-back``, with the direction of gear, foot or downhill."""
    mirrored: str
    """Name of its mirror image."""
    scenery: Scenery
    bearer: Scenery = _NOTHING
    """The ramp that a car is on, which comes with it."""

    @cached_property
    def columns(self) -> tuple[tuple[int, int], ...]:
        """Where it is, its bearer left aside."""
        cells = [cell for _, cell, _ in self.scenery.things] + [row[:3] for row in self.scenery.cars]
        cells += [beside(cell, yaw) for kind, cell, yaw in self.scenery.things if kind == Kind.BODY]
        return tuple((x, y) for x, y, _ in cells)


def places(occupant: Occupant) -> Iterator[Cell]:
    """Yield where an occupant is near a car in column (0, 0); levels count from the car's lower one."""
    # What takes more than one cell counts where it reaches into the neighbourhood.
    spread = range(-_REACH - 1, _REACH + 2)
    for dx, dy, dz in product(spread, spread, _LEVELS):
        if any(max(abs(x + dx), abs(y + dy)) <= _REACH for x, y in occupant.columns):
            yield dx, dy, dz


def occupants() -> Iterator[Occupant]:
    """Yield every occupant; flags have a block's shape and are left out."""
    origin = (0, 0, 0)
    yield Occupant("block", "block", Scenery(((Kind.BLOCK, origin, 0),)))
    yield Occupant("wall", "wall", Scenery(((Kind.WALL, origin, 0),)))
    # Along or across: a car is as long to the front as to the back.
    yield Occupant("car-along", "car-along", _car(0, Kind.AIR, 0))
    yield Occupant("car-across", "car-across", _car(1, Kind.AIR, 0))
    yield Occupant("car+block", "car+block", _car(0, Kind.BLOCK, 0))
    for yaw, side in enumerate(DIRECTION_NAMES):
        other, back = DIRECTION_NAMES[-yaw % 4], (yaw + 2) % 4
        low = Scenery(((Kind.BODY, beside(origin, back), yaw),))
        high = Scenery(((Kind.BODY, (0, 0, -1), yaw),))
        for name, scenery, bearer in (
            ("fslope", Scenery(((Kind.FSLOPE, origin, yaw),)), _NOTHING),
            ("ramp", Scenery(((Kind.BODY, origin, yaw),)), _NOTHING),
            ("car+fslope", _car(back, Kind.FSLOPE, 0), _NOTHING),
            ("car-low", _car(yaw, Kind.AIR, 1), low),
            ("car-high", _car(yaw, Kind.AIR, 2), high),
            ("car+block-low", _car(yaw, Kind.BLOCK, 1), low),
            ("car+block-high", _car(yaw, Kind.BLOCK, 2), high),
            ("car+fslope-gear-downhill-low", _car(back, Kind.FSLOPE, 1), low),
            ("car+fslope-gear-downhill-high", _car(back, Kind.FSLOPE, 2), high),
            ("car+fslope-gear-uphill-low", _car(yaw, Kind.FSLOPE, 1), low),
            ("car+fslope-gear-uphill-high", _car(yaw, Kind.FSLOPE, 2), high),
        ):
            yield Occupant(f"{name}-{side}", f"{name}-{other}", scenery, bearer)


def _car(yaw: int, load: Kind, half: int) -> Scenery:
    load_yaw = (yaw + 2) % 4 if load == Kind.FSLOPE else 0
    return Scenery((), ((0, 0, 0, yaw, load, load_yaw, half),))
