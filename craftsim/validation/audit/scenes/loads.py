"""Scenes of lifting and setting down, and of driving onto what nothing may stand on."""

from __future__ import annotations

from craftsim.discrete.actions import Action
from craftsim.validation.audit.scenes.drawing import BLOCK, CLIMBER, FLAG, FOLDED, RAMP, car, one, stack
from craftsim.validation.audit.scenes.scene import Scene, Thing


def lifts_and_drops() -> list[Scene]:
    """Return scenes of lifting and setting down beside what leans, hangs or stands close."""
    all_round = [car(x, y, load=BLOCK) for x, y in ((2, 3), (4, 3), (3, 2), (3, 4))]
    facing: tuple[Thing, ...] = ((FOLDED, (2, 3, 1), 0), (FOLDED, (4, 3, 1), 2))
    return [
        one("gears in one cell", Action.LIFT, facing, car(4, 3)),
        one("gears in one cell", Action.DROP, facing[:1], car(4, 3, load=FOLDED)),
        one("gear over the foot of a ramp", Action.DROP, RAMP, car(4, 3, load=FOLDED)),
        one("car on the block beside", Action.LIFT, (*stack(3, 3), *stack(4, 3)), car(3, 3), car(4, 3, 2)),
        one("loaded cars all round", Action.LIFT, stack(3, 3), car(3, 3), *all_round),
        one("loaded cars all round", Action.DROP, (), car(3, 3, load=BLOCK), *all_round),
        one("load leans in beside", Action.DROP, RAMP, car(4, 4, load=BLOCK), CLIMBER),
    ]


def onto_folded_slopes_and_flags() -> list[Scene]:
    """Return scenes of driving from a block onto what nothing may stand on."""
    slope: tuple[Thing, ...] = (*stack(2, 3), (FOLDED, (3, 3, 1), 0))
    return [
        one("onto a folded slope", Action.MOVE_RIGHT, slope, car(2, 3, 2)),
        one("onto a folded slope, loaded", Action.MOVE_RIGHT, slope, car(2, 3, 2, load=BLOCK)),
        one("onto a flag", Action.MOVE_RIGHT, (*stack(2, 3), (FLAG, (3, 3, 1))), car(2, 3, 2)),
    ]
