"""Building with re-planning: plan, act in physics, read the world from poses, and plan again from what is there."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.judge import Judge
from craftsim.checking.recipe import Step
from craftsim.checking.recovery import MOST_SEATED, loads_to_seat
from craftsim.checking.setup import Setup
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import SECOND_PART, CarField, Cell, Grid, Kind, beside
from craftsim.discrete.kinds import Action, TeamAction
from craftsim.discrete.readback import PLACE_TOLERANCE_M
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.planning import NoPlanError, Planned, plan_building
from craftsim.skills.fleet import Disturbance, DisturbedFleet
from craftsim.storage.limits import RECIPE_ACTIONS, STEP_ACTIONS
from craftsim.tasks import Task

Disturb = Literal["shove", "fold", "dead-car", "dead-early"]
BEGINS: Final = 0.1, 0.6
"""Range of the time at which a disturbance begins, as a share of the first plan's makespan."""
FAILURES: Final = 2
"""Failures in a row after which a car is out of action; one is enough if the car then stands between cells."""
_HALF_M: Final = CELL_PITCH_M / 2 - PLACE_TOLERANCE_M
"""Half of the side of the square that a car is assumed to fill: the cell, less the tolerance of reading its place."""


@dataclass(frozen=True)
class Replanning:
    """Numbers of plans and of attempts at each, and the disturbance."""

    replans: int = 10
    """Maximum number of plans after the first one."""
    rounds: int = 60
    """Attempts at each plan."""
    disturb: Disturb | None = None


class Replanner:
    """Decides the steps of one building, whose cars go back after a failure.

    Raises NoPlanError where there is no plan from the start.
    """

    def __init__(
        self, task: Task, grid: Grid, replanning: Replanning, setup: Setup, seed: int
    ) -> None:
        """Make the first plan of a task with a goal; ``seed`` decides the plans and the disturbance."""
        self.task = task
        self.grid = grid
        self.replanning = replanning
        self.setup = replace(setup, recovers=True)
        self.seed = seed
        self.first = self._plan(grid, 0)
        begin_s = float(np.random.default_rng(seed).uniform(*BEGINS)) * self.first.makespan_s
        if replanning.disturb in ("shove", "dead-car"):
            disturbance = Disturbance(replanning.disturb, begin_s)
            self.setup = replace(self.setup, disturbance=disturbance)
        elif replanning.disturb == "dead-early":
            disturbance = Disturbance("dead-car", 0.0, action=2)
            self.setup = replace(self.setup, disturbance=disturbance)
        self.replans = 0
        self.ended: tuple[str, str] = ("", "")
        """How the building ended, and why; empty before."""
        self.folded = ""
        self.out: set[int] = set()
        self.failures: Counter[int] = Counter()
        self.n_ticks = self.n_acts = 0
        self.n_seated = 0
        """Number of loads that sat off their seats, were set down and lifted again."""

    def steps(self, judge: Judge, attempts: Sequence[Sequence[Attempt]]) -> Iterator[Step]:
        """Yield the steps of the first plan, and of others after it; ``attempts`` gets the attempts of each."""
        ticks: Sequence[TeamAction] = self.first.ticks
        while True:
            yield from self._carry_out(ticks, judge, attempts)
            yield from self._seat_loads(judge, attempts)
            problem = self._problem(judge)
            if problem:
                self.ended = "not readable", problem
            elif self.task.succeeded(judge.grid):
                self.ended = "built", ""
            elif self.replans >= self.replanning.replans:
                self.ended = "gave up", f"not built after {self.replans} further plans"
            if self.ended[0]:
                return
            self.replans += 1
            read_grid, acting = without_cars(judge, self.task, self.out)
            try:
                planned = self._plan(read_grid, self.replans)
            except NoPlanError as error:
                self.ended = "gave up", str(error)
                return
            ticks = []
            for team_action in planned.ticks:
                ticks.append([(acting[car], action) for car, action in team_action])
            if self.n_acts + sum(map(len, ticks)) > RECIPE_ACTIONS:
                self.ended = "gave up", f"more than {RECIPE_ACTIONS} actions"
                return

    def end(self, judge: Judge) -> tuple[bool, bool, dict[str, str | float]]:
        """Return whether it is built in physics and by the rules, and what :class:`Episode` says of its ending."""
        fleet = judge.executor.fleet
        ended, reason = self.ended
        ending: dict[str, str | float] = {"ended": ended, "why": reason, "replans": self.replans}
        ending["seated"] = self.n_seated
        ending["planned_s"] = self.first.makespan_s
        if isinstance(fleet, DisturbedFleet):
            ending["disturbed"] = fleet.happened
        else:
            ending["disturbed"] = self.folded
        return ended == "built", True, ending

    def _plan(self, grid: Grid, number: int) -> Planned:
        rules = Rules(self.setup.rules)
        rounds = self.replanning.rounds
        seed = self.seed + number
        return plan_building(grid, self.task, rules, rounds=rounds, time_s=math.inf, seed=seed)

    def _carry_out(
        self, ticks: Sequence[TeamAction], judge: Judge, attempts: Sequence[Sequence[Attempt]]
    ) -> Iterator[Step]:
        """Yield the steps of a plan, as many as can be done."""
        while ticks:
            folds = self.replanning.disturb == "fold" and not self.folded
            next_ticks, ticks = _parted(ticks, folds)
            schedule = make_schedule(judge.grid, next_ticks, judge.rules)
            if schedule.forbidden:
                return
            yield from self._step(next_ticks, attempts)
            if self._problem(judge) or not judge.grid.same_visible(schedule.final):
                return
            if folds:
                yield from self._fold(judge, attempts)

    def _step(
        self, ticks: Sequence[TeamAction], attempts: Sequence[Sequence[Attempt]]
    ) -> Iterator[Step]:
        yield Step.of_ticks(self.n_ticks, *ticks, order="until-wrong")
        self.n_ticks += len(ticks)
        self.n_acts += sum(map(len, ticks))
        for attempt in attempts[-1]:
            if attempt.performed:
                if attempt.skill == "succeeded":
                    self.failures[attempt.car] = 0
                else:
                    self.failures[attempt.car] += 1

    def _seat_loads(self, judge: Judge, attempts: Sequence[Sequence[Attempt]]) -> Iterator[Step]:
        """Lift loads again that sit off their seats."""
        for car, actions in loads_to_seat(judge).items():
            if car in self.out or self.n_seated == MOST_SEATED:
                continue
            self.n_seated += 1
            for action in actions:
                yield from self._step([[(car, action)]], attempts)

    def _fold(self, judge: Judge, attempts: Sequence[Sequence[Attempt]]) -> Iterator[Step]:
        """Disturb the building: a car folds a slope that was just unfolded."""
        for car in range(judge.grid.n_cars):
            if judge.rules.legal(judge.grid, car, Action.FOLD):
                self.folded = f"car {car} folds a slope again at {judge.physics.time_s:.2f} s"
                yield from self._step([[(car, Action.FOLD)]], attempts)
                return

    def _problem(self, judge: Judge) -> str:
        """Find out which cars are out of action, and return what else cannot be read."""
        self.out |= {car for car, n in self.failures.items() if n >= FAILURES}
        self.out |= judge.executor.fleet.lost_cars.keys()
        for car, n in self.failures.items():
            stuck = tuple(_stuck_with(judge, [car]))
            if n and any(text.startswith(stuck) for text in judge.problems):
                self.out.add(car)
        excused = tuple(_stuck_with(judge, self.out))
        return "; ".join(text for text in judge.problems if not text.startswith(excused))


