"""What cells hold, and the columns in which cars are described."""

from __future__ import annotations

from enum import IntEnum


class Kind(IntEnum):
    """What a cell holds, or what a car carries."""

    AIR = 0
    GROUND = 1
    WALL = 2
    BLOCK = 3
    FLAG = 4
    FSLOPE = 5
    GEAR = 6
    BODY = 7
    FOOT = 8


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
