"""Ticks of several cars."""

from __future__ import annotations

from craftsim.discrete.actions import Action
from craftsim.discrete.schedule import Order
from craftsim.validation.audit.scenes.drawing import BLOCK, car
from craftsim.validation.audit.scenes.scene import CarRow, Scene, Thing


def ticks() -> list[Scene]:
    """Return ticks of several cars, as the rules let them follow each other, by the schedule and all at once."""
    ticks: dict[str, tuple[tuple[Thing, ...], tuple[CarRow, ...], tuple[Action, ...]]] = {
        "into a cell that is left at a right angle": (
            (),
            (car(3, 3, load=BLOCK), car(2, 3, load=BLOCK)),
            (Action.MOVE_FORWARD, Action.MOVE_RIGHT),
        ),
        "into a cell that is left straight ahead": (
            (),
            (car(3, 3, load=BLOCK), car(2, 3, load=BLOCK)),
            (Action.MOVE_RIGHT, Action.MOVE_RIGHT),
        ),
        "side by side": (
            (),
            (car(3, 3, load=BLOCK), car(3, 4, load=BLOCK)),
            (Action.MOVE_RIGHT, Action.MOVE_RIGHT),
        ),
        "past each other": (
            (),
            (car(3, 3, load=BLOCK), car(4, 4, load=BLOCK)),
            (Action.MOVE_RIGHT, Action.MOVE_LEFT),
        ),
        "set down beside one that passes": (
            (),
            (car(3, 3, load=BLOCK), car(3, 4, load=BLOCK)),
            (Action.DROP, Action.MOVE_RIGHT),
        ),
        "unloaded at a right angle": ((), (car(3, 3), car(2, 3)), (Action.MOVE_FORWARD, Action.MOVE_RIGHT)),
    }
    orders: tuple[Order, ...] = ("sequential", "concurrent", "at-once")
    return [Scene(name, *tick, order) for name, tick in ticks.items() for order in orders]
