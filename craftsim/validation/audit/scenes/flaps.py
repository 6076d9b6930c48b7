"""Scenes of a flap that swings: folding and unfolding beside all sorts of things."""

from __future__ import annotations

from craftsim.discrete.actions import Action
from craftsim.validation.audit.scenes.drawing import BLOCK, FOLDED, OPEN, WALL, car, one, stack
from craftsim.validation.audit.scenes.scene import CarRow, Scene, Thing


def flaps() -> list[Scene]:
    """Return scenes of a slope at (4, 3) whose foot is at (3, 3): beyond that is (2, 3)."""
    docked = car(4, 3)
    around: dict[str, tuple[tuple[Thing, ...], tuple[CarRow, ...]]] = {
        "car beyond": ((), (car(2, 3),)),
        "loaded car beyond": ((), (car(2, 3, load=BLOCK),)),
        "wall beyond": (((WALL, (2, 3, 1)),), ()),
        "folded slope beyond": (((FOLDED, (2, 3, 1), 2),), ()),
        "ramp's high side beyond": (((OPEN, (2, 3, 1), 2),), ()),
        "facing foot beyond": (((OPEN, (1, 3, 1), 0),), ()),
        "car on facing foot beyond": (((OPEN, (1, 3, 1), 0),), (car(2, 3, yaw=2, slope=1),)),
        "foot across beyond": (((OPEN, (2, 4, 1), 3),), ()),
        "gear from the side beyond": (((FOLDED, (2, 4, 1), 3),), ()),
        "gear from ahead beyond": (((FOLDED, (1, 3, 1), 0),), ()),
        "carried gear from the side beyond": ((), (car(2, 4, yaw=1, load=FOLDED),)),
        "load leans in beyond": (((OPEN, (2, 5, 1), 3),), (car(2, 4, yaw=1, load=BLOCK, slope=1),)),
        "load leans in straight beyond": (
            ((OPEN, (0, 3, 1), 0),),
            (car(1, 3, yaw=2, load=BLOCK, slope=1),),
        ),
        "gear above the foot": ((*stack(3, 4), (FOLDED, (3, 4, 2), 3)), ()),
        "carried gear above the foot": (stack(3, 4), (car(3, 4, 2, yaw=1, load=FOLDED),)),
        "carried gear above the body": (stack(4, 4), (car(4, 4, 2, yaw=1, load=FOLDED),)),
        "car on the landing": (stack(5, 3), (car(5, 3, 2),)),
        "load on the landing": (stack(5, 3), (car(5, 3, 2, load=BLOCK),)),
        "carried gear from the landing": (stack(5, 3), (car(5, 3, 2, load=FOLDED),)),
        "cars beside": ((), (car(4, 4), car(3, 4), car(3, 2), car(4, 2))),
        "loads beside": ((), (car(4, 4, load=BLOCK), car(3, 2, load=BLOCK))),
        "loads beside on the next level": (
            (*stack(3, 4), *stack(4, 2)),
            (car(3, 4, 2, load=BLOCK), car(4, 2, 2, load=BLOCK)),
        ),
        "ramps beside": (((OPEN, (4, 4, 1), 2), (OPEN, (4, 2, 1), 2)), ()),
    }
    scenes = [
        one(name, action, ((kind, (4, 3, 1), 2), *things), docked, *cars)
        for kind, action in ((OPEN, Action.FOLD), (FOLDED, Action.UNFOLD))
        for name, (things, cars) in around.items()
    ]
    slope: Thing = (FOLDED, (4, 3, 1), 2)
    return [
        *scenes,
        one("car in the foot's cell", Action.UNFOLD, (slope,), docked, car(3, 3)),
        one("loaded car in the foot's cell", Action.UNFOLD, (slope,), docked, car(3, 3, load=BLOCK)),
        one("gear from the side in the foot's cell", Action.UNFOLD, (slope, (FOLDED, (3, 4, 1), 3)), docked),
        one(
            "carried gear in the foot's cell", Action.UNFOLD, (slope,), docked, car(3, 4, yaw=1, load=FOLDED)
        ),
    ]
