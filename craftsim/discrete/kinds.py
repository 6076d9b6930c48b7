"""What cells hold, and the columns in which cars are described."""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class Kind(IntEnum):
    """What a cell holds, or what a car carries.

    Example:
        >>> import craftsim
        >>> craftsim.Kind.BLOCK.name, int(craftsim.Kind.BLOCK)
        ('BLOCK', 3)
    """

    AIR = 0
    GROUND = 1
    WALL = 2
    BLOCK = 3
    FLAG = 4
    FSLOPE = 5
    GEAR = 6
    BODY = 7
    FOOT = 8


NAMES: Final = {
    Kind.AIR: "nothing",
    Kind.GROUND: "the ground",
    Kind.WALL: "a wall",
    Kind.BLOCK: "a block",
    Kind.FLAG: "a flag",
    Kind.FSLOPE: "a folded slope",
    Kind.GEAR: "the gear of a folded slope",
    Kind.BODY: "the body of a slope",
    Kind.FOOT: "the foot of a slope",
}
"""What is in a cell, in words."""


class CarField(IntEnum):
    """Columns of :attr:`Grid.cars`."""

    X = 0
    Y = 1
    Z = 2
    YAW = 3
    LOAD = 4
    """A Kind; AIR is no load."""
    LOAD_YAW = 5
    """Yaw of a carried folded slope, else 0."""
    SLOPE = 6
    """0 off slopes, 1 in a foot's cell, 2 in the cell above a body."""
