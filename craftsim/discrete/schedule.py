"""Which action of a plan must wait for which: the action dependency graph.

The rules let cars act one after the other. Real cars act at the same time, so each action waits for exactly those
earlier ones whose footprints conflict with its own, and for its own car; everything else may run in parallel, and the
world ends as it does one after the other (Hoenig et al., Persistent and Robust Execution of MAPF Schedules in
Warehouses, RA-L 2019).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from craftsim.discrete.actions import footprint
from craftsim.discrete.footprint import Footprint
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.terrain import inclines_of, is_tight

Order = Literal["sequential", "concurrent", "until-wrong", "at-once"]
"""How the actions of a plan follow each other: one by one; as early as the dependencies allow; the same until something
is not as predicted, after which nothing begins any more; or, to see what goes wrong, all of a tick together and tick
after tick."""

Constraints = Mapping[tuple[int, int], Collection[tuple[int, int]]]
"""Order constraints of a plan: after which earlier actions of other cars an action starts, each a (tick, car)."""


@dataclass(frozen=True)
class ScheduledAction:
    """One action of a schedule."""

    tick: int
    car: int
    action: Action
    before: Grid
    """The predicted world when its turn comes in the order of the plan."""
    after: Grid
    """The predicted world right after it."""
    footprint: Footprint = field(default_factory=Footprint)
    waits_for: frozenset[int] = frozenset()
    """Indices of the earlier steps that must have ended."""

    @property
    def inclines(self) -> tuple[float, float]:
        """How far the ground raises the car's nose at the start and at the end of the step, in radians."""
        return inclines_of(self.before, self.after, self.car)

    @property
    def tight(self) -> bool:
        """Whether the way of the step leads under something, or takes a load past something."""
        return is_tight(self.before, self.after, self.car)


@dataclass(frozen=True)
class Schedule:
    """The legal actions of a plan with their dependencies, and those that the rules forbid when their turn comes."""

    steps: tuple[ScheduledAction, ...]
    forbidden: tuple[ScheduledAction, ...]
    """What is left out; it changes nothing."""
    final: Grid
    """The predicted world at the end."""
    acts: tuple[tuple[int, int], ...] = ()
    """(tick, car) of all actions in the order of the plan."""

    def constraints(self) -> Constraints:
        """Return the fewest order constraints from which all of ``waits_for`` follow.

        That a car waits for itself is not said, nor what follows from other constraints (transitive reduction).
        """
        found = {}
        reached: list[int] = []  # for each step a bit set: itself, and all that must have ended before it
        latest: dict[int, int] = {}
        for index, step in enumerate(self.steps):
            known = latest.get(step.car, 0)
            needed = []
            for other in sorted(step.waits_for, reverse=True):
                if not known >> other & 1:
                    needed.append((self.steps[other].tick, self.steps[other].car))
                    known |= reached[other]
            if needed:
                found[step.tick, step.car] = tuple(reversed(needed))
            reached.append(known | 1 << index)
            latest[step.car] = reached[index]
        return found


def make_schedule(
    grid: Grid,
    ticks: Iterable[Sequence[tuple[int, Action]]],
    rules: Rules,
    order: Order = "concurrent",
    first: int = 0,
    after: Constraints | None = None,
) -> Schedule:
    """Return the schedule of a plan's ticks, each a sequence of (car, action) in acting order, from a world.

    Args:
        grid: the world at the start.
        ticks: of the plan.
        rules: say what each action does.
        order: how the actions follow each other.
        first: number of the first tick.
        after: order constraints of the plan. They come on top of what actions wait for anyway; one that names what the
            rules forbid constrains nothing, because that is left out.
    """
    steps: list[ScheduledAction] = []
    place: dict[tuple[int, int], int] = {}
    forbidden = []
    acts = []
    for tick, joint in enumerate(ticks, first):
        for car, action in joint:
            acts.append((tick, car))
            then, applied = rules.tick(grid, [(car, action)])
            if not applied[0]:
                forbidden.append(ScheduledAction(tick, car, action, grid, grid))
                continue
            needs = footprint(grid, then, car, action)
            asked = {place[act] for act in (after or {}).get((tick, car), ()) if act in place}
            waits = frozenset(_predecessors(steps, tick, car, needs, order)) | asked
            place[tick, car] = len(steps)
            steps.append(ScheduledAction(tick, car, action, grid, then, needs, waits))
            grid = then
    return Schedule(tuple(steps), tuple(forbidden), grid, tuple(acts))


def _predecessors(
    steps: list[ScheduledAction], tick: int, car: int, needs: Footprint, order: Order
) -> Iterable[int]:
    match order:
        case "sequential":
            return range(len(steps) - 1, len(steps)) if steps else ()
        case "at-once":
            return (i for i, step in enumerate(steps) if step.tick < tick)
        case "concurrent" | "until-wrong":
            return (i for i, s in enumerate(steps) if s.car == car or s.footprint.conflicts(needs))
