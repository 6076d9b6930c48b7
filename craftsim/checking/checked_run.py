"""Running actions in physics and checking each against the prediction of the rules."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from craftsim.checking.contact_log import Contact, ContactLog
from craftsim.checking.joint import CarStep, JointSite
from craftsim.checking.safety import Hazard, hazards, is_unsafe
from craftsim.checking.unexpected import handled, shoved, unexpected_contacts
from craftsim.discrete.actions import Action
from craftsim.discrete.files.plan import Plan
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.readback import Poses, Reading, read_grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Order
from craftsim.discrete.terrain import inclines_of
from craftsim.discrete.verdict import Finding, Verdict, compare, describe_car, has_effect
from craftsim.models.sensing import read_poses
from craftsim.models.site import Site
from craftsim.skills.driving import Terrain
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Outcome

SETTLED_M_S: Final = 0.01
"""Below this speed a thing counts as at rest: eight times what was seen at the end of any good action."""
SETTLE_S: Final = 1.0
"""How long what still moves at the end of an action may take to come to rest before the world is read."""


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
    level: int
    """The car's level before the action."""
    load: Kind
    """What it carried before the action."""
    sloping: bool
    """Whether it starts on a slope, or should end on one."""
    own: tuple[str, ...]
    """The car and what it handles, by name."""
    outcome: Outcome
    verdict: Verdict
    effect: bool
    """Whether all that the action was to change reads as predicted, whatever else happened."""
    car_error_m: float
    """Distance of the car from its cell's centre."""
    car_heading_error_rad: float
    car_height_error_m: float
    """Height of the car above the floor of its cell."""
    placed_error_m: float | None
    """Distance of a thing that was set down, folded or unfolded from its cell's centre; None for other actions."""
    others_moved_m: float
    """The furthest that anything moved which the action does not concern."""
    moved: str
    """Its name; empty where there is nothing else."""
    touched: tuple[Contact, ...]
    """Contacts that the action does not explain, hardest first."""
    hazards: tuple[Hazard, ...]
    peak_force_n: float
    """The largest force between any two machines, the ground included."""


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
    """A Site whose every action is predicted by the rules, performed by skills, read from poses, and compared.

    An action ends as soon as something unsafe happens: all motors stop, and the world is read as it is then.
    """

    def __init__(self, site: Site, rules: Rules, executor: Executor) -> None:
        """Read the start from poses; later predictions are made from what was read last."""
        self.site, self.rules, self.executor = site, rules, executor
        self.log = ContactLog(site)
        """Of the action that was performed last."""
        executor.observers.append(self.log.sample)
        executor.guard = lambda: is_unsafe(self.log)
        self.poses, self.reading = self._look()

    def perform(self, tick: int, car: int, action: Action, intended: Grid | None = None) -> ActionRecord:
        """Perform one action and return its record.

        An action that the rules forbid is performed only where ``intended`` says what it should lead to.
        """
        before = self.reading.grid
        legal = self.rules.legal(before, car, action)
        predicted = self.rules.apply(before, car, action) if intended is None else intended
        start = self._begin()
        if legal or intended is not None:
            ground = Terrain(*inclines_of(before, predicted, car))
            outcome = self.executor.run({car: action}, {car: ground})[car]
        else:
            outcome = Outcome(None, 0.0)
        settled = self._settle()
        self.poses, self.reading = self._look()
        verdict = self._judge(before, predicted, settled)
        if not legal and intended is None:
            verdict = _forbidden(car, action)
        done = has_effect(before, predicted, self.reading.grid, car)
        return self._record(start, tick, CarStep(car, action, legal, outcome, done, ""), predicted, verdict)

    def perform_together(
        self, tick: int, joint: Sequence[tuple[int, Action]], order: Order = "concurrent"
    ) -> tuple[ActionRecord, ...]:
        """Perform one tick of many cars, as :meth:`JointSite.step` does, and return a record for each car.

        A car whose own part reads as predicted agrees, unless nobody's part is wrong and something else is: that
        is then held against all.
        """
        before = self.reading.grid
        start = self._begin()
        step = JointSite(self.site, self.rules, self.executor).step(joint, order)
        settled = self._settle()
        self.poses, self.reading = self._look()
        world = self._judge(before, step.predicted, settled)
        shared = all(car.applied or not car.legal for car in step.cars)
        together = [car.car for car in step.cars]
        return tuple(
            self._record(start, tick, car, step.predicted, _own_verdict(car, world, shared), together)
            for car in step.cars
        )

    def _look(self) -> tuple[Poses, Reading]:
        poses = read_poses(self.site)
        return poses, read_grid(poses, self.site.size, self.site.walls)

    def _begin(self) -> tuple[Poses, Reading]:
        self.log.begin()
        return self.poses, self.reading

    def _settle(self) -> bool:
        """Wait for what still moves, unless it is unsafe, and return whether it has come to rest."""
        for _ in range(round(SETTLE_S / self.site.config.control_period_s)):
            if self.log.speed_m_s <= SETTLED_M_S or is_unsafe(self.log):
                return True
            self.executor.advance()
        return self.log.speed_m_s <= SETTLED_M_S

    def _judge(self, before: Grid, predicted: Grid, settled: bool) -> Verdict:
        """Compare the reading with the prediction; what is worse than a difference comes first."""
        verdict = compare(before, predicted, self.reading)
        unsafe = tuple(hazard.text for hazard in hazards(self.log))
        if self.site.diverged:
            return Verdict(Finding.DIVERGED, ("the simulation broke down and started over",))
        if unsafe:
            return Verdict(Finding.UNSAFE, (*unsafe, *verdict.differences))
        if not settled:
            moving = f"something still moves with {self.log.speed_m_s * 1e3:.0f} mm/s"
            return Verdict(Finding.UNSETTLED, (moving, *verdict.differences))
        return verdict

    def _record(
        self,
        start: tuple[Poses, Reading],
        tick: int,
        step: CarStep,
        predicted: Grid,
        verdict: Verdict,
        together: Collection[int] = (),
    ) -> ActionRecord:
        """Measure one car's action; ``together`` names the cars that acted at the same time."""
        car, (poses, before) = step.car, start
        actors = together or (car,)
        placed = self.reading.cars[car]
        own = handled(before, predicted, car)
        # What the car should not carry afterwards is set down, folded, unfolded or shoved.
        set_down = own[0] if own and predicted.cars[car, CarField.LOAD] == Kind.AIR else None
        meant = {index for actor in actors for index in shoved(before, predicted, actor)}
        moved_m, moved = self._furthest_moved(poses, before, actors, meant)
        row = before.grid.cars[car]
        return ActionRecord(
            tick=tick,
            car=car,
            action=step.action,
            predicted=describe_car(predicted, car),
            read=describe_car(self.reading.grid, car),
            legal=step.legal,
            level=int(row[CarField.Z]),
            load=Kind(row[CarField.LOAD]),
            sloping=bool(row[CarField.SLOPE] or predicted.cars[car, CarField.SLOPE]),
            own=(f"car {car}", *(poses.name(i) for i in own)),
            outcome=step.outcome or Outcome(None, 0.0),
            verdict=verdict,
            effect=step.in_place,
            car_error_m=placed.offset_m,
            car_heading_error_rad=placed.heading_rad,
            car_height_error_m=placed.height_m,
            placed_error_m=None if set_down is None else self.reading.objects[set_down].offset_m,
            others_moved_m=moved_m,
            moved=moved,
            touched=unexpected_contacts(self.log.contacts, poses, before, predicted, actors),
            hazards=hazards(self.log),
            peak_force_n=self.log.peak_n,
        )

    def _furthest_moved(
        self, before: Poses, was: Reading, actors: Collection[int], meant: Collection[int]
    ) -> tuple[float, str]:
        """Return the longest way in metres of anything that is not meant to move, and its name.

        That is all but the acting cars, what they carry, and the objects ``meant``.
        """
        ways = {
            f"car {car}": float(np.linalg.norm(now - then))
            for car, (then, now) in enumerate(
                zip(before.car_positions, self.poses.car_positions, strict=True)
            )
            if car not in actors
        }
        ways |= {
            self.poses.name(i): float(np.linalg.norm(self.poses.positions[i] - before.positions[i]))
            for i, (a, b) in enumerate(zip(was.objects, self.reading.objects, strict=True))
            if a.carrier not in actors and b.carrier not in actors and i not in meant
        }
        moved = max(ways, key=lambda name: ways[name], default="")
        return ways.get(moved, 0.0), moved


def _forbidden(car: int, action: Action) -> Verdict:
    return Verdict(Finding.NOT_EXECUTED, (f"the rules forbid {action.name} to car {car} here",))


def _own_verdict(step: CarStep, world: Verdict, shared: bool) -> Verdict:
    """Return the verdict on one of many cars; ``shared`` says that what is wrong with the world is nobody's own."""
    if not step.legal:
        return _forbidden(step.car, step.action)
    if step.outcome is None:
        return Verdict(Finding.NOT_EXECUTED, (f"car {step.car} waits for an action that failed",))
    if world.agrees or (step.applied and not shared):
        return Verdict(Finding.AGREES)
    if shared or world.finding in (Finding.UNSAFE, Finding.DIVERGED):
        return world
    return Verdict(Finding.WRONG_PLACE, (step.difference or str(step.outcome),))


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
