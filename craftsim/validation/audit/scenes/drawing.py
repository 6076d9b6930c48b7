"""The pieces that scenes are drawn with: things, cars, stacks of blocks, and a ramp with loaded cars on it."""

from __future__ import annotations

from typing import Final

from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Kind
from craftsim.validation.audit.scenes.scene import CarRow, Scene, Thing

BLOCK: Final = Kind.BLOCK
FLAG: Final = Kind.FLAG
WALL: Final = Kind.WALL
FOLDED: Final = Kind.FSLOPE
OPEN: Final = Kind.BODY


def car(x: int, y: int, z: int = 1, yaw: int = 0, load: Kind = Kind.AIR, slope: int = 0) -> CarRow:
    """Return a car; ``slope`` is 1 on a ramp's foot and 2 on its body.

    It carries a folded slope with its gear behind it.
    """
    return x, y, z, yaw, load, (yaw + 2) % 4 if load == Kind.FSLOPE else 0, slope


def stack(x: int, y: int, height: int = 1) -> tuple[Thing, ...]:
    """Return blocks on top of each other."""
    return tuple((BLOCK, (x, y, z)) for z in range(1, height + 1))


def one(name: str, action: Action, things: tuple[Thing, ...], *cars: CarRow) -> Scene:
    """Return the scene of a single action of the first car."""
    return Scene(name, things, cars, (action,))


RAMP: Final[tuple[Thing, ...]] = (*stack(1, 3), (OPEN, (2, 3, 1), 0))
"""It falls in +x from the block at (1, 3) to its foot at (3, 3)."""
CLIMBER: Final = car(3, 3, yaw=2, load=BLOCK, slope=1)
FALLER: Final = car(2, 3, 2, yaw=0, load=BLOCK, slope=2)
"""Loaded cars on it, on their way up and down."""
