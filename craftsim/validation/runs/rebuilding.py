"""Building with re-planning: plan, act in physics, read the world from poses, and plan again from what is there."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.episode import Episode, OnAttempts, Recipe, Step, Watch, do
from craftsim.checking.judge import Judge
from craftsim.checking.setup import Seed, SetUp, Setup
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Schedule, make_schedule
from craftsim.discrete.tasks import Task
from craftsim.planning import NoPlanError, Planned, plan_building
from craftsim.skills.disturbances import Disturbance, DisturbedFleet
from craftsim.skills.executor import Observer
from craftsim.storage.limits import RECIPE_ACTIONS, STEP_ACTIONS
from craftsim.validation.runs.obstacles import Without, stuck_with

Disturb = Literal["shove", "fold", "dead-car"]
Ticks = Sequence[Sequence[tuple[int, Action]]]

BEGINS: Final = 0.1, 0.6
"""A disturbance begins after a share of the first plan's makespan that is drawn between these."""
FAILURES: Final = 2
"""So many actions in a row must fail before a car counts as out of action; one, where it then stands between cells."""


@dataclass(frozen=True)
class Rebuilding:
    """How often, and how thoroughly, is planned, and what goes wrong on purpose."""

    replans: int = 10
    """Plans after the first one, at most."""
    rounds: int = 60
    """Attempts at each plan."""
    disturb: Disturb | None = None


def rebuild(
    task: Task,
    grid: Grid,
    seeds: tuple[Seed, int],
    setup: Setup,
    asked: Rebuilding,
    watch: Watch,
    where: SetUp,
    observers: Sequence[Observer] = (),
) -> Episode:
    """Build in physics what a task asks for, and return the episode with its ending.

    Args:
        task: has a goal.
        grid: the start.
        seeds: of the physics, and of the plans and what is drawn of a disturbance.
        setup: configuration of the physics; the disturbance is put into it here.
        asked: how often is planned, and what goes wrong.
        watch: who looks on.
        where: sets up the world.
        observers: called with the PhysicsWorld after every control period.

    Raises NoPlanError where there is no plan from the start.
    """
    first = _plan(grid, task, Rules(setup.rules), asked.rounds, seeds[1])
    rng = np.random.default_rng(seeds[1])
    begin_s = float(rng.uniform(*BEGINS)) * first.makespan_s
    if asked.disturb in ("shove", "dead-car"):
        setup = replace(setup, disturbance=Disturbance(asked.disturb, begin_s))
    recipe = Recipe(blueprint_text(grid), (), setup, seeds[0], tuple(task.goal_cells))
    judge = where(grid, setup, seeds[0], recipe.goals)
    judge.executor.observers.extend(observers)
    work = _Work(task, judge, recipe, asked, watch(judge), seeds[1])
    ended, why = work.run(first)
    fleet = judge.executor.fleet
    disturbed = fleet.happened if isinstance(fleet, DisturbedFleet) else work.folded
    ending: dict[str, str | float] = {
        "ended": ended,
        "why": why,
        "replans": work.replans,
        "planned_s": first.makespan_s,
        "disturbed": disturbed,
    }
    return Episode(
        *(work.recipe, tuple(work.found), ended == "built", True),
        *(judge.physics.time_s, judge.problems, ending),
    )


def _plan(grid: Grid, task: Task, rules: Rules, rounds: int, seed: int) -> Planned:
    """Return a plan that nothing but its arguments decides."""
    return plan_building(grid, task, rules, rounds=rounds, time_s=math.inf, seed=seed)


