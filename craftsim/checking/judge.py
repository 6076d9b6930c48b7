"""A PhysicsWorld whose every action is predicted by the rules, performed by skills, read from poses, and judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import (
    AGREES,
    BYSTANDER_ERRORS,
    Attempt,
    Cause,
    Thresholds,
    Watched,
    attempt_of,
    capped_text,
    compare,
)
from craftsim.checking.contacts import ContactLog, Drift, apart, handled, under, unexpected_contacts
from craftsim.compiled.jit import plain
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.kernel.claims import CHANGES
from craftsim.discrete.kinds import Action, TeamAction
from craftsim.discrete.readback import Poses, Reading, describe_car, own_differences, read_grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Concurrency, Constraints, Schedule, ScheduledAction, make_schedule
from craftsim.models.composition import lift_m
from craftsim.models.measuring import Floats
from craftsim.models.world import PhysicsWorld
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Outcome
from craftsim.skills.skill import Terrain
from craftsim.workers.copying import Copyable

SETTLED_M_S: Final = 0.01
"""Below this speed a thing is at rest: eight times the largest at the end of any good action."""
SETTLE_S: Final = 1.0
"""Time for things to come to rest after the last action, before the world is read."""

_apart: Final = plain(apart)
Bystanders = tuple[dict[str, float], dict[str, str]]
OnChange = Callable[[dict[int, ScheduledAction]], None]
"""Called with the running actions by car whenever one begins or ends."""


def _tell_nobody(_: dict[int, ScheduledAction]) -> None:
    """Do nothing when an action begins or ends."""


def _stray(drift: Drift, executor: Executor, _: PhysicsWorld) -> None:
    drift.stray(executor.paths())


class Judge(Copyable):
    """The one judge: performs actions on a PhysicsWorld and returns an :class:`Attempt` for each.

    If something unsafe happens, all motors stop and all actions end. Each prediction starts from the last reading.

    Whole plans are performed as schedules. Actions may also begin one by one while others run: :meth:`begin` starts
    one, and :meth:`next` runs to the next ending.

    A copy, or a pickle, judges a copy of the PhysicsWorld, and goes on with the running actions.
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
            executor: moves the cars; nothing else may command its PhysicsWorld.
            rules: for the predictions.
            thresholds: limits of the errors; the default ones unless given.
            watch_contacts: False saves the contact log, 3 % of the time; nothing is unsafe then.
        """
        self.executor = executor
        self.physics = executor.physics
        self.rules = rules
        self.thresholds = thresholds or Thresholds()
        self.on_change: OnChange = _tell_nobody
        if not watch_contacts:
            self.log = None
        else:
            self.log = ContactLog(self.physics, self.thresholds.force)
        """Contacts since an action last began while no other ran; of a car and its things since its last beginning."""
        if self.log is not None:
            executor.observers.append(self.log.sample)
            executor.step_observer = self.log.look
            # Not a method of this object: a cycle would keep the whole simulation until garbage is collected.
            executor.guard = self.log.is_unsafe
        self._drift = Drift(self.physics)
        executor.observers.append(self._drift.look)
        if self.physics.uneven:
            executor.observers.append(partial(_stray, self._drift, executor))
        self._confirmed: Grid | None = None
        """Of the last reading, once it was asked for."""
        self._look()
        self._n_cars = len(self.physics.cars)
        self._names = [f"car {car}" for car in range(self._n_cars)]
        self._names += map(self.poses.name, range(len(self.poses.kinds)))
        self._known = self._beyond()
        """(n, 2): objects that do not stand, or are not carried, as they should, and have been reported."""
        self._running: dict[int, Watched] = {}
        """By car, in the order in which they began."""
        self._stranded: dict[int, tuple[str, ...]] = {}
        """Lost cars and what their last actions handled, by name."""
        self._last: ScheduledAction
        """The action that last began by itself."""
        self._over: list[Watched] = []
        """What has ended since then."""
        self._settled = True
        """Whether all had come to rest when nothing ran any more."""
        self.handled: frozenset[str] = frozenset()
        """Names of the cars whose actions ended in the last :meth:`next`, and of what these handled."""

    @property
    def grid(self) -> Grid:
        """The world as it was read last."""
        return self.reading.grid

    @property
    def running(self) -> dict[int, ScheduledAction]:
        """The actions that have not ended, by car, in the order in which they began."""
        return {car: one.step for car, one in self._running.items()}

    @property
    def confirmed(self) -> Grid:
        """The world as it was read last, without what running actions have changed of it.

        Their cars, and the cells that their footprints say they change, are as they were when they began.
        """
        if self._confirmed is None:
            if self._running:
                self._confirmed = self._confirm()
            else:
                self._confirmed = self.grid
        return self._confirmed

    def _confirm(self) -> Grid:
        grid = self.grid.copy()
        for car, one in self._running.items():
            began = one.reading.grid
            grid.cars[car] = began.cars[car]
            for *cell, bits in one.step.footprint.tolist():
                if bits & CHANGES and all(0 <= at < n for at, n in zip(cell, grid.cells.shape, strict=False)):
                    grid.cells[*cell] = began.cells[*cell]
        grid.derive_marks()
        return grid

    @property
    def committed(self) -> Grid:
        """The confirmed world with the effects of what runs, in the order in which it began; decisions start here."""
        grid = self.confirmed
        for car, one in self._running.items():
            grid = self.rules.enforce(grid, car, one.step.action)
        return grid

    @property
    def problems(self) -> tuple[str, ...]:
        """Why the world cannot be read as a grid any more, or its cars be driven.

        What running actions handle is left out, and lost cars with what their last actions handled.
        """
        broken = ("the simulation broke down",) if self.physics.diverged else ()
        lost = (self.executor.fleet.lost,) if self.executor.fleet.lost else ()
        handled = [f"{name} " for one in self._running.values() for name in one.own]
        for names in self._stranded.values():
            for name in names:
                handled.append(f"{name} ")
        left = (line for line in self.reading.problems if not line.startswith(tuple(handled)))
        return (*broken, *lost, *left)

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
        self, team_action: TeamAction, order: Concurrency = "concurrent", tick: int = 0
    ) -> tuple[Attempt, ...]:
        """Perform one tick of many cars, each as early as ``order`` lets it; return the attempts in acting order."""
        return self._perform(make_schedule(self.grid, [team_action], self.rules, order, tick))

    def perform_plan(
        self, ticks: Iterable[TeamAction], order: Concurrency, after: Constraints | None = None
    ) -> tuple[Attempt, ...]:
        """Perform the ticks of a plan as one schedule and return an attempt for each action, in their order.

        ``after`` are order constraints of the plan, as of :func:`craftsim.discrete.schedule.make_schedule`.

        A car whose action fails stops there, and what depends on it is not performed; the others finish. An action
        whose own part reads as predicted agrees, unless nobody's part is wrong and something else is: that is then
        held against all. An accident, or what can no longer be read, is held against what had not ended before it.
        """
        schedule = make_schedule(self.grid, ticks, self.rules, order, after=after)
        return self._perform(schedule, halts=order == "until-wrong")

    def begin(self, step: ScheduledAction) -> None:
        """Start one action of a car that has none, while others may run; :meth:`next` runs it.

        ``step.before`` is :attr:`committed`, with which :func:`craftsim.discrete.schedule.make_schedule` makes it.
        """
        if not self._running:
            self._watch()
        self._last = step
        self._over = []
        self._begin(step)
        self.on_change(self.running)

    def next(self, until_s: float | None = None) -> tuple[Attempt, ...]:
        """Run to the next ending, or at most to a time, and return the attempts of all that ended then.

        An action is judged by its own part of the world; what else is otherwise than predicted is seen where nothing
        runs any more, and held against what has ended since an action last began.
        """
        assert self._running or until_s is not None, "nothing runs"
        if not self._running:
            self.executor.fleet.attend()
        over = self._run(until_s)
        names = []
        for ended in over:
            for name in ended.own:
                names.append(name)
        self.handled = frozenset(names)
        if not over:
            return ()
        self._over += over
        self.on_change(self.running)
        world: Cause | None = None
        if not self._running:
            gave_up = max(one.capped_steps for one in self._over)
            world = self._world_cause(self._last.before, self._last.after, gave_up)
        return tuple(attempt_of(one, self._cause(one, world, self._over), self.thresholds) for one in over)

    def refuse(self, step: ScheduledAction) -> Attempt:
        """Return the attempt of an action that the rules forbid in ``step.before``. It is not performed."""
        watched = self._now(step, legal=False)
        acting = set(self._running)
        for running in self._running.values():
            acting.update(running.about)
        self._measure(watched, None, acting, set())
        return attempt_of(watched, self._cause(watched, None, ()), self.thresholds)

    def _perform(self, schedule: Schedule, legal: bool = True, halts: bool = False) -> tuple[Attempt, ...]:
        """Perform a schedule; with ``halts`` nothing begins once an action has not ended as predicted."""
        before = self.grid
        capped_steps = self.physics.capped_steps
        waiting = dict(enumerate(schedule.steps))
        index_of = {(step.tick, step.car): index for index, step in waiting.items()}
        succeeded = set[int]()
        watched = list[Watched]()
        self._settled = True
        if waiting:
            self._watch()
        while True:
            if not (halts and any(attempted.stops_plan for attempted in watched)):
                for index, step in list(waiting.items()):
                    if step.waits_for <= succeeded and step.car not in self._running:
                        self._begin(waiting.pop(index), legal)
            self.on_change(self.running)
            if not self._running:
                break
            for ended in self._run():
                watched.append(ended)
                if ended.outcome is not None and ended.outcome.succeeded:
                    succeeded.add(index_of[ended.step.tick, ended.step.car])
        unbegun = [self._now(step, True) for step in waiting.values()]
        unbegun += [self._now(step, False) for step in schedule.forbidden]
        for step_left in unbegun:
            self._measure(step_left, None, set(), set())
        watched += unbegun
        world = self._world_cause(before, schedule.final, self.physics.capped_steps - capped_steps)
        attempts = []
        for attempted in watched:
            attempts.append(attempt_of(attempted, self._cause(attempted, world, watched), self.thresholds))
        place = {act: number for number, act in enumerate(schedule.acts)}
        return tuple(sorted(attempts, key=lambda attempt: place[attempt.tick, attempt.car]))

    def _watch(self) -> None:
        self._drift.settle(slice(None))
        if self.log is not None:
            self.log.begin()

    def _run(self, until_s: float | None = None) -> list[Watched]:
        """Run to the next ending, or to a time, read the world, and return the measured actions that have ended."""
        running = self._running
        ended = self._ended(until_s)
        if ended and len(ended) == len(running):
            self._settled = self._settle()
        self._look()
        if not ended:
            return []
        acting = set(running)
        over = [running.pop(car) for car in ended]
        lost_cars = self.executor.fleet.lost_cars
        self._stranded |= {one.step.car: one.own for one in over if one.step.car in lost_cars}
        swaying = set()
        for one in running.values():
            for row in one.below:
                swaying.add(row)
        # A stack that swayed under a car has to be back at the end of that car's action, and of no other: actions that
        # began meanwhile saw it elsewhere.
        self._drift.settle([row for one in over for row in one.below])
        for one in over:
            for other in (*over, *running.values()):
                if other is not one:
                    other.poses[one.below] = self._rows[one.below]
        for one in over:
            self._measure(one, ended[one.step.car], acting, swaying)
            # From here on it is held against what still runs if this car, or what it handled, moves.
            rows = [one.step.car, *one.about]
            for other in running.values():
                other.poses[rows] = self._rows[rows]
                other.meant.difference_update(one.about)
        self._leave(over, swaying)
        return over

    def _ended(self, until_s: float | None = None) -> dict[int, Outcome]:
        """Return the outcomes of the actions that end next, by car, once their effects show; none before a time."""
        ended: dict[int, Outcome] = {}
        executor = self.executor
        fleet = self.executor.fleet
        left = fleet.late_periods
        most_s = math.inf
        if until_s is not None:
            most_s = until_s - self.physics.config.control_period_s / 2
        while left if ended else self.physics.time_s < most_s and (not fleet.lost or executor.busy):
            left -= bool(ended)
            newly = executor.advance()
            if newly:
                ended = ended | newly
                left = fleet.late_periods
        return ended

    def _begin(self, step: ScheduledAction, legal: bool = True) -> None:
        running = self._running
        if running and self._looked_s != self.physics.time_s:
            self._look()
        one = self._now(step, legal)
        for other in running.values():
            other.cars |= one.cars
            other.meant.update(one.about)
            one.meant.update(other.about)
        one.cars.update(running)
        if self.log is not None and running:
            self.log.begin_with(one.own)
        self._drift.strayed_m[step.car] = 0.0
        self._drift.path[step.car] = np.nan
        self.executor.begin(step.car, step.action, Terrain(*step.inclines, step.tight))
        running[step.car] = one

    def _now(self, step: ScheduledAction, legal: bool) -> Watched:
        reading = self.reading
        n_cars = self._n_cars
        about = [n_cars + index for index in handled(reading, step.after, step.car)]
        return Watched(
            step,
            legal,
            start_s=self.physics.time_s,
            capped_steps=self.physics.capped_steps,
            poses=self._rows.copy(),
            reading=reading,
            about=about,
            own=tuple(self._names[row] for row in (step.car, *about)),
            below=[n_cars + index for index in under(reading, step.after, step.car)],
            cars={step.car},
            meant=set(about),
        )

    def _look(self) -> None:
        self._looked_s = self.physics.time_s
        self._confirmed = None
        self.poses: Poses = self.physics.poses()
        self._rows: Floats = self.physics.data.qpos[self.physics.pose_places]
        self.reading: Reading = read_grid(self.poses, self.physics.size, self.physics.walls)

    def _settle(self) -> bool:
        for _ in range(round(SETTLE_S / self.physics.config.control_period_s)):
            if self._drift.speed_m_s() <= SETTLED_M_S or (self.log is not None and self.log.is_unsafe()):
                return True
            self.executor.advance()
        return self._drift.speed_m_s() <= SETTLED_M_S

    def _leave(self, over: Sequence[Watched], swaying: set[int]) -> None:
        """Take the present poses as the places of what ended actions handled, and of what has drifted too far.

        The latter has been reported, and does not count against later actions.
        """
        limits = self.thresholds
        drifted = (self._drift.furthest > (limits.bystander_m, limits.bystander_rad)).any(axis=1)
        left = set(np.flatnonzero(drifted).tolist()) - swaying
        self._drift.leave(left.union(*((one.step.car, *one.about) for one in over)))
        self._known = self._beyond()

    def _beyond(self) -> NDArray[np.bool_]:
        """Return (n, 2): which objects do not stand, or are not carried, as they should."""
        return ~(self.reading.bounded <= (self.thresholds.placed_m, self.thresholds.tilt_rad))

    def _measure(self, one: Watched, outcome: Outcome | None, acting: set[int], swaying: set[int]) -> None:
        step = one.step
        car = one.step.car
        log = self.log
        placed = self.reading.cars[car]
        things = [self.reading.objects[row - self._n_cars] for row in one.about]
        # What the car should not carry afterwards is set down, folded, unfolded or shoved.
        set_down = None
        if things and step.after.cars[car, CarField.LOAD] == Kind.AIR:
            set_down = things[0]
        loads = [thing.offset_m for thing in things if thing.carrier is not None]
        others, one.bystanders = self._bystanders(one, acting, swaying)
        one.outcome = outcome
        one.read = describe_car(self.grid, car)
        one.readable = not self.problems
        one.differences = tuple(own_differences(step.before, step.after, self.grid, car))
        one.errors = {
            "car_error_m": placed.offset_m,
            "heading_error_rad": abs(placed.heading_rad),
            "height_error_m": abs(placed.height_m),
            "tilt_error_rad": placed.tilt_rad,
            "placed_error_m": None if set_down is None else set_down.offset_m,
            "seat_error_m": max(loads, default=None),
            "thing_heading_rad": max((abs(thing.heading_rad) for thing in things), default=None),
            "thing_tilt_rad": max((max(thing.tilt_rad, thing.hinge_rad) for thing in things), default=None),
            "thing_height_m": max((abs(self._too_high_m(row)) for row in one.about), default=None),
            "reach_m": max((thing.reach_m for thing in things), default=None),
            **others,
        }
        if self.physics.uneven:
            one.strayed_m = float(self._drift.strayed_m[car])
        else:
            one.strayed_m = None
        one.capped_steps = self.physics.capped_steps - one.capped_steps
        if log is not None:
            names = self._names[self._n_cars :]
            one.contacts = unexpected_contacts(log.news(one.own), names, one.reading, step.after, one.cars)
            one.hazards = log.hazards()
            one.peak_force_n = log.peak_n

    def _too_high_m(self, row: int) -> float:
        """Return the height of a thing above the floor of its cell, or above its seat."""
        index = row - self._n_cars
        machines = self.physics.machines
        thing = self.reading.objects[index]
        if thing.carrier is None:
            return thing.height_m
        return thing.height_m - lift_m(self.poses.kinds[index], machines.car(thing.carrier), machines)

    def _bystanders(self, one: Watched, acting: set[int], swaying: set[int]) -> Bystanders:
        """Return the largest of each error of bystanders, and the bystander's name; what still sways is left out."""
        n_cars = self._n_cars
        rows = self._rows
        excused = acting | one.meant | swaying
        for reading in (one.reading, self.reading):
            excused.update(n_cars + i for i, thing in enumerate(reading.objects) if thing.carrier in acting)
        errors = np.zeros((len(rows), len(BYSTANDER_ERRORS)))
        errors[:, 2:4] = self._drift.furthest
        errors[:n_cars, 4:] = -math.inf
        errors[n_cars:, 4:] = np.where(self._known, -math.inf, self.reading.bounded)
        moved = set(np.flatnonzero((one.poses != rows).any(axis=1)).tolist()) - excused
        for row in moved:
            errors[row, :2] = _apart(one.poses[row].tolist(), rows[row].tolist())
        errors[list(excused)] = -math.inf
        largest = dict.fromkeys(BYSTANDER_ERRORS, 0.0)
        names = dict.fromkeys(BYSTANDER_ERRORS, "")
        worst = errors.argmax(axis=0)  # nan is the largest
        values = errors[worst, np.arange(len(worst))].tolist()
        for error, row, value in zip(BYSTANDER_ERRORS, worst.tolist(), values, strict=True):
            if value != -math.inf:
                largest[error], names[error] = value, self._names[row]
        return largest, names

    def _world_cause(self, before: Grid, predicted: Grid, gave_up: int) -> Cause:
        """Compare the reading with the prediction; ``gave_up`` counts physics steps without convergence."""
        if self.physics.diverged:
            return Cause("diverged", ("the simulation broke down and started over",))
        cause = compare(before, predicted, self.reading)
        if self.log is not None:
            hazards = tuple(text for _, text in self.log.hazards())
        else:
            hazards = ()
        if hazards:
            cause = Cause("unsafe", (*hazards, *cause.differences))
        elif not self._settled:
            moving = f"something still moves with {self._drift.speed_m_s() * 1e3:.0f} mm/s"
            cause = Cause("unsettled", (moving, *cause.differences))
        if self.log is not None:
            impossible = self.log.impossible
        else:
            impossible = ()
        if cause.finding != "agrees" and gave_up:
            impossible = (capped_text(gave_up), *impossible)
        if impossible:
            return Cause("numerics", (*impossible, *cause.differences))
        return cause

    def _cause(self, one: Watched, world: Cause | None, all_watched: Sequence[Watched]) -> Cause:
        """Return the cause of the verdict on one of many actions; ``world`` is None while others still run."""
        car = one.step.car
        action = one.step.action
        if one.outcome is None:
            why = f"car {car} waits for an action that failed"
            if not one.legal:
                why = f"the rules forbid it: {self.rules.explain(one.step.before, car, action).why}"
            return Cause("not executed", (why,))
        if world is not None:
            tried = [other for other in all_watched if other.legal or other.outcome is not None]
            nobodys = len(tried) == 1 or all(other.applied for other in tried)
            earlier = {"unsafe": not one.hazards, "unreadable": one.readable}.get(world.finding, False)
            if not earlier and (nobodys or world.finding in ("agrees", "unsafe", "numerics", "diverged")):
                return world
        if one.applied:
            return AGREES
        return Cause("wrong place", one.differences or (str(one.outcome),))
