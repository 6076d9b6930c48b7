"""The 15 primitive actions and the directions they stand for."""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class Action(IntEnum):
    """A primitive action; the numbers are CraftEnv's. Moves are map directions, whatever the car's yaw.

    Example:
        >>> import craftsim
        >>> craftsim.Action.LIFT, craftsim.Action["MOVE_RIGHT"].value
        (<Action.LIFT: 0>, 9)
    """

    LIFT = 0
    DROP = 1
    FOLD = 2
    UNFOLD = 3
    ROTATE_LEFT = 4
    ROTATE_RIGHT = 5
    MOVE_FORWARD = 6
    MOVE_BACK = 7
    MOVE_LEFT = 8
    MOVE_RIGHT = 9
    STOP = 10
    MOVE_FORWARD_LEFT = 11
    MOVE_FORWARD_RIGHT = 12
    MOVE_BACK_LEFT = 13
    MOVE_BACK_RIGHT = 14


MOVE_DIRECTION: Final[dict[Action, int]] = {
    Action.MOVE_RIGHT: 0,
    Action.MOVE_FORWARD: 1,
    Action.MOVE_LEFT: 2,
    Action.MOVE_BACK: 3,
}
"""Grid yaw (0..3: +x, +y, -x, -y) in which each of the four moves goes. The diagonal moves are never legal."""
