"""The search for a plan: attempts from nothing, and from the best of them on neighbours of what there is."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Final

import numpy as np

from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Grid, Kind, Piece
from craftsim.discrete.kinds import NAMES, Correction, PlanTick
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Schedule, make_schedule
from craftsim.errors import InputError
from craftsim.planning.assembly import Assembly, Order, Placing, State, loads_of, without_things
from craftsim.planning.building import Construction, Style
from craftsim.planning.exact import MOST_WORLDS, is_small, least_work
from craftsim.planning.joint_plan import Saved, Turn
from craftsim.planning.planned import (
    BuildingGoal,
    NoPlanError,
    Planned,
    check_supplies,
    make_goal,
    makespan_bound,
    platforms,
)
from craftsim.planning.search import BETTER_PLAN_S, DEFAULT_ROUNDS, FIRST_PLAN_S, Objective
from craftsim.tasks.task import Task

_EQUAL_S: Final = 1e-9
"""Tolerance for equal times."""
_ORDERS: Final = 100
"""Number of orders of assembly that are kept to choose from."""
_DRAWN: Final = 8
"""Number of platforms that are drawn for one order; all but the last use what stands in them as it is."""
_FRESH: Final = 8
"""Number of attempts from scratch before the search continues from the best of them."""
_ANEW: Final = 0.4
"""Probability of an attempt from scratch between neighbours where the goal leaves open what is built."""
_PATIENCE: Final = 25
"""Number of neighbours without improvement after which the search continues elsewhere."""
_BACK: Final = 0.5
"""Probability that it continues from the best plan; otherwise from attempts from scratch."""
_WORSE: Final = 0.02
"""Mean relative increase of the cost at which a neighbour is accepted."""
_RESTYLED: Final = 0.3
"""Probability that a neighbour is made in another style."""
_LONGER: Final = 1.1
"""Limit of an attempt's ticks, relative to those of its neighbour."""
_LONGER_FRESH: Final = 1.3
"""The same for the first attempts from scratch, relative to the best plan."""
_FOR_LAST_SEARCH: Final = 1 / 6
"""Share of the time that is kept for a last search of a small world while there is no plan."""
_FIRST_WORLDS: Final = 20_000
"""Limit of the search for a plan of least work where the makespan is minimized."""

_CUT: Final = 0.25
"""Probability that all of a neighbour is decided anew from some turn on."""
_CRITICAL: Final = 0.7
"""Probability that a turn changes on which the makespan depends."""
_ONE: Final = 0.7
"""Probability that no further change follows a change."""
_CHANGES: Final = 8
"""Largest number of changes."""

Turns = list[Turn | None]
"""Turns to be tried one after the other; None: whatever seems best then."""


def plan_building(
    start: Grid,
    goal: Design | Task | Callable[[Grid], float | bool],
    rules: Rules | None = None,
    *,
    objective: Objective = "makespan",
    rounds: int = DEFAULT_ROUNDS,
    time_s: float | None = None,
    seed: int = 0,
    exact: bool = True,
    report: Callable[[int, Planned | None], object] | None = None,
) -> Planned:
    """Return a plan that builds a design from a start, the best of many attempts.

    Args:
        start: any world that the rules know; cars may carry something.
        goal: a design, a task with a goal, or a function of a world.
        rules: ``physical`` unless others are given.
        objective: what is to be small, the time until all is done or the sum of all actions' durations.
        rounds: attempts; with the same seed and rounds the plan is the same unless time runs out.
        time_s: limit in seconds of the whole search; it ends within about a second of that. Unless given, a first plan
            is searched for in up to 60 s, and improved until 10 s have passed.
        seed: of all that is decided by chance.
        exact: search a small world for a plan of least work, too, which takes longer than a few attempts, and any world
            for that of a single flag where attempts find none; a goal without a building is always searched for so.
        report: called after each attempt with its number and the best plan so far; attempts end where it returns True.

    Raises NoPlanError, which names the first object that could not be placed, and what was tried.

    Example:
        >>> import craftsim, numpy as np
        >>> task = craftsim.make_task("strip")
        >>> planned = craftsim.plan(task.draw(np.random.default_rng(0)), task, rounds=5)
        >>> craftsim.write_plan(planned.ticks, folder / "strip.plan", planned.schedule)
    """
    start_s = time.monotonic()
    rules = rules or Rules("physical")
    building_goal = make_goal(goal)
    if building_goal.reached(start):
        return Planned((), Schedule((), (), start), 0.0, 0.0, 0.0, 0, optimal=True)
    if not start.n_cars:
        raise NoPlanError("no plan: there are no cars")
    if objective not in ("makespan", "work"):
        raise InputError(f"unknown objective '{objective}'; there are makespan and work")
    if time_s is None:
        times = _Times(start_s, start_s + FIRST_PLAN_S, start_s + BETTER_PLAN_S)
    else:
        times = _Times(start_s, start_s + time_s, start_s + time_s)
    search = _Search(
        start, building_goal, rules, objective, np.random.default_rng(seed), exact, times
    )
    return search.run(rounds, report or (lambda number, best: None))


