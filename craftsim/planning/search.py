"""The search for a plan: attempts from nothing, and from the best of them on neighbours of what there is."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from craftsim.discrete.grid import Grid, Kind, Piece
from craftsim.discrete.kinds import Correction
from craftsim.discrete.rules import Rules
from craftsim.planning.assembly import Assembly, Order, State
from craftsim.planning.bounds import makespan_bound
from craftsim.planning.building import Construction, Style, Turn
from craftsim.planning.exact import MOST_WORLDS, is_small, least_work
from craftsim.planning.goals import BuildingGoal, NoPlanError, check_supplies, platforms
from craftsim.planning.joint_plan import Saved
from craftsim.planning.objective import Objective
from craftsim.planning.ordering import find_order
from craftsim.planning.planned import EQUAL, Planned, Ticks, judge
from craftsim.planning.things import without_things
from craftsim.planning.variation import vary

_ORDERS: Final = 100
"""So many orders of assembly are kept to choose from."""
_FRESH: Final = 8
"""So many attempts are made anew before the search goes on from the best of them."""
_ANEW: Final = 0.4
"""Where it is open what is to be built, such attempts go on so often between neighbours: each may build another."""
_PATIENCE: Final = 25
"""After so many neighbours none of which is better the search goes on elsewhere..."""
_BACK: Final = 0.5
"""...so often from the best plan, else from attempts made anew."""
_WORSE: Final = 0.02
"""By about this share a neighbour may be worse for the search to go on from it."""
_RESTYLED: Final = 0.3
"""So often a neighbour is made in another style."""
_LONGER: Final = 1.1
"""An attempt is given up when it takes so many times the ticks of its neighbour..."""
_LONGER_FRESH: Final = 1.3
"""...or, made anew, of the best one. Ticks are not seconds, so it may be a little longer."""
_FIRST_WORLDS: Final = 20_000
"""Where the makespan counts, the plan of least work is one to begin with if so many worlds are enough for it."""


@dataclass(frozen=True)
class Approach:
    """What decides an attempt, beside chance."""

    order: Order
    fixed: State
    style: Style


@dataclass(frozen=True)
class Made:
    """What has come of an attempt."""

    approach: Approach
    turns: tuple[tuple[Turn, Saved], ...]
    n_ticks: int
    planned: Planned

    @cached_property
    def critical(self) -> list[int]:
        """Return the turns on which the makespan depends."""
        acts = self.planned.schedule.critical()
        found, since = [], [0] * self.planned.schedule.final.n_cars
        for i, (turn, (_, ready)) in enumerate(self.turns):
            if any(car == turn.car and since[car] <= tick < ready[car] for tick, car in acts):
                found.append(i)
            since = list(ready)
        return found


class PlanSearch:
    """The attempts at one plan."""

    def __init__(
        self,
        start: Grid,
        goal: BuildingGoal,
        rules: Rules,
        objective: Objective,
        rng: np.random.Generator,
        exact: bool = True,
    ) -> None:
        self.start, self.goal, self.rules, self.objective, self.rng = start, goal, rules, objective, rng
        self.assembly = Assembly(without_things(start), rules)
        self.standing = frozenset(
            thing._replace(yaw=thing.yaw if thing.load == Kind.FSLOPE else 0) for thing in start.pieces()
        )
        self.n_slopes = sum(thing.load == Kind.FSLOPE for thing in self.standing) + int(
            (start.cars[:, 4] == Kind.FSLOPE).sum()
        )
        self._buildings = self._goals()
        self._orders: list[tuple[Order, State]] = []
        self._bound = makespan_bound(start, goal.building) if goal.building else 0.0
        self._exact = Correction.derived_marks in rules.corrections and (
            exact and is_small(start, rules) if goal.building else not goal.platform
        )
        self.best: Planned | None = None
        self._best: Made | None = None
        self._here: Made | None = None
        self._candidate: Made | None = None
        self._things = tuple(start.pieces())
        self._n_fresh, self._n_stale, self._lowest = _FRESH, 0, math.inf

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
                if self.best is not None and self.best.makespan_s <= self._bound + EQUAL:
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
            planned = self._judge(tuple((step,) for step in exact.steps), 0)
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
        for kept in dict.fromkeys([fixed, frozenset[Piece]()]):
            order = find_order(self.assembly, building, kept, self.n_slopes, self.rng)
            if order is not None:
                self._orders.append((order, kept))
                return order, kept
        return None

    def _attempt(self, number: int) -> None:
        """Make an attempt, anew or close to what the search stands at, and look what has come of it."""
        here = None if self._n_fresh else self._here
        anew = here is None or (bool(self.goal.platform) and self.rng.random() < _ANEW)
        made = self._fresh(number) if anew or here is None else self._neighbour(here, number)
        if made is not None and self._cost(made) < self._cost(self._best):
            self._best = made
            if self.best is None or self._cost(made) < self.best.cost(self.objective):
                self.best = made.planned
        if here is None:
            self._chosen(made)
        else:
            self._walked(made)

    def _fresh(self, number: int) -> Made | None:
        drawn = self._draw_order()
        if drawn is None:
            return None
        longer = _LONGER_FRESH if self._n_fresh else _LONGER
        most = math.inf if self._best is None else longer * self._best.n_ticks
        return self._build(Approach(*drawn, self._style(number)), number, most, (), ())

    def _neighbour(self, here: Made, number: int) -> Made | None:
        approach = here.approach
        if self.rng.random() < _RESTYLED:
            approach = replace(approach, style=self._style(number))
        turns = [turn for turn, _ in here.turns]
        critical = here.critical if self.objective == "makespan" else ()
        n_kept, others = vary(turns, critical, self._things, self.start.n_cars, self.rng)
        return self._build(approach, number, _LONGER * here.n_ticks, here.turns[:n_kept], others)

    def _build(
        self,
        approach: Approach,
        number: int,
        most: float,
        past: Sequence[tuple[Turn, Saved]],
        script: Sequence[Turn | None],
    ) -> Made | None:
        last_tick = most if self.objective == "makespan" else math.inf
        building = Construction(
            *(self.start, self.assembly, approach.order, approach.fixed, approach.style, self.rng),
            *(last_tick, past, script),
        )
        if not building.run():
            return None
        n_ticks, timeline = building.n_ticks, building.plan.timeline
        timeline.trim(self.goal.reached)
        planned = self._judge(timeline.ticks(), number)
        return None if planned is None else Made(approach, tuple(building.turns), n_ticks, planned)

    def _judge(self, ticks: Ticks, number: int) -> Planned | None:
        return judge(self.start, ticks, self.goal, self.rules, self.objective, self._bound, number)

    def _cost(self, made: Made | None) -> tuple[float, float]:
        return (math.inf, math.inf) if made is None else made.planned.cost(self.objective)

    def _chosen(self, made: Made | None) -> None:
        """Go on from the best of some fresh attempts."""
        if self._cost(made) < self._cost(self._candidate):
            self._candidate = made
        self._n_fresh = max(0, self._n_fresh - 1)
        if not self._n_fresh:
            self._here = self._candidate or self._best
            self._candidate = None
            self._n_stale, self._lowest = 0, self._cost(self._here)[0]

    def _walked(self, made: Made | None) -> None:
        """Go on from a neighbour that is about as good; after many in vain from the best plan, or from elsewhere."""
        cost = self._cost(made)[0]
        if cost <= self._lowest * (1 + _WORSE * self.rng.exponential()):
            self._here = made
        self._n_stale += 1
        if cost < self._lowest - EQUAL:
            self._n_stale, self._lowest = 0, cost
        if self._n_stale >= _PATIENCE:
            if self.goal.platform or self.rng.random() < _BACK:
                self._here = self._best
                self._n_stale, self._lowest = 0, self._cost(self._here)[0]
            else:
                self._n_fresh = _FRESH

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
