"""Scenes of moves on and beside a ramp."""

from __future__ import annotations

from craftsim.discrete.actions import Action
from craftsim.validation.audit.scenes.drawing import (
    BLOCK,
    CLIMBER,
    FALLER,
    FOLDED,
    OPEN,
    RAMP,
    WALL,
    car,
    one,
    stack,
)
from craftsim.validation.audit.scenes.scene import Scene, Thing


def ramps() -> list[Scene]:
    """Return scenes of moves on and beside the ramp."""
    gear_over_body: tuple[Thing, ...] = (*RAMP, *stack(2, 4), (FOLDED, (2, 4, 2), 3))
    gear_over_foot: tuple[Thing, ...] = (*RAMP, *stack(3, 4), (FOLDED, (3, 4, 2), 3))
    unloaded_down, unloaded_up = car(2, 3, 2, slope=2), car(3, 3, yaw=2, slope=1)
    stairs: tuple[Thing, ...] = (
        (OPEN, (4, 3, 1), 0),
        *stack(3, 3),
        *stack(2, 3),
        *stack(1, 3, 2),
        (OPEN, (2, 3, 2), 0),
    )
    return [
        one("behind a load that leans", Action.MOVE_LEFT, RAMP, car(5, 3, yaw=2, load=BLOCK), CLIMBER),
        one("behind a load that leans, unloaded", Action.MOVE_LEFT, RAMP, car(5, 3, yaw=2), CLIMBER),
        one(
            "behind a load that leans, sideways",
            Action.MOVE_BACK,
            RAMP,
            car(4, 4, yaw=2, load=BLOCK),
            CLIMBER,
        ),
        one(
            "gear to where a load leans, across",
            Action.MOVE_BACK,
            RAMP,
            car(4, 5, yaw=1, load=FOLDED),
            CLIMBER,
        ),
        one("gear to where a load leans, straight", Action.MOVE_LEFT, RAMP, car(6, 3, load=FOLDED), CLIMBER),
        one("down towards a loaded car", Action.MOVE_RIGHT, RAMP, FALLER, car(4, 3, yaw=2, load=BLOCK)),
        one("down towards a car", Action.MOVE_RIGHT, RAMP, FALLER, car(4, 3, yaw=2)),
        one("down towards a block", Action.MOVE_RIGHT, (*RAMP, *stack(4, 3)), FALLER),
        one("down towards a block, unloaded", Action.MOVE_RIGHT, (*RAMP, *stack(4, 3)), unloaded_down),
        one("down towards a wall", Action.MOVE_RIGHT, (*RAMP, (WALL, (4, 3, 1))), FALLER),
        one("down towards a gear from the side", Action.MOVE_RIGHT, (*RAMP, (FOLDED, (4, 4, 1), 3)), FALLER),
        one("down towards a gear from ahead", Action.MOVE_RIGHT, (*RAMP, (FOLDED, (5, 3, 1), 2)), FALLER),
        one(
            "off a ramp towards a carried gear",
            Action.MOVE_RIGHT,
            RAMP,
            car(3, 3, load=BLOCK, slope=1),
            car(5, 3, load=FOLDED),
        ),
        one(
            "up below a carried gear",
            Action.MOVE_LEFT,
            (*RAMP, *stack(2, 4)),
            CLIMBER,
            car(2, 4, 2, yaw=1, load=FOLDED),
        ),
        one("up below a gear over the foot", Action.MOVE_LEFT, gear_over_foot, CLIMBER),
        one("down below a gear over the foot", Action.MOVE_RIGHT, gear_over_foot, car(1, 3, 2, load=BLOCK)),
        one("onto the foot below a gear", Action.MOVE_LEFT, gear_over_foot, car(4, 3, yaw=2, load=BLOCK)),
        one("onto a top through a gear", Action.MOVE_RIGHT, gear_over_body, car(1, 3, 2)),
        one(
            "onto a top through a gear, sideways",
            Action.MOVE_FORWARD,
            (*gear_over_body, *stack(2, 2)),
            car(2, 2, 2),
        ),
        one(
            "over a crest",
            Action.MOVE_LEFT,
            ((OPEN, (3, 3, 1), 0), (OPEN, (2, 3, 1), 2)),
            car(3, 3, 2, yaw=2, slope=2),
        ),
        one("onto a second ramp", Action.MOVE_LEFT, stairs, car(4, 3, 2, yaw=2, slope=2)),
        one(
            "against another slope's body",
            Action.MOVE_RIGHT,
            (*RAMP, *stack(5, 3), (OPEN, (4, 3, 1), 0)),
            car(3, 3, slope=1),
        ),
        one(
            "over the edge to a foot across",
            Action.MOVE_LEFT,
            ((OPEN, (3, 3, 1), 0), (OPEN, (2, 4, 1), 3)),
            car(3, 3, 2, yaw=2, slope=2),
        ),
        one("into a car on the same ramp", Action.MOVE_LEFT, RAMP, unloaded_up, car(2, 3, 2, yaw=2, slope=2)),
        one(
            "in below a body with a car on top", Action.MOVE_RIGHT, RAMP[1:], car(1, 3, yaw=2), unloaded_down
        ),
        one(
            "on a top with a car below",
            Action.MOVE_LEFT,
            RAMP[1:],
            car(3, 3, yaw=2, slope=1),
            car(2, 3, yaw=2),
        ),
        one("off a top with a car below", Action.MOVE_RIGHT, RAMP, FALLER, car(2, 3, yaw=2)),
    ]
