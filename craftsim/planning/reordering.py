"""The order in which the actions of a plan take least time: conflicting actions of two cars may change places.

A schedule keeps the order of its plan wherever footprints conflict. Its makespan can only fall where two cars wait for
each other on the longest path, so that these conflicts are turned round, one after the other, as long as that helps
(local search, as in job shops; of schedules of cars: Berndt et al., A Feedback Scheme to Reorder a Multi-Agent
Execution Schedule by Persistently Optimizing a Switchable Action Dependency Graph, 2020).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Schedule, make_schedule

_TOGETHER: Final = 10
"""Actions of a car that go before those of another one at most."""


def reordered(start: Grid, schedule: Schedule, durations_s: Sequence[float], rules: Rules) -> list[int]:
    """Return the best order found of a schedule's steps, given how long each takes; each car keeps its own order.

    The rules allow every action in this order, and the world ends as it does in the plan.
    """
    order, here = [*range(len(schedule.steps))], schedule
    ends = here.times(durations_s)[:, 1]
    tried: set[tuple[int, ...]] = set()
    while True:
        for turned in _turned(here, ends):
            cars = tuple(here.steps[k].car for k in turned)
            if cars in tried:
                continue
            tried.add(cars)
            new, new_order = make_schedule(start, here.acting(turned), rules), [order[k] for k in turned]
            if new.forbidden or not new.final.same_visible(schedule.final):
                continue
            new_ends = new.times([durations_s[k] for k in new_order])[:, 1]
            if new_ends.max() < ends.max() - 1e-9:
                order, here, ends = new_order, new, new_ends
                break
        else:
            return order


def _turned(schedule: Schedule, ends: np.ndarray) -> Iterator[list[int]]:
    """Yield orders in which a car goes first that another one waits for on the longest path, with what that needs."""
    steps = schedule.steps
    at = int(ends.argmax()) if steps else -1
    while at >= 0 and steps[at].waits_for:
        before = max(steps[at].waits_for, key=lambda other: (ends[other], other))
        own = [k for k in range(at, len(steps)) if steps[k].car == steps[at].car]
        for last in own[:_TOGETHER] if steps[before].car != steps[at].car else ():
            needed, rest = set[int](), [last]
            while rest:
                k = rest.pop()
                if k > before and k not in needed and steps[k].car != steps[before].car:
                    needed.add(k)
                    rest += steps[k].waits_for
            yield [
                *range(before),
                *sorted(needed),
                *(k for k in range(before, len(steps)) if k not in needed),
            ]
        at = before
