"""A Site whose every action is predicted by the rules, performed by skills, read from poses, and judged."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt, Evidence, Finding, Verdict, capped_text, compare, judge
from craftsim.checking.contact_log import ContactLog, speed_m_s
from craftsim.checking.safety import hazards, is_unsafe
from craftsim.checking.settings import Thresholds
from craftsim.checking.standing import Standing, turns
from craftsim.checking.straying import Straying
from craftsim.checking.unexpected import handled, under, unexpected_contacts
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import (
    PLACE_TOLERANCE_M,
    CellFit,
    Poses,
    Reading,
    describe_car,
    own_differences,
    read_grid,
)
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Concurrency, Constraints, Schedule, ScheduledAction, make_schedule
from craftsim.models.measuring import PoseReader
from craftsim.models.placement import lift_m
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Outcome
from craftsim.skills.skill import Terrain

SETTLED_M_S: Final = 0.01
"""Below this speed a thing counts as at rest: eight times what was seen at the end of any good action."""
SETTLE_S: Final = 1.0
"""How long what still moves when nothing is commanded may take to come to rest before the world is read."""

Joint = Sequence[tuple[int, Action]]
"""(car, action) in acting order."""
OnChange = Callable[[dict[int, ScheduledAction]], None]
"""Called with the running actions by car whenever one begins or ends."""


@dataclass
class _Running:
    """An action on its way, with the world as it was at its start."""

    index: int
    """In the schedule."""
    step: ScheduledAction
    start_s: float
    capped_steps: int
    """Of the Site, until then."""
    poses: Poses
    """Of what has been moved by an action that ended meanwhile: where that left it."""
    reading: Reading
    about: list[int]
    """Objects that the action is about, by their index."""
    cars: set[int]
    """Those that act meanwhile, its own included."""
    meant: set[int]
    """Objects that may move though no acting car carries them: what the action and those beside it are about."""
    below: set[int]
    """Objects that the car stands and drives on: a stack sways under it until it has come to rest."""

    def expect_rest(self, other: _Running, now: Poses) -> None:
        """From here on hold it against this action if what another one was about moves: that one has ended."""
        car, things = other.step.car, other.about
        for mine, theirs, rows in (
            (self.poses.car_positions, now.car_positions, car),
            (self.poses.car_quaternions, now.car_quaternions, car),
            (self.poses.positions, now.positions, things),
            (self.poses.quaternions, now.quaternions, things),
            (self.poses.hinges, now.hinges, things),
        ):
            mine[rows] = theirs[rows]
        self.meant.difference_update(things)


class CheckedSite:
    """The one judge: performs actions on a Site and returns an :class:`Attempt` for each.

    Everything ends as soon as something unsafe happens: all motors stop, and the world is read as it is then. Each
    prediction starts from what was read last.
    """

    def __init__(
        self,
        executor: Executor,
        rules: Rules,
        thresholds: Thresholds | None = None,
        watch_contacts: bool = True,
    ) -> None:
        """Read the start from poses.

        Args:
            executor: moves the cars; nothing else may command its Site.
            rules: predict.
            thresholds: limits of the errors; the default ones unless given.
            watch_contacts: False saves the contact log, 3 % of the time; then nothing is found to be unsafe.
        """
        self.executor, self.site, self.rules = executor, executor.site, rules
        self.thresholds = thresholds or Thresholds()
        self.on_change: OnChange = lambda running: None
        self.log = ContactLog(self.site, self.thresholds.force) if watch_contacts else None
        """Since an action last began while no other ran; of a car and its things since its own last action began."""
        if self.log is not None:
            executor.observers.append(self.log.sample)
            executor.step_observer = self.log.look
            # Not a method of this object: a cycle would keep the whole simulation until garbage is collected.
            executor.guard = partial(is_unsafe, self.log)
        self._poses = PoseReader(self.site)
        self._standing = Standing(self.site, self._poses)
        executor.observers.append(self._standing.look)
        self._straying = Straying(executor, self._poses) if self.site.uneven else None
        if self._straying is not None:
            executor.observers.append(self._straying.look)
        self._look()
        self._told = self._beyond()

    @property
    def grid(self) -> Grid:
        """The world as it was read last."""
        return self.reading.grid

    @property
    def problems(self) -> tuple[str, ...]:
        """Why the world cannot be read as a grid any more; empty when it can."""
        broken = ("the simulation broke down",) if self.site.diverged else ()
        return (*broken, *self.reading.problems)

    def perform(self, car: int, action: Action, intended: Grid | None = None, tick: int = 0) -> Attempt:
        """Perform one action and return the attempt.

        An action that the rules forbid is performed only where ``intended`` says what it should lead to.
        """
        if intended is None:
            return self.perform_tick([(car, action)], tick=tick)[0]
        step = ScheduledAction(tick, car, action, self.grid, intended)
        legal = self.rules.legal(self.grid, car, action)
        return self._perform(Schedule((step,), (), intended, ((tick, car),)), legal=legal)[0]

    def perform_tick(
        self, joint: Joint, order: Concurrency = "concurrent", tick: int = 0
    ) -> tuple[Attempt, ...]:
        """Perform one tick of many cars, each as early as ``order`` lets it; return the attempts in acting order."""
        return self._perform(make_schedule(self.grid, [joint], self.rules, order, tick))

    def perform_plan(
        self, ticks: Iterable[Joint], order: Concurrency, after: Constraints | None = None
    ) -> tuple[Attempt, ...]:
        """Perform the ticks of a plan as one schedule and return an attempt for each action, in their order.

        ``after`` are order constraints of the plan, as of :func:`craftsim.discrete.schedule.make_schedule`.

        A car whose action fails stops there, and what depends on it is not performed; the others finish. An action
        whose own part reads as predicted agrees, unless nobody's part is wrong and something else is: that is then
        held against all.
        """
        schedule = make_schedule(self.grid, ticks, self.rules, order, after=after)
        return self._perform(schedule, halts=order == "until-wrong")

    def _perform(self, schedule: Schedule, legal: bool = True, halts: bool = False) -> tuple[Attempt, ...]:
        before, steps, capped = self.grid, schedule.steps, self.site.capped_steps
        waiting = dict(enumerate(steps))
        running: dict[int, _Running] = {}
        evidence: dict[int, Evidence] = {}
        settled = True
        if steps:
            self._standing.begin()
        if self.log is not None and steps:
            self.log.begin()
        while True:
            done = {index for index, found in evidence.items() if found.outcome and found.outcome.succeeded}
            halted = halts and any(_is_wrong(found) for found in evidence.values())
            for index, step in [] if halted else list(waiting.items()):
                if step.waits_for <= done and step.car not in running:
                    running[step.car] = self._begin(index, waiting.pop(index), running)
            self.on_change({car: one.step for car, one in running.items()})
            if not running:
                break
            ended = self._ended()
            if len(ended) == len(running):
                settled = self._settle()
            self._look()
            acting = set(running)
            over = [running.pop(car) for car in ended]
            swaying = {index for one in running.values() for index in one.below}
            # What swayed under a car has its place again once that has come to its end.
            self._standing.settle([len(self.site.cars) + index for one in over for index in one.below])
            for one in over:
                evidence[one.index] = self._measure(one, ended[one.step.car], legal, acting, swaying)
                for other in running.values():
                    other.expect_rest(one, self.poses)
            self._leave(over, swaying)
        world = self._world_verdict(before, schedule.final, settled, capped)
        found = [evidence[index] for index in sorted(evidence)]
        found += [self._measure(self._now(step), None, True, set(), set()) for step in waiting.values()]
        found += [self._measure(self._now(step), None, False, set(), set()) for step in schedule.forbidden]
        attempts = [judge(one, self._verdict(one, world, found), self.thresholds) for one in found]
        place = {act: number for number, act in enumerate(schedule.acts)}
        return tuple(sorted(attempts, key=lambda a: place[a.tick, a.car]))

    def _ended(self) -> dict[int, Outcome]:
        """Return the outcomes of the actions that end next, by car, once what their cars did can be seen."""
        ended: dict[int, Outcome] = {}
        left = self.executor.fleet.late_periods
        while not ended or left:
            left -= bool(ended)
            newly = self.executor.advance()
            if newly:
                ended, left = ended | newly, self.executor.fleet.late_periods
        return ended

    def _begin(self, index: int, step: ScheduledAction, running: dict[int, _Running]) -> _Running:
        if running and self._looked_s != self.site.time_s:
            self._look()
        one = self._now(step, index)
        for other in running.values():
            other.cars |= one.cars
            other.meant.update(one.about)
            one.meant.update(other.about)
        one.cars.update(running)
        if self.log is not None and running:
            self.log.begin_with(self._own(one))
        if self._straying is not None:
            self._straying.begin(step.car)
        self.executor.begin(step.car, step.action, Terrain(*step.inclines, step.tight))
        return one

    def _now(self, step: ScheduledAction, index: int = -1) -> _Running:
        about = handled(self.reading, step.after, step.car)
        below, site = set(under(self.reading, step.after, step.car)), self.site
        return _Running(
            *(index, step, site.time_s, site.capped_steps, self.poses.copy(), self.reading),
            *(about, {step.car}, set(about), below),
        )

    def _look(self) -> None:
        self._looked_s = self.site.time_s
        self.poses: Poses = self._poses.read()
        self.reading: Reading = read_grid(self.poses, self.site.size, self.site.walls)

    def _unsafe(self) -> bool:
        return self.log is not None and is_unsafe(self.log)

    def _settle(self) -> bool:
        """Wait for what still moves, unless it is unsafe, and return whether it has come to rest."""
        for _ in range(round(SETTLE_S / self.site.config.control_period_s)):
            if speed_m_s(self.site) <= SETTLED_M_S or self._unsafe():
                return True
            self.executor.advance()
        return speed_m_s(self.site) <= SETTLED_M_S

    def _leave(self, over: Sequence[_Running], swaying: set[int]) -> None:
        """Hold what ended actions handled against where it is now, and what is too far from its place as well.

        The latter has been reported, and is held against no later action again.
        """
        n_cars, limits = len(self.site.cars), self.thresholds
        drifted = (self._standing.furthest() > (limits.bystander_m, limits.bystander_rad)).any(axis=1)
        left = set(np.flatnonzero(drifted).tolist()) - {n_cars + index for index in swaying}
        left.update(one.step.car for one in over)
        left.update(n_cars + index for one in over for index in one.about)
        self._standing.leave(sorted(left))
        self._told = self._beyond()

    def _beyond(self) -> dict[str, set[int]]:
        """Return the objects, by their index, that are not as they should stand or be carried, by field."""
        limits = {
            "bystander_reach_m": self.thresholds.placed_m,
            "bystander_tilt_rad": self.thresholds.tilt_rad,
        }
        return {
            field: {i for i, value in enumerate(self._standing_errors(field)) if not value <= limit}
            for field, limit in limits.items()
        }

    def _standing_errors(self, field: str) -> list[float]:
        if field == "bystander_reach_m":
            return [thing.reach_m for thing in self.reading.objects]
        return [_lean(thing) for thing in self.reading.objects]

    def _own(self, one: _Running) -> tuple[str, ...]:
        """Return the names of the car and of what it handles."""
        return (f"car {one.step.car}", *(one.poses.name(index) for index in one.about))

    def _measure(
        self, one: _Running, outcome: Outcome | None, legal: bool, acting: set[int], swaying: set[int]
    ) -> Evidence:
        step, car, log = one.step, one.step.car, self.log
        placed, about, own = self.reading.cars[car], one.about, self._own(one)
        # What the car should not carry afterwards is set down, folded, unfolded or shoved.
        set_down = about[0] if about and step.after.cars[car, CarField.LOAD] == Kind.AIR else None
        things = [self.reading.objects[index] for index in about]
        loads = [thing.offset_m for thing in things if thing.carrier is not None]
        others = self._bystanders(one, acting, swaying)
        contacts = () if log is None else log.contacts
        return Evidence(
            step=step,
            legal=legal,
            outcome=outcome,
            differences=tuple(own_differences(step.before, step.after, self.grid, car)),
            own=own,
            read=describe_car(self.grid, car),
            car_error_m=placed.offset_m,
            heading_error_rad=abs(placed.heading_rad),
            height_error_m=abs(placed.height_m),
            tilt_error_rad=placed.tilt_rad,
            placed_error_m=None if set_down is None else self.reading.objects[set_down].offset_m,
            seat_error_m=max(loads, default=None),
            thing_heading_rad=max((abs(thing.heading_rad) for thing in things), default=None),
            thing_tilt_rad=max(map(_lean, things), default=None),
            thing_height_m=max((abs(self._too_high_m(index)) for index in about), default=None),
            reach_m=max((thing.reach_m for thing in things), default=None),
            **{field: value for field, (value, _) in others.items()},
            bystanders={field: name for field, (_, name) in others.items()},
            strayed_m=None if self._straying is None else self._straying.furthest_m(car),
            start_s=one.start_s,
            contacts=unexpected_contacts(contacts, one.poses, one.reading, step.after, own, one.cars),
            hazards=() if log is None else hazards(log),
            peak_force_n=0.0 if log is None else log.peak_n,
            capped_steps=self.site.capped_steps - one.capped_steps,
        )

    def _too_high_m(self, index: int) -> float:
        """Return how much higher a thing stands than the floor of its cell, or is carried than on its seat."""
        thing = self.reading.objects[index]
        if thing.carrier is None:
            return thing.height_m
        machines = self.site.machines
        return thing.height_m - lift_m(self.poses.kinds[index], machines.car(thing.carrier), machines)

    def _bystanders(self, one: _Running, acting: set[int], swaying: set[int]) -> dict[str, tuple[float, str]]:
        """Return the largest of each error of what an action does not concern, by field, with the name of what has it.

        What sways under a car that still drives is not looked at now, but held against that car's action at its end.
        """
        then, now, n_cars = one.poses, self.poses, len(one.poses.car_positions)
        excused = one.meant | swaying
        pairs = enumerate(zip(one.reading.objects, self.reading.objects, strict=True))
        things = [
            index
            for index, (was, reads) in pairs
            if not (index in excused or was.carrier in acting or reads.carrier in acting)
        ]
        rows = np.array(
            [*(car for car in range(n_cars) if car not in acting), *(n_cars + i for i in things)], int
        )
        drift = self._standing.furthest()
        ways = np.concatenate((now.car_positions - then.car_positions, now.positions - then.positions))
        moved = np.column_stack((np.sqrt((ways * ways).sum(axis=1)), turns(then, now), drift))[rows]
        fields = ("bystander_displacement_m", "bystander_turn_rad", "drift_m", "drift_rad")
        names = [f"car {row}" if row < n_cars else then.name(row - n_cars) for row in rows.tolist()]
        found = {field: _largest(column, names) for field, column in zip(fields, moved.T, strict=True)}
        for field, told in self._told.items():
            errors = self._standing_errors(field)
            news = [index for index in things if index not in told]
            found[field] = _largest(np.array([errors[i] for i in news]), [then.name(i) for i in news])
        return found

    def _world_verdict(self, before: Grid, predicted: Grid, settled: bool, capped: int) -> Verdict:
        """Compare the reading with the prediction; what is worse than a difference comes first.

        ``capped`` counts the steps of the Site in which the solver had given up before.
        """
        verdict = self._safe_verdict(before, predicted, settled)
        if verdict.finding is Finding.DIVERGED:
            return verdict
        impossible = () if self.log is None else self.log.impossible
        if not verdict.agrees and (gave_up := self.site.capped_steps - capped):
            impossible = (capped_text(gave_up), *impossible)
        return Verdict(Finding.NUMERICS, (*impossible, *verdict.differences)) if impossible else verdict

    def _safe_verdict(self, before: Grid, predicted: Grid, settled: bool) -> Verdict:
        verdict = compare(before, predicted, self.reading)
        unsafe = () if self.log is None else tuple(hazard.text for hazard in hazards(self.log))
        if self.site.diverged:
            return Verdict(Finding.DIVERGED, ("the simulation broke down and started over",))
        if unsafe:
            return Verdict(Finding.UNSAFE, (*unsafe, *verdict.differences))
        if not settled:
            moving = f"something still moves with {speed_m_s(self.site) * 1e3:.0f} mm/s"
            return Verdict(Finding.UNSETTLED, (moving, *verdict.differences))
        return verdict

    def _verdict(self, one: Evidence, world: Verdict, all_evidence: Sequence[Evidence]) -> Verdict:
        """Return the verdict on one of many actions."""
        car, action = one.step.car, one.step.action
        if one.outcome is None:
            why = f"car {car} waits for an action that failed"
            if not one.legal:
                why = f"the rules forbid it: {self.rules.explain(one.step.before, car, action).why}"
            return Verdict(Finding.NOT_EXECUTED, (why,))
        if world.agrees:
            return world
        tried = [other for other in all_evidence if other.legal or other.outcome is not None]
        nobodys = len(tried) == 1 or all(other.applied for other in tried)
        if one.applied and not nobodys:
            return Verdict(Finding.AGREES)
        if nobodys or world.finding in (Finding.UNSAFE, Finding.NUMERICS, Finding.DIVERGED):
            return world
        return Verdict(Finding.WRONG_PLACE, one.differences or (str(one.outcome),))


def _lean(thing: CellFit) -> float:
    """Return how far a thing leans, or how far its hinge is short of its end where that is more."""
    return max(thing.tilt_rad, thing.hinge_rad)


def _largest(values: NDArray[np.float64], names: Sequence[str]) -> tuple[float, str]:
    """Return the largest of some values with its name; 0 and no name of none."""
    if not len(values):
        return 0.0, ""
    at = int(values.argmax())
    return float(values[at]), names[at]


def _is_wrong(found: Evidence) -> bool:
    """Return whether the world is not as an action should leave it, for any car that goes on in it."""
    return not found.applied or found.bystander_displacement_m > PLACE_TOLERANCE_M