plan = plan_building
"""Its public name."""


@dataclass(frozen=True)
class _Times:
    """Monotonic times of a search."""

    start: float
    first: float
    """End of a search that has no plan."""
    better: float
    """End of a search that has a plan."""


@dataclass(frozen=True)
class _Solution:
    """The plan of an attempt, and how it was made."""

    approach: tuple[Order, State, Style]
    """The order of assembly, the things of the building that stood already, and the style."""
    turns: tuple[tuple[Turn, Saved], ...]
    planned: Planned

    @property
    def n_ticks(self) -> int:
        """Number of ticks that its turns take."""
        _, (_, ready) = self.turns[-1]
        return max(ready)

    @cached_property
    def critical(self) -> list[int]:
        """The turns on which the makespan depends."""
        acts = self.planned.schedule.critical()
        critical = []
        since = [0] * self.planned.schedule.final.n_cars
        for i, (turn, (_, ready)) in enumerate(self.turns):
            for tick, car in acts:
                if car == turn.car and since[car] <= tick < ready[car]:
                    critical.append(i)
                    break
            since = list(ready)
        return critical


class _Search:
    def __init__(
        self,
        start: Grid,
        goal: BuildingGoal,
        rules: Rules,
        objective: Objective,
        rng: np.random.Generator,
        exact: bool,
        times: _Times,
    ) -> None:
        self.start = start
        self.goal = goal
        self.rules = rules
        self.objective = objective
        self.rng = rng
        self.times = times
        self.assembly = Assembly(without_things(start), rules)
        self._things = tuple(start.pieces())
        standing = []
        for piece in self._things:
            if piece.load != Kind.FSLOPE:
                piece = piece._replace(yaw=0)
            standing.append(piece)
        self._standing = frozenset(standing)
        self._n_slopes = loads_of(start)[Kind.FSLOPE]
        self._buildings = self._goals()
        self._orders: list[tuple[Order, State]] = []
        if goal.building:
            self._bound = makespan_bound(start, goal.building)
        else:
            self._bound = 0.0
        if goal.building:
            self._exact = exact and is_small(start, rules)
        else:
            self._exact = not goal.platform and Correction.derived_marks in rules.corrections
        # Of one flag, a search among whole worlds also finds what attempts do not: a way that must be made first.
        is_flag = {piece.load for piece in goal.building or ()} == {Kind.FLAG}
        marks_follow = Correction.derived_marks in rules.corrections
        self._searches_last = self._exact or (exact and is_flag and marks_follow)
        self.best: Planned | None = None
        self._best: _Solution | None = None
        self._current: _Solution | None = None
        self._candidate: _Solution | None = None
        self._n_fresh = _FRESH
        self._n_stale = 0
        self._lowest = math.inf
        self._nearest: tuple[int, int, Piece] | None = None
        """The attempt that has come furthest: the steps that were left, all steps, and the first thing left."""

    def run(self, rounds: int, report: Callable[[int, Planned | None], object]) -> Planned:
        """Make attempts until rounds or time have run out."""
        times = self.times
        number = 0
        attempts_until = times.first
        if self._searches_last and self.objective == "makespan":
            attempts_until -= (times.first - times.start) * _FOR_LAST_SEARCH
        if self._exact:
            most_worlds = MOST_WORLDS
            if self.goal.building and self.objective == "makespan":
                most_worlds = _FIRST_WORLDS
            self._search_worlds(most_worlds)
            if self.best is not None and (self.best.optimal or self.goal.building is None):
                report(0, self.best)
                return self.best
        try:
            for number in range(1, rounds + 1):
                if self.best is None:
                    self.assembly.until_s = attempts_until
                else:
                    self.assembly.until_s = times.better
                self.assembly.check_time()
                self._attempt(number)
                if report(number, self.best) is True:
                    break
                if self.best is not None and self.best.makespan_s <= self._bound + _EQUAL_S:
                    break
        except TimeoutError:
            pass
        if self.best is None and self._searches_last and self.objective == "makespan":
            self._search_worlds(MOST_WORLDS)
        if self.best is None:
            raise NoPlanError(self._failure_text(number))
        return self.best

    def _search_worlds(self, most_worlds: int) -> None:
        """Look for the plan of least work among so many worlds.

        Raises NoPlanError where that proves there is none, or nothing else can find one.
        """
        if self.goal.building is not None:
            check_supplies(self.start, self.goal.building)
        ticks, n_worlds, complete = least_work(
            self.start, self.goal, self.rules, most_worlds, self.times.first
        )
        if ticks is not None:
            planned = self._judge(ticks, 0)
            if planned is not None:
                self.best = replace(planned, optimal=planned.optimal or self.objective == "work")
        elif complete:
            raise NoPlanError(f"no plan: none of the {n_worlds} worlds that can be reached will do")
        elif self.goal.building is None:
            raise NoPlanError(
                f"no plan found: the goal has no drawing, and none of the first {n_worlds} worlds that cost "
                "least will do; try a smaller area, fewer cars, more time or a design"
            )

    def _goals(self) -> Iterator[State]:
        if self.goal.platform:
            yield from platforms(self.start, self.goal.platform, self.rng)
        while self.goal.building is not None:
            yield self.goal.building
        raise NoPlanError(
            "no plan: a goal without a drawing is searched for only by rules whose marks follow from what is there"
        )

    def _draw_order(self) -> tuple[Order, State] | None:
        """Return an order of assembly and what of it stands, a new one while there are few."""
        n_kept = len(self._orders)
        if n_kept and (n_kept >= _ORDERS or self.rng.random() < 0.5):
            return self._orders[int(self.rng.integers(n_kept))]
        n = 2
        if self.goal.platform:
            n = _DRAWN
        for i, building in enumerate(islice(self._buildings, n)):
            check_supplies(self.start, building)
            if i < n - 1:
                standing = building & self._standing
            else:
                standing = frozenset[Piece]()
            if standing or i == n - 1:
                order = self.assembly.find_order(building, standing, self._n_slopes, self.rng)
                if order is not None:
                    self._orders.append((order, standing))
                    return order, standing
        return None

    def _attempt(self, number: int) -> None:
        """Make an attempt, anew or close to what the search stands at, and look what has come of it."""
        current = None
        if not self._n_fresh:
            current = self._current
        anew = current is None or (bool(self.goal.platform) and self.rng.random() < _ANEW)
        if anew or current is None:
            solution = self._attempt_afresh(number)
        else:
            turns = [turn for turn, _ in current.turns]
            order, standing, style = current.approach
            if self.rng.random() < _RESTYLED:
                style = self._style(number)
            critical: Sequence[int] = ()
            if self.objective == "makespan":
                critical = current.critical
            n_kept, script = vary(turns, critical, self._things, self.start.n_cars, self.rng)
            max_ticks = _LONGER * current.n_ticks
            solution = self._build(
                (order, standing, style), number, max_ticks, current.turns[:n_kept], script
            )
        if solution is not None and self._cost(solution) < self._cost(self._best):
            self._best = solution
            if self.best is None or self._cost(solution) < self.best.cost(self.objective):
                self.best = solution.planned
        if current is None:
            self._choose_fresh(solution)
        else:
            self._walk_on(solution)

    def _attempt_afresh(self, number: int) -> _Solution | None:
        order = self._draw_order()
        if order is None:
            return None
        if self._n_fresh:
            longer = _LONGER_FRESH
        else:
            longer = _LONGER
        if self._best is None:
            max_ticks = math.inf
        else:
            max_ticks = longer * self._best.n_ticks
        return self._build((*order, self._style(number)), number, max_ticks)

    def _build(
        self,
        approach: tuple[Order, State, Style],
        number: int,
        max_ticks: float,
        past: Sequence[tuple[Turn, Saved]] = (),
        script: Sequence[Turn | None] = (),
    ) -> _Solution | None:
        if self.objective == "makespan":
            last_tick = max_ticks
        else:
            last_tick = math.inf
        building = Construction(
            self.start, self.assembly, *approach, self.rng, last_tick, past, script
        )
        finished = False
        try:
            finished = building.run()
        finally:
            n_left = building.n_left
            if n_left and (self._nearest is None or n_left < self._nearest[0]):
                self._nearest = n_left, len(building.order), building.missing()
        if not finished:
            return None
        building.plan.trim(self.goal.reached)
        planned = self._judge(building.plan.ticks(), number)
        if planned is None:
            return None
        return _Solution(approach, tuple(building.turns), planned)

    def _judge(self, ticks: tuple[PlanTick, ...], number: int) -> Planned | None:
        """Return a plan with its times, or None if the rules forbid some of it or it does not reach the goal."""
        schedule = make_schedule(self.start, ticks, self.rules)
        if schedule.forbidden or not self.goal.reached(schedule.final):
            return None
        times = schedule.times()
        makespan_s = float(times[:, 1].max(initial=0.0))
        work_s = float((times[:, 1] - times[:, 0]).sum())
        optimal = self.objective == "makespan" and makespan_s <= self._bound + _EQUAL_S
        return Planned(ticks, schedule, makespan_s, work_s, self._bound, number, optimal)

    def _cost(self, solution: _Solution | None) -> tuple[float, float]:
        if solution is None:
            return math.inf, math.inf
        return solution.planned.cost(self.objective)

    def _go_on_from(self, solution: _Solution | None) -> None:
        self._current = solution
        self._n_stale = 0
        self._lowest = self._cost(solution)[0]

    def _choose_fresh(self, solution: _Solution | None) -> None:
        """Go on from the best of some fresh attempts."""
        if self._cost(solution) < self._cost(self._candidate):
            self._candidate = solution
        self._n_fresh = max(0, self._n_fresh - 1)
        if not self._n_fresh:
            self._go_on_from(self._candidate or self._best)
            self._candidate = None

    def _walk_on(self, solution: _Solution | None) -> None:
        """Go on from a neighbour that is about as good; after many in vain from the best plan, or from elsewhere."""
        cost = self._cost(solution)[0]
        if cost <= self._lowest * (1 + _WORSE * self.rng.exponential()):
            self._current = solution
        self._n_stale += 1
        if cost < self._lowest - _EQUAL_S:
            self._n_stale = 0
            self._lowest = cost
        if self._n_stale >= _PATIENCE:
            if self.goal.platform or self.rng.random() < _BACK:
                self._go_on_from(self._best)
            else:
                self._n_fresh = _FRESH

    def _style(self, number: int) -> Style:
        """Return how an attempt is made; the first is straightforward."""
        rng = self.rng
        first = number == 1
        return Style(
            noise=0.0 if first else float(rng.choice([0.0, 0.1, 0.3, 0.6])),
            n_cars=int(rng.integers(1, self.start.n_cars + 1))
            if self.objective == "work"
            else 1_000,
            together=self.objective == "makespan",
            early=0.0 if first else float(rng.choice([0.0, 0.2, 0.6])),
            haste=0.0 if first else float(rng.choice([0.0, 1.0])),
            hold=not first and bool(rng.random() < 0.6),
        )

    def _failure_text(self, rounds: int) -> str:
        """Return why there is no plan: what could not be put to its place, and what was tried."""
        late = time.monotonic() > self.assembly.until_s
        if late:
            head = "no plan found in time"
            advice = "a longer time limit"
        else:
            head = "no plan found"
            advice = "another seed"
        attempts = "1 attempt"
        if rounds != 1:
            attempts = f"{rounds} attempts"
        tried = f"{attempts} in {time.monotonic() - self.times.start:.1f} s"
        if self._nearest is not None:
            n_left, n_steps, piece = self._nearest
            reason = "things cannot be reached, or cars have no room to get by"
            if late:
                reason = "the time was over"
            return (
                f"{head}: there is an order to build in, but of its {n_steps} steps no attempt made more than "
                f"{n_steps - n_left}, and {_piece_text(piece)} was not brought there: {reason} ({tried}); "
                f"try {advice}, fewer cars or a larger area"
            )
        missing, obstacle = self._without_order()
        if not missing:
            return f"{head}: the search for an order to build in had not ended after {tried}; try {advice}"
        if len(missing) == 1:
            objects = _piece_text(missing[0])
        else:
            objects = f"{len(missing)} objects, among them {_piece_text(missing[0])}"
        return (
            f"{head}: no order to build in was found for {objects}{obstacle} ({tried}); perhaps a place cannot be "
            f"reached by a car with its load, whatever is built first; try {advice}, more slopes, or more free floor "
            "around"
        )

    def _without_order(self) -> tuple[list[Piece], str]:
        """Return the things that no order was found for, the likeliest culprit first, and why that cannot be put."""
        assembly = self.assembly
        if not assembly.unplaced:
            return [], ""
        assembly.until_s = math.inf
        # What bears nothing comes last in an order: of these the highest could not be put.
        missing = sorted(
            assembly.unplaced,
            key=lambda piece: (piece.kind == Kind.BODY, -piece.cell[2], piece.cell),
        )
        for i, piece in enumerate(missing):
            obstacle = assembly.obstacle(assembly.standing - {piece}, Placing(piece))
            if obstacle:
                return [piece, *missing[:i], *missing[i + 1 :]], f": {obstacle}"
        return missing, ""