@dataclass
class _Work:
    """A building under way."""

    task: Task
    judge: Judge
    recipe: Recipe
    asked: Rebuilding
    on_attempts: OnAttempts
    seed: int
    found: list[tuple[Attempt, ...]] = field(default_factory=list)
    replans: int = 0
    folded: str = ""
    """Which slope was folded again on purpose, in words."""
    out: set[int] = field(default_factory=set)
    """Cars out of action."""
    failures: dict[int, int] = field(default_factory=dict)
    """By car, how many of its actions have failed since one succeeded."""
    n_ticks: int = 0

    def run(self, first: Planned) -> tuple[str, str]:
        """Carry out the first plan, and others after it; return how that ended, and why."""
        ticks: Ticks = first.ticks
        while True:
            if problem := self._carry_out(ticks):
                return "not readable", problem
            if self.task.succeeded(self.judge.grid):
                return "built", ""
            if self.replans >= self.asked.replans:
                return "gave up", f"not built after {self.replans} further plans"
            self.replans += 1
            seen = Without.of(self.judge, self.task, self.out)
            try:
                planned = _plan(
                    *(seen.grid, self.task, self.judge.rules, self.asked.rounds, self.seed + self.replans)
                )
            except NoPlanError as error:
                return "gave up", str(error)
            ticks = seen.in_real_numbers(planned.ticks)
            n_acts = sum(len(step.acts) for step in self.recipe.steps) + sum(map(len, ticks))
            if n_acts > RECIPE_ACTIONS:
                return "gave up", f"more than {RECIPE_ACTIONS} actions"

    def _carry_out(self, ticks: Ticks) -> str:
        """Do a plan, as much of it as can be done; return why the world cannot be read any more, or nothing."""
        while ticks:
            now, ticks = _parted(ticks, self.asked.disturb == "fold" and not self.folded)
            schedule = make_schedule(self.judge.grid, now, self.judge.rules)
            if schedule.forbidden:
                return ""
            if not self._do(now, schedule):
                return self._problem()
            if self.asked.disturb == "fold" and not self.folded:
                self._fold()
        return self._problem()

    def _do(self, ticks: Ticks, schedule: Schedule) -> bool:
        """Do some ticks; return whether the world reads as they should leave it."""
        step = Step.joint(self.n_ticks, *ticks, order="until-wrong")
        self.recipe = self.recipe.then(step)
        self.found.append(do(self.judge, step))
        self.n_ticks += len(ticks)
        for attempt in self.found[-1]:
            if attempt.performed:
                failed = attempt.skill != "succeeded"
                self.failures[attempt.car] = self.failures.get(attempt.car, 0) + 1 if failed else 0
        self.on_attempts(self.found[-1])
        return not self._problem() and self.judge.grid.same_visible(schedule.final)

    def _problem(self) -> str:
        """Find out which cars are out of action, and return what else cannot be read."""
        self.out |= {car for car, n in self.failures.items() if n >= FAILURES}
        for car, n in self.failures.items():
            if n and any(text.startswith(tuple(_words([car], self.judge))) for text in self.judge.problems):
                self.out.add(car)
        excused = tuple(_words(self.out, self.judge))
        return "; ".join(text for text in self.judge.problems if not text.startswith(excused))

    def _fold(self) -> None:
        """Let a car fold a slope that was just unfolded, which is in no plan."""
        grid, rules = self.judge.grid, self.judge.rules
        for car in range(grid.n_cars):
            if rules.legal(grid, car, Action.FOLD):
                ticks = [[(car, Action.FOLD)]]
                self.folded = f"car {car} folds a slope again at {self.judge.physics.time_s:.2f} s"
                self._do(ticks, make_schedule(grid, ticks, rules))
                return


def _words(cars: Iterable[int], judge: Judge) -> Iterator[str]:
    """Yield how problems begin that concern cars, or what is stuck with them."""
    return (f"{name} " for name in stuck_with(judge, cars))


def _parted(ticks: Ticks, after_unfolding: bool) -> tuple[Ticks, Ticks]:
    """Return what is done next of a plan, and the rest: up to a tick that unfolds, and as much as a step may hold."""
    n_acts = 0
    for number, joint in enumerate(ticks, 1):
        n_acts += len(joint)
        unfolds = any(action is Action.UNFOLD for _, action in joint)
        following = len(ticks[number]) if number < len(ticks) else 0
        if (after_unfolding and unfolds) or n_acts + following > STEP_ACTIONS:
            return ticks[:number], ticks[number:]
    return ticks, ()
