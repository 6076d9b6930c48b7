"""Plans from designs: what a user calls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Schedule
from craftsim.discrete.tasks.task import Task
from craftsim.errors import InputError
from craftsim.planning.goals import NoPlanError, make_goal
from craftsim.planning.objective import DEFAULT_ROUNDS, DEFAULT_TIME_S, Objective
from craftsim.planning.planned import Planned
from craftsim.planning.search import PlanSearch


def plan_building(
    start: Grid,
    goal: Design | Task | Callable[[Grid], float | bool],
    rules: Rules | None = None,
    *,
    objective: Objective = "makespan",
    rounds: int = DEFAULT_ROUNDS,
    time_s: float = DEFAULT_TIME_S,
    seed: int = 0,
    exact: bool = True,
    report: Callable[[int, Planned | None], None] | None = None,
) -> Planned:
    """Return a plan that builds a design from a start, the best of many attempts.

    Args:
        start: any world that the rules know; cars may carry something.
        goal: a design, a task with a goal, or a function of a world.
        rules: ``physical`` unless others are given.
        objective: what is to be small, the time until all is done or the sum of all actions' durations.
        rounds: attempts; with the same seed and rounds the plan is the same unless time runs out.
        time_s: no attempt begins after so many seconds, once there is a plan.
        seed: of all that is decided by chance.
        exact: search a small world for a plan of least work, too, which takes longer than a few attempts; a goal
            without a building is always searched for so.
        report: called after each attempt with its number and the best plan so far; if it raises KeyboardInterrupt
            that plan is returned.

    Raises NoPlanError, which says why.

    Example:
        >>> import craftsim, numpy as np
        >>> task = craftsim.make_task("strip")
        >>> planned = craftsim.plan(task.draw(np.random.default_rng(0)), task, rounds=5)
        >>> craftsim.write_plan(planned.ticks, folder / "strip.plan", planned.schedule)
    """
    rules = rules or Rules("physical")
    wanted = make_goal(goal)
    if wanted.reached(start):
        schedule = Schedule((), (), start)
        return Planned((), schedule, 0.0, 0.0, 0.0, 0, optimal=True)
    if not start.n_cars:
        raise NoPlanError("no plan: there are no cars")
    if objective not in ("makespan", "work"):
        raise InputError(f"unknown objective '{objective}'; there are makespan and work")
    search = PlanSearch(start, wanted, rules, objective, np.random.default_rng(seed), exact)
    return search.run(rounds, time_s, report or (lambda number, best: None))


plan = plan_building
"""Its public name."""