def _piece_text(piece: Piece) -> str:
    return f"{NAMES[piece.kind]} at {piece.cell}"


def vary(
    turns: Sequence[Turn],
    critical: Sequence[int],
    pieces: Sequence[Piece],
    n_cars: int,
    rng: np.random.Generator,
) -> tuple[int, Turns]:
    """Return a neighbour of a plan: how many of its turns stay as they are, and those that are tried after them.

    The makespan depends on those that are ``critical``. A thing of the start may be used in place of another.
    """
    if critical and rng.random() < _CRITICAL:
        chosen = critical
    else:
        chosen = range(len(turns))
    i = chosen[int(rng.integers(len(chosen)))]
    if rng.random() < _CUT:
        return i, []
    new: Turns = list(turns)
    for _ in range(_CHANGES):
        _change(new, i, pieces, n_cars, rng)
        if not new or (new != list(turns) and rng.random() < _ONE):
            break
        i = int(rng.integers(len(new)))
    n_kept = 0
    while n_kept < min(len(turns), len(new)) and turns[n_kept] == new[n_kept]:
        n_kept += 1
    return n_kept, new[n_kept:]


def _change(
    turns: Turns, i: int, pieces: Sequence[Piece], n_cars: int, rng: np.random.Generator
) -> None:
    """Change the turn with a number, in place, in one of six ways."""
    kind_of_change = int(rng.integers(6))
    turn = turns[i]
    if kind_of_change == 0 and turn:  # by another car
        turns[i] = turn._replace(car=int(rng.integers(n_cars)))
    elif kind_of_change == 1:  # two cars in each other's place
        j = int(rng.integers(len(turns)))
        if turn:
            other_turn = turns[j]
            if other_turn:
                turns[i] = turn._replace(car=other_turn.car)
                turns[j] = other_turn._replace(car=turn.car)
    elif kind_of_change == 2:  # earlier or later
        turns.insert(int(rng.integers(len(turns))), turns.pop(i))
    elif kind_of_change == 3:  # not at all
        turns.pop(i)
    elif kind_of_change == 4:  # whatever seems best
        turns[i] = None
    elif kind_of_change == 5 and turn and turn.source:  # with another thing of the same kind
        former = turn.source
        alternatives = [piece for piece in pieces if piece.load == former.load and piece != former]
        source = former
        if alternatives:
            source = alternatives[int(rng.integers(len(alternatives)))]
        for k, changed in enumerate(turns):
            if changed and changed.source == source:
                turns[k] = changed._replace(source=former)
        turns[i] = turn._replace(source=source)
