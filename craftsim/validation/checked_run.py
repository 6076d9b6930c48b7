"""Running actions in physics and checking each against the prediction of the rules."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from craftsim.discrete.actions import Action
from craftsim.discrete.files.plan import Plan
from craftsim.discrete.grid import Kind
from craftsim.discrete.readback import Poses, Reading, read_grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.terrain import inclines_of
from craftsim.discrete.verdict import Finding, Verdict, compare, describe_car
from craftsim.models.sensing import read_poses
from craftsim.models.site import Site
from craftsim.skills.driving import Terrain
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Outcome


@dataclass(frozen=True)
class ActionRecord:
    """One action: what was asked, predicted, done and read."""

    tick: int
    car: int
    action: Action
    predicted: str
    """The acting car as the rules predict it."""
    read: str
    """The acting car as its pose reads."""
    legal: bool
    outcome: Outcome
    verdict: Verdict
    car_error_m: float
    """Distance of the car from its cell's centre."""
    car_heading_error_rad: float
    placed_error_m: float | None
    """Distance of a thing that was set down, folded or unfolded from its cell's centre; None for other actions."""
    others_moved_m: float
    """The furthest that anything moved which the action does not concern."""


@dataclass(frozen=True)
class CheckedRun:
    """A plan run in physics."""

    records: tuple[ActionRecord, ...]
    final: Reading
    simulated_s: float

    @property
    def agrees(self) -> bool:
        """Whether every action did what the rules predicted."""
        return all(record.legal and record.verdict.agrees for record in self.records)


class CheckedSite:
    """A Site whose every action is predicted by the rules, performed by skills, read from poses, and compared."""

    def __init__(self, site: Site, rules: Rules, executor: Executor) -> None:
        """Read the start from poses; later predictions are made from what was read last."""
        self.site, self.rules, self.executor = site, rules, executor
        self.poses = read_poses(site)
        self.reading = read_grid(self.poses, site.size, site.walls)

    def perform(self, tick: int, car: int, action: Action) -> ActionRecord:
        """Perform one action and return its record; an illegal action is not performed."""
        before_reading, poses_before = self.reading, self.poses
        before = before_reading.grid
        legal = self.rules.legal(before, car, action)
        predicted = self.rules.apply(before, car, action) if legal else before
        if legal:
            ground = Terrain(*inclines_of(before, predicted, car))
            outcome = self.executor.run({car: action}, {car: ground})[car]
        else:
            outcome = Outcome(None, 0.0)
        self.poses = read_poses(self.site)
        self.reading = read_grid(self.poses, self.site.size, self.site.walls)
        verdict = compare(before, predicted, self.reading)
        if not legal:
            verdict = Verdict(Finding.NOT_EXECUTED, (f"the rules forbid {action.name} to car {car} here",))
        placed = self.reading.cars[car]
        set_down = self._set_down(before_reading, car, action)
        return ActionRecord(
            tick=tick,
            car=car,
            action=action,
            predicted=describe_car(predicted, car),
            read=describe_car(self.reading.grid, car),
            legal=legal,
            outcome=outcome,
            verdict=verdict,
            car_error_m=placed.offset_m,
            car_heading_error_rad=placed.heading_rad,
            placed_error_m=None if set_down is None else self.reading.objects[set_down].offset_m,
            others_moved_m=_furthest_moved(poses_before, self.poses, car, before_reading, self.reading),
        )

    def _set_down(self, before: Reading, car: int, action: Action) -> int | None:
        """Return the object that the action set down, folded or unfolded, if there is one."""
        for index, (was, kind) in enumerate(zip(before.objects, self.poses.kinds, strict=True)):
            dropped = action is Action.DROP and was.carrier == car
            turned = action in (Action.FOLD, Action.UNFOLD) and kind == Kind.FSLOPE
            if dropped or (turned and was.carrier is None and was.cell == before.cars[car].cell):
                return index
        return None


def _furthest_moved(before: Poses, after: Poses, car: int, was: Reading, now: Reading) -> float:
    """Return the longest way in metres that another car, or an object that this car does not carry, moved."""
    others = [i for i in range(len(before.car_positions)) if i != car]
    cars = np.linalg.norm(after.car_positions[others] - before.car_positions[others], axis=1)
    rest = [
        i
        for i, (a, b) in enumerate(zip(was.objects, now.objects, strict=True))
        if car not in (a.carrier, b.carrier)
    ]
    objects = np.linalg.norm(after.positions[rest] - before.positions[rest], axis=1)
    return float(max([0.0, *cars, *objects]))


def run_plan(
    checked: CheckedSite,
    plan: Plan,
    begin: Callable[[int, int, Action], None],
    done: Callable[[ActionRecord], None],
) -> CheckedRun:
    """Run a plan action by action, in the order of its lines, and return the records.

    Args:
        checked: the world.
        plan: what to do.
        begin: called with tick, car and action before each action.
        done: called with the record after each action.
    """
    records = []
    for tick, joint in enumerate(plan.ticks):
        for car, action in joint:
            begin(tick, car, action)
            records.append(checked.perform(tick, car, action))
            done(records[-1])
    return CheckedRun(tuple(records), checked.reading, checked.site.time_s)
