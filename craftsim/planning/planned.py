"""A plan as it is handed out, and what of it decides how long it takes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Schedule, make_schedule
from craftsim.planning.goals import BuildingGoal
from craftsim.planning.objective import Objective

Ticks = tuple[tuple[tuple[int, Action], ...], ...]

EQUAL: Final = 1e-9
"""Seconds by which equal times may differ."""


@dataclass(frozen=True)
class Planned:
    """A plan, legal under the rules in the order of its actions.

    Example:
        >>> import craftsim, numpy as np
        >>> task = craftsim.make_task("strip")
        >>> planned = craftsim.plan(task.draw(np.random.default_rng(0)), task, rounds=1)
        >>> planned.makespan_s < planned.work_s
        True
    """

    ticks: Ticks
    """For each tick the (car, action) pairs in acting order."""
    schedule: Schedule
    """Which action waits for which."""
    makespan_s: float
    """When the last action ends, by the table of durations, if each waits only for those that it needs."""
    work_s: float
    """The sum of the durations of all actions."""
    bound_s: float
    """No plan has a smaller makespan; 0 where that is not known."""
    rounds: int
    """How many attempts were made."""
    optimal: bool = False
    """Whether it is proved that no plan is better, by the objective that was asked for."""

    def cost(self, objective: Objective) -> tuple[float, float]:
        """Return what is to be small, the objective first."""
        both = self.makespan_s, self.work_s
        return both if objective == "makespan" else both[::-1]


def judge(
    start: Grid,
    ticks: Ticks,
    goal: BuildingGoal,
    rules: Rules,
    objective: Objective,
    bound_s: float,
    number: int,
) -> Planned | None:
    """Return a plan with its figures, or None if the rules forbid some of it or it does not reach the goal.

    ``bound_s`` is a makespan that no plan is below; ``number`` says which attempt it was.
    """
    schedule = make_schedule(start, ticks, rules)
    if schedule.forbidden or not goal.reached(schedule.final):
        return None
    times = schedule.times()
    work_s = float((times[:, 1] - times[:, 0]).sum())
    makespan_s = schedule.makespan()
    optimal = objective == "makespan" and makespan_s <= bound_s + EQUAL
    return Planned(ticks, schedule, makespan_s, work_s, bound_s, number, optimal)
