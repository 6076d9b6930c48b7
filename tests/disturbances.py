"""Declared disturbances: what somebody does to a world in physics that no motor command does."""

from collections.abc import Callable
from typing import Final

from craftsim.models.site import Site
from craftsim.skills.executor import Executor, Observer

_PUSH_N: Final = 4.2
"""A little more than the friction of a block that nothing stands on."""


def push(block: int, by_m: float) -> Observer:
    """Return an observer that pushes a block along +x, from where it is first seen, until it is so far."""
    start: list[float] = []

    def hand(site: Site) -> None:
        body = site.blocks[block]
        x = float(site.free_body_state(body)[0][0])
        if not start:
            start.append(x)
        site.data.xfrc_applied[body.body, 0] = _PUSH_N if x < start[0] + by_m else 0.0

    return hand


def pushed(block: int, by_m: float) -> Callable[..., Executor]:
    """Return what makes executors in whose worlds a block is pushed."""

    def make(*args, **options) -> Executor:
        executor = Executor(*args, **options)
        executor.observers.append(push(block, by_m))
        return executor

    return make
