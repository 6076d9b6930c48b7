"""Plans from designs: the best of many attempts, each of which differs in what it decides by chance."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from craftsim.discrete.actions import Action
from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.rules.sets import Rules
from craftsim.discrete.schedule import Schedule, make_schedule
from craftsim.discrete.tasks.task import Task
from craftsim.discrete.timetable import makespan, timetable
from craftsim.errors import InputError
from craftsim.planning.assembly import Assembly, Order, State
from craftsim.planning.bounds import makespan_bound
from craftsim.planning.building import Construction, Style
from craftsim.planning.variation import vary
from craftsim.planning.exact import MOST_WORLDS, is_small, least_work
from craftsim.planning.goals import BuildingGoal, NoPlanError, check_supplies, make_goal, platforms
from craftsim.planning.objective import DEFAULT_ROUNDS, DEFAULT_TIME_S, Objective
from craftsim.planning.ordering import find_order
from craftsim.planning.things import BuildingPart, things_in, without_things

Ticks = tuple[tuple[tuple[int, Action], ...], ...]

_ORDERS: Final = 100
"""So many orders of assembly are kept to choose from."""
_REFINED: Final = 0.4
"""Share of attempts that begin as the best one did."""

_LONGER: Final = 1.1
"""An attempt is given up when it takes so many times the ticks of the best one."""
_EQUAL: Final = 1e-9
"""Seconds by which equal times may differ."""
_FIRST_WORLDS: Final = 20_000
"""Where the makespan counts, the plan of least work is one to begin with if so many worlds are enough for it."""

import os
_WORSE = float(os.environ.get("WORSE", 0.02))
_STALE = int(os.environ.get("STALE", 60))
_REFINED = float(os.environ.get("REFINED", 0.7))


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


def plan_building(
    start: Grid,
    goal: Design | Task | Callable[[Grid], float | bool],
    rules: Rules | None = None,
    *,
    objective: Objective = "makespan",
    rounds: int = DEFAULT_ROUNDS,
    time_s: float = DEFAULT_TIME_S,
    seed: int = 0,
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
    search = _Search(start, wanted, rules, objective, np.random.default_rng(seed))
    return search.run(rounds, time_s, report or (lambda number, best: None))


class _Search:
    """The attempts at one plan."""

    def __init__(
        self, start: Grid, goal: BuildingGoal, rules: Rules, objective: Objective, rng: np.random.Generator
    ) -> None:
        self.start, self.goal, self.rules, self.objective, self.rng = start, goal, rules, objective, rng
        self.assembly = Assembly(without_things(start), rules)
        self.standing = frozenset(
            thing._replace(yaw=thing.yaw if thing.load == Kind.FSLOPE else 0) for thing in things_in(start)
        )
        self.n_slopes = sum(thing.load == Kind.FSLOPE for thing in self.standing) + int(
            (start.cars[:, 4] == Kind.FSLOPE).sum()
        )
        self._buildings = self._goals()
        self._orders: list[tuple[Order, State]] = []
        self._bound = makespan_bound(start, goal.building) if goal.building else 0.0
        self._exact = rules.flags.derived_marks and (
            is_small(start, rules) if goal.building else not goal.platform
        )
        self.best: Planned | None = None
        self._best_ticks = math.inf
        self._current = self._best_made = None
        self._stale = 0
        self._spare = list(things_in(start))

    def run(self, rounds: int, time_s: float, report: Callable[[int, Planned | None], None]) -> Planned:
        """Make attempts until rounds or time have run out."""
        begun = time.monotonic()
        number = 0
        if self._exact:
            guided = bool(self.goal.building) and self.objective == "makespan"
            self._search_worlds(_FIRST_WORLDS if guided else MOST_WORLDS)
            if self.best is not None and (self.best.optimal or self.goal.building is None):
                report(0, self.best)
                return self.best
        try:
            for number in range(1, rounds + 1):
                self._attempt(number)
                report(number, self.best)
                late = time.monotonic() - begun
                if late > time_s and (self.best is not None or late > 6 * time_s):
                    break
                if self.best is not None and self.best.makespan_s <= self._bound + _EQUAL:
                    break
        except KeyboardInterrupt:
            if self.best is None:
                raise
        if self.best is None and self._exact and self.objective == "makespan":
            self._search_worlds(MOST_WORLDS)
        if self.best is None:
            raise NoPlanError(self._why(number))
        return self.best

    def _search_worlds(self, most: int) -> None:
        """Look for the plan of least work among so many worlds; raise NoPlanError where that proves there is none."""
        if self.goal.building is not None:
            check_supplies(self.start, self.goal.building)
        exact = least_work(self.start, self.goal, self.rules, most)
        if exact.steps is not None:
            planned = self._finish(tuple((step,) for step in exact.steps), 0)
            if planned is not None:
                self.best = replace(planned, optimal=planned.optimal or self.objective == "work")
        elif exact.complete:
            raise NoPlanError(f"no plan: none of the {exact.n_worlds} worlds that can be reached will do")
        elif self.goal.building is None:
            raise NoPlanError(
                f"no plan found: the goal has no drawing, and none of the first {exact.n_worlds} worlds that cost "
                "least will do; try a smaller area, fewer cars or a design"
            )

    def _goals(self) -> Iterator[State]:
        """Yield buildings that reach the goal."""
        if self.goal.platform:
            yield from platforms(self.start, self.goal.platform, self.rng)
        while self.goal.building is not None:
            yield self.goal.building

    def _draw_order(self) -> tuple[Order, State] | None:
        """Return an order of assembly and what of it stands, a new one while there are few."""
        n_kept = len(self._orders)
        if n_kept and (n_kept >= _ORDERS or self.rng.random() < 0.5):
            return self._orders[int(self.rng.integers(n_kept))]
        building = next(self._buildings, None)
        if building is None:
            raise NoPlanError(
                "no plan: a goal without a drawing is searched for only by rules whose marks follow from what is there"
            )
        check_supplies(self.start, building)
        fixed = building & self.standing
        for kept in dict.fromkeys([fixed, frozenset[BuildingPart]()]):
            order = find_order(self.assembly, building, kept, self.n_slopes, self.rng)
            if order is not None:
                self._orders.append((order, kept))
                return order, kept
        return None

    def _attempt(self, number: int) -> None:
        rng = self.rng
        # Ticks are not seconds, so an attempt may be a little longer than the best one.
        longest = _LONGER * self._best_ticks if self.objective == "makespan" else math.inf
        if self._current is not None and rng.random() < _REFINED:
            order, fixed, style, turns = self._current[1]
            kept, script = vary([turn for turn, _ in turns], self._spare, self.start.n_cars, rng)
            if rng.random() < 0.3:
                style = self._style(number)
            past = turns[:kept]
        else:
            drawn = self._draw_order()
            if drawn is None:
                return
            order, fixed = drawn
            past, script = [], []
            style = self._style(number)
        building = Construction(
            self.start, self.assembly, order, fixed, style, rng, longest, past, script
        )
        if not building.run():
            self._patience()
            return
        n_ticks = building.n_ticks
        turns = building.turns
        building.crew.timeline.trim(self.goal.reached)
        planned = self._finish(building.crew.timeline.ticks(), number)
        if planned is None:
            self._patience()
            return
        made = order, fixed, style, turns
        cost = planned.cost(self.objective)
        if self._current is None or cost[0] <= self._current[0][0] * (1 + _WORSE * rng.exponential()):
            self._current = cost, made
        if self.best is None or cost < self.best.cost(self.objective):
            if self.best is None or cost[0] < self.best.cost(self.objective)[0] - 1e-6:
                self._stale = 0
            self.best, self._best_made = planned, (cost, made)
            self._best_ticks = n_ticks
        self._patience()

    def _patience(self):
        self._stale += 1
        if self._stale % _STALE == 0:
            self._current = self._best_made

    def _style(self, number: int) -> Style:
        """Return how an attempt is made; the first is straightforward."""
        rng = self.rng
        return Style(
            noise=0.0 if number == 1 else float(rng.choice([0.0, 0.1, 0.3, 0.6])),
            n_cars=int(rng.integers(1, self.start.n_cars + 1)) if self.objective == "work" else 1_000,
            together=self.objective == "makespan",
            early=0.0 if number == 1 else float(rng.choice([0.0, 0.2, 0.6])),
            haste=0.0 if number == 1 else float(rng.choice([0.0, 1.0])),
            hold=number > 1 and bool(rng.random() < 0.6),
        )

    def _finish(self, ticks: Ticks, number: int) -> Planned | None:
        """Leave out what is not needed at the end, and look whether the rules agree."""
        schedule = make_schedule(self.start, ticks, self.rules)
        if schedule.forbidden or not self.goal.reached(schedule.final):
            return None
        times = timetable(schedule)
        work = float((times[:, 1] - times[:, 0]).sum())
        lasting = makespan(times)
        optimal = self.objective == "makespan" and lasting <= self._bound + _EQUAL
        return Planned(ticks, schedule, lasting, work, self._bound, number, optimal)

    def _why(self, rounds: int) -> str:
        if not self._orders:
            return (
                "no plan found: no order in which everything can be put to its place; perhaps some place cannot be "
                "reached by a car with its load, whatever is built first; try more slopes, or more free floor around"
            )
        return (
            f"no plan found in {rounds} attempts, though there is an order to build in: things cannot be reached, or "
            "cars have no room to get by; try fewer cars, a larger area or another seed"
        )


plan = plan_building
"""Its public name."""
