"""Scenes of a turn with a load among neighbours."""

from __future__ import annotations

from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Kind
from craftsim.validation.audit.scenes.drawing import BLOCK, CLIMBER, FOLDED, RAMP, car, one
from craftsim.validation.audit.scenes.scene import Scene


def turns() -> list[Scene]:
    """Return scenes of a turn to the left, most of them at (3, 3)."""
    corners = ((2, 2), (2, 4), (4, 2), (4, 4))
    beside = [
        one(
            f"{word} beside, {load.name.lower()} turns",
            Action.ROTATE_LEFT,
            (),
            car(3, 3, load=load),
            car(4, 3, load=other),
        )
        for load in (BLOCK, FOLDED)
        for other, word in ((Kind.AIR, "car"), (BLOCK, "loaded car"))
    ]
    at_corners = [
        one(
            f"cars at all corners, {load.name.lower()} turns",
            Action.ROTATE_LEFT,
            (),
            car(3, 3, load=load),
            *(car(x, y, yaw=1) for x, y in corners),
        )
        for load in (BLOCK, FOLDED)
    ]
    return [
        *beside,
        *at_corners,
        one(
            "loaded cars at all corners",
            Action.ROTATE_LEFT,
            (),
            car(3, 3, load=BLOCK),
            *(car(x, y, load=BLOCK) for x, y in corners),
        ),
        one("load leans in beside", Action.ROTATE_LEFT, RAMP, car(4, 4, load=BLOCK), CLIMBER),
        one("load leans straight towards", Action.ROTATE_LEFT, RAMP, car(5, 3, load=BLOCK), CLIMBER),
        one("at the border of the map", Action.ROTATE_LEFT, (), car(0, 3, load=BLOCK)),
    ]