def _parted(
    ticks: Sequence[TeamAction], after_unfolding: bool
) -> tuple[Sequence[TeamAction], Sequence[TeamAction]]:
    """Return what is done next of a plan, and the rest: up to a tick that unfolds, and as much as a step may hold."""
    n_acts = 0
    for number, team_action in enumerate(ticks, 1):
        n_acts += len(team_action)
        unfolds = any(action is Action.UNFOLD for _, action in team_action)
        following = 0
        if number < len(ticks):
            following = len(ticks[number])
        if (after_unfolding and unfolds) or n_acts + following > STEP_ACTIONS:
            return ticks[:number], ticks[number:]
    return ticks, ()


def without_cars(judge: Judge, task: Task, out: Iterable[int]) -> tuple[Grid, tuple[int, ...]]:
    """Return the world as it was read last with walls for cars out of action, and the numbers of the other cars.

    What stands where one of them is stays if the design has it there: it bears what comes upon it.
    """
    real = judge.grid
    lost_cars = sorted(out)
    acting = tuple(car for car in range(real.n_cars) if car not in lost_cars)
    grid = real.copy()
    grid.cars = real.cars[list(acting)]
    walled = set()
    for car in lost_cars:
        for cell in _cells(judge, car):
            walled.add(cell)
    if task.design is not None:
        # What stands in a cell only nearly, such as a slope that is half open, is not what the design has there.
        nearly = set()
        for index, placed in enumerate(judge.reading.objects):
            name = f"{judge.poses.name(index)} "
            if any(text.startswith(name) for text in judge.reading.problems):
                nearly.add(placed.cell)
        walled -= {target.cell for target, hit in task.design.hits(real) if hit} - nearly
    for cell in list(walled):
        kind = real.kind[cell]
        yaw = int(real.yaw[cell])
        if kind in (Kind.FSLOPE, Kind.BODY, Kind.GEAR, Kind.FOOT):
            if kind not in SECOND_PART:
                yaw += 2
            walled.add(beside(cell, yaw))
    for cell in walled:
        grid.kind[cell] = Kind.WALL
        grid.yaw[cell] = 0
    grid.derive_marks()
    return grid, acting


def _stuck_with(judge: Judge, out: Iterable[int]) -> Iterator[str]:
    """Yield how problems begin that concern cars out of action, and what they carry or stand under."""
    for car in out:
        yield f"car {car} "
        cells = _cells(judge, car)
        for index, placed in enumerate(judge.reading.objects):
            if placed.carrier == car or placed.cell in cells:
                yield f"{judge.poses.name(index)} "


def _cells(judge: Judge, car: int) -> set[Cell]:
    """Return the cells that a car reaches into."""
    grid = judge.grid
    length, width, height = grid.size
    x, y, _ = judge.poses.car_positions[car]
    z = min(int(grid.cars[car, CarField.Z]), height)
    cells = set()
    for i in _cells_between(x):
        for j in _cells_between(y):
            if 0 <= i < length and 0 <= j < width:
                cells.add((i, j, z))
    return cells


def _cells_between(middle_m: float) -> tuple[int, int]:
    """Return the numbers of the cells that both ends of a car are in, along an axis."""
    first = math.floor((middle_m - _HALF_M) / CELL_PITCH_M)
    last = math.floor((middle_m + _HALF_M) / CELL_PITCH_M)
    return first, last
