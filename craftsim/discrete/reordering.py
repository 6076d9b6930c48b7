"""The order in which the actions of a plan take least time: conflicting actions of two cars may change places.

A schedule keeps the order of its plan wherever footprints conflict. Its makespan can only fall where two cars wait for
each other on the longest path, so that these conflicts are turned round, one after the other, as long as that helps
(local search, as in job shops). While a plan is executed, what is left of it is re-ordered in the same way with what is
known then (Berndt et al., A Feedback Scheme to Reorder a Multi-Agent Execution Schedule by Persistently Optimizing a
Switchable Action Dependency Graph, 2020).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Schedule, ScheduledAction

HORIZON_S: Final = 5.0
"""While a plan is executed, conflicts are turned that begin so soon: later ones can be turned later."""
_PRIOR_S: Final = 10.0
"""Nominal time of a car's actions by which its own durations weigh as much as the nominal ones."""
_TOGETHER: Final = 10
"""Actions of a car that go before those of another one at most."""

Timed = Sequence[tuple[ScheduledAction, float]]
"""Actions, each with a time in seconds."""


def reordered(
    start: Grid,
    schedule: Schedule,
    durations_s: Mapping[tuple[int, int], float],
    rules: Rules,
    begun: int = 0,
    horizon_s: float = math.inf,
) -> Schedule:
    """Return the best order found of a schedule's steps, given how long each takes; each car keeps its own order.

    The rules allow every action in this order, the order constraints of the plan hold, and the world ends as it does in
    the plan. Where nothing is better, this is the schedule itself.

    ``start`` is the world before the first step, ``durations_s`` are by (tick, car). The first steps, ``begun`` of
    them, keep their places, and conflicts that begin after ``horizon_s`` their order.
    """
    best, tried = schedule, set[tuple[int, ...]]()
    while True:
        seconds = [durations_s[step.tick, step.car] for step in best.steps]
        times, conflicts = best.times(seconds), _conflicts(best)
        shorter_s = times[:, 1].max(initial=0.0) - 1e-9
        for turned in _turned(best, times, begun, horizon_s):
            # The rules take ten times as long, and footprints hardly change with the order.
            if _makespan(turned, conflicts, seconds) >= shorter_s:
                continue
            steps = [best.steps[k] for k in turned]
            cars = tuple(step.car for step in steps)
            if cars in tried or not _in_order(schedule, steps):
                continue
            tried.add(cars)
            if not _ends_in(schedule.final, start, steps, rules):
                continue
            new = best.again(start, steps, rules)
            if new.makespan([seconds[k] for k in turned]) < shorter_s:
                best = new
                break
        else:
            return best


def reordered_rest(start: Grid, left: Schedule, ended: Timed, running: Timed, rules: Rules) -> Schedule:
    """Return the schedule of what has not ended of a plan, in a better order if one is found, else the one in force.

    A car's next actions are assumed to take as much more than their nominal times as its last ones did.

    Args:
        start: the world as the rules predict it from what has ended.
        left: the schedule in force.
        ended: what has ended, with the time that it took.
        running: what runs, with the time since it began; in the new schedule this comes first.
        rules: of the schedule.
    """
    took_s = dict.fromkeys((step.car for step in left.steps), _PRIOR_S)
    nominal_s = took_s.copy()
    for step, seconds in ended:
        if step.car in took_s:
            took_s[step.car] += seconds
            nominal_s[step.car] += step.duration_s
    rest = _rest(left, [step for step, _ in ended], [step for step, _ in running])
    durations_s = {(s.tick, s.car): s.duration_s * took_s[s.car] / nominal_s[s.car] for s in rest.steps}
    for step, since_s in running:
        act = step.tick, step.car
        durations_s[act] = max(durations_s[act] - since_s, 0.0)
    horizon_s = HORIZON_S if ended or running else math.inf
    found = reordered(start, rest, durations_s, rules, len(running), horizon_s)
    return left if found is rest else found


def _rest(left: Schedule, ended: Sequence[ScheduledAction], running: Sequence[ScheduledAction]) -> Schedule:
    """Return a schedule without what has ended; what runs comes first, and waits for nothing."""
    number = {(step.tick, step.car): index for index, step in enumerate(left.steps)}
    gone = {number.get((step.tick, step.car), -1) for step in ended}
    first = [number[step.tick, step.car] for step in running]
    order = [*first, *(k for k in range(len(left.steps)) if k not in gone and k not in first)]
    place = {k: index for index, k in enumerate(order)}
    waits = [frozenset(place[w] for w in left.steps[k].waits_for if w in place) for k in order]
    steps = (replace(left.steps[k], waits_for=waits[index]) for index, k in enumerate(order))
    return replace(left, steps=tuple(steps))


def _ends_in(final: Grid, world: Grid, steps: Iterable[ScheduledAction], rules: Rules) -> bool:
    """Return whether steps are allowed in this order, and end in a world like another one."""
    for step in steps:
        world, applied = rules.tick(world, [(step.car, step.action)])
        if not applied[0]:
            return False
    return world.same_visible(final)


def _conflicts(schedule: Schedule) -> list[list[int]]:
    """Return by step its car's step before it, and the other cars' steps of which one waits for the other."""
    found: list[list[int]] = [[] for _ in schedule.steps]
    last: dict[int, int] = {}
    for index, step in enumerate(schedule.steps):
        if step.car in last:
            found[index].append(last[step.car])
        last[step.car] = index
        for other in step.waits_for:
            if schedule.steps[other].car != step.car:
                found[index].append(other)
                found[other].append(index)
    return found


def _makespan(order: Sequence[int], conflicts: Sequence[Sequence[int]], seconds: Sequence[float]) -> float:
    """Return the makespan in another order as long as footprints stay as they are."""
    ends = [0.0] * len(order)
    for k in order:
        ends[k] = max([ends[other] for other in conflicts[k]], default=0.0) + seconds[k]
    return max(ends, default=0.0)


def _in_order(schedule: Schedule, steps: Sequence[ScheduledAction]) -> bool:
    """Return whether order constraints hold in an order of the steps."""
    place = {(step.tick, step.car): number for number, step in enumerate(steps)}
    pairs = ((act, other) for act, others in schedule.after.items() for other in others)
    return all(place.get(other, -1) < place[act] for act, other in pairs if act in place)


def _turned(
    schedule: Schedule, times: NDArray[np.float64], begun: int, horizon_s: float
) -> Iterator[list[int]]:
    """Yield orders in which a car goes first that another one waits for on the longest path, with what that needs."""
    steps, (starts, ends) = schedule.steps, times.T
    at = int(ends.argmax()) if steps else -1
    while at >= begun and steps[at].waits_for:
        before = max(steps[at].waits_for, key=lambda other: (ends[other], other))
        turns = before >= begun and starts[before] <= horizon_s and steps[before].car != steps[at].car
        own = [k for k in range(at, len(steps)) if steps[k].car == steps[at].car]
        for last in own[:_TOGETHER] if turns else ():
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
