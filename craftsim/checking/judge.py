"""A PhysicsWorld whose every action is predicted by the rules, performed by skills, read from poses, and judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import (
    AGREES,
    BOUNDED_ERRORS,
    Attempt,
    Cause,
    Thresholds,
    Watched,
    attempt_of,
    capped_text,
    compare,
)
from craftsim.checking.contacts import ContactLog, handled, under, unexpected_contacts
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.kernel.jit import compiled, plain
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import (
    PLACE_TOLERANCE_M,
    Poses,
    Reading,
    describe_car,
    own_differences,
    read_grid,
)
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Concurrency, Constraints, Schedule, ScheduledAction, make_schedule
from craftsim.models.composition import lift_m
from craftsim.models.measuring import Floats, PoseReader
from craftsim.models.world import PhysicsWorld
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Outcome
from craftsim.skills.skill import Terrain

SETTLED_M_S: Final = 0.01
"""Below this speed a thing counts as at rest: eight times what was seen at the end of any good action."""
SETTLE_S: Final = 1.0
"""How long what still moves when nothing is commanded may take to come to rest before the world is read."""

Integers = NDArray[np.integer]
Joint = Sequence[tuple[int, Action]]
"""(car, action) in acting order."""
OnChange = Callable[[dict[int, ScheduledAction]], None]
"""Called with the running actions by car whenever one begins or ends."""


_BYSTANDERS: Final = [one.field for one in BOUNDED_ERRORS if one.of_bystanders]
"""Errors of what an action does not concern; the last two are those of the reading."""


class Judge:
    """The one judge: performs actions on a PhysicsWorld and returns an :class:`Attempt` for each.

    Everything ends as soon as something unsafe happens: all motors stop, and the world is read as it is then. Each
    prediction starts from what was read last.

    Whole plans are performed as schedules. Actions may also begin one by one while others run: :meth:`begin` starts
    one, and :meth:`next` runs to the next ending.
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
            rules: predict.
            thresholds: limits of the errors; the default ones unless given.
            watch_contacts: False saves the contact log, 3 % of the time; then nothing is found to be unsafe.
        """
        self.executor, self.physics, self.rules = executor, executor.physics, rules
        self.thresholds = thresholds or Thresholds()
        self.on_change: OnChange = lambda running: None
        self.log = ContactLog(self.physics, self.thresholds.force) if watch_contacts else None
        """Since an action last began while no other ran; of a car and its things since its own last action began."""
        if self.log is not None:
            executor.observers.append(self.log.sample)
            executor.step_observer = self.log.look
            # Not a method of this object: a cycle would keep the whole simulation until garbage is collected.
            executor.guard = self.log.is_unsafe
        self._poses = PoseReader(self.physics)
        self._drift = Drift(self.physics, self._poses.places)
        executor.observers.append(self._drift.look)
        if self.physics.uneven:
            drift = self._drift
            executor.observers.append(lambda _: drift.stray(executor.paths()))
        self._look()
        self._n_cars = len(self.physics.cars)
        self._names = [f"car {car}" for car in range(self._n_cars)]
        self._names += map(self.poses.name, range(len(self.poses.kinds)))
        self._known = self._beyond()
        """(n, 2): which objects are not as they should stand or be carried, and have been reported so."""
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

        Their cars, and the cells of their footprints' ``changes``, are as they were when they began.
        """
        if not self._running:
            return self.grid
        grid = self.grid.copy()
        for car, one in self._running.items():
            began = one.reading.grid
            grid.cars[car] = began.cars[car]
            for cell in one.step.footprint.changes:
                if all(0 <= at < n for at, n in zip(cell, grid.cells.shape, strict=False)):
                    grid.cells[cell] = began.cells[cell]
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
        handled += [f"{name} " for names in self._stranded.values() for name in names]
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

    def begin(self, step: ScheduledAction) -> None:
        """Start one action of a car that has none, while others may run; :meth:`next` runs it.

        ``step.before`` is :attr:`committed`, with which :func:`craftsim.discrete.schedule.make_schedule` makes it.
        """
        if not self._running:
            self._watch()
        self._last, self._over = step, []
        self._begin(step)
        self.on_change(self.running)

    def next(self, until_s: float | None = None) -> tuple[Attempt, ...]:
        """Run to the next ending and return the attempts of all that ended then; with none, to a time.

        An action is judged by its own part of the world; what else is otherwise than predicted is seen where nothing
        runs any more, and held against what has ended since an action last began.

        Args:
            until_s: simulated time to which this runs at most; without one, something must run.
        """
        assert self._running or until_s is not None, "nothing runs"
        if not self._running:
            self.executor.fleet.attend()
        over = self._run(until_s)
        if not over:
            return ()
        self._over += over
        self.on_change(self.running)
        world: Cause | None = None
        if not self._running:
            gave_up = max(one.capped_steps for one in self._over)
            world = self._world_cause(self._last.before, self._last.after, gave_up)
        return tuple(attempt_of(one, self._cause(one, world, self._over), self.thresholds) for one in over)

    def _perform(self, schedule: Schedule, legal: bool = True, halts: bool = False) -> tuple[Attempt, ...]:
        before, steps, capped = self.grid, schedule.steps, self.physics.capped_steps
        waiting = dict(enumerate(steps))
        found: list[Watched] = []
        self._settled = True
        if steps:
            self._watch()
        while True:
            done = {one.index for one in found if one.outcome and one.outcome.succeeded}
            halted = halts and any(map(_is_wrong, found))
            for index, step in [] if halted else list(waiting.items()):
                if step.waits_for <= done and step.car not in self._running:
                    self._begin(waiting.pop(index), index, legal)
            self.on_change(self.running)
            if not self._running:
                break
            found += self._run()
        found += [self._unbegun(step, True) for step in waiting.values()]
        found += [self._unbegun(step, False) for step in schedule.forbidden]
        world = self._world_cause(before, schedule.final, self.physics.capped_steps - capped)
        attempts = [attempt_of(one, self._cause(one, world, found), self.thresholds) for one in found]
        place = {act: number for number, act in enumerate(schedule.acts)}
        return tuple(sorted(attempts, key=lambda a: place[a.tick, a.car]))

    def _watch(self) -> None:
        """From here on look at what moves, touches, tips and falls."""
        self._drift.settle(slice(None))
        if self.log is not None:
            self.log.begin()

    def _run(self, until_s: float | None = None) -> list[Watched]:
        """Run to the next ending, or to a time, read the world, and return what has ended with what it did."""
        running, ended = self._running, self._ended(until_s)
        if ended and len(ended) == len(running):
            self._settled = self._settle()
        self._look()
        if not ended:
            return []
        acting = set(running)
        over = [running.pop(car) for car in ended]
        lost_cars = self.executor.fleet.lost_cars
        self._stranded |= {one.step.car: one.own for one in over if one.step.car in lost_cars}
        swaying = {index for one in running.values() for index in one.below}
        # What swayed under a car is back once that has ended, or else that car's action is held responsible;
        # actions that began meanwhile saw it elsewhere.
        self._drift.settle([self._n_cars + index for one in over for index in one.below])
        for one in over:
            rows = [self._n_cars + index for index in one.below]
            for other in (*over, *running.values()):
                if other is not one:
                    other.poses[rows] = self._rows[rows]
        for one in over:
            self._measure(one, ended[one.step.car], acting, swaying)
            for other in running.values():
                self._expect_rest(other, one)
        self._leave(over, swaying)
        return over

    def _ended(self, until_s: float | None = None) -> dict[int, Outcome]:
        """Return the outcomes of the actions that end next, by car, once what their cars did can be seen.

        None where a time comes first.
        """
        ended: dict[int, Outcome] = {}
        executor, fleet = self.executor, self.executor.fleet
        left, most_s = fleet.late_periods, math.inf
        if until_s is not None:
            most_s = until_s - self.physics.config.control_period_s / 2
        while left if ended else self.physics.time_s < most_s and (executor.busy or not fleet.lost):
            left -= bool(ended)
            newly = executor.advance()
            if newly:
                ended, left = ended | newly, fleet.late_periods
        return ended

    def _begin(self, step: ScheduledAction, index: int = -1, legal: bool = True) -> None:
        running = self._running
        if running and self._looked_s != self.physics.time_s:
            self._look()
        one = self._now(step, index)
        one.legal = legal
        for other in running.values():
            other.cars |= one.cars
            other.meant.update(one.about)
            one.meant.update(other.about)
        one.cars.update(running)
        if self.log is not None and running:
            self.log.begin_with(one.own)
        self._drift.begin(step.car)
        self.executor.begin(step.car, step.action, Terrain(*step.inclines, step.tight))
        running[step.car] = one

    def _now(self, step: ScheduledAction, index: int = -1) -> Watched:
        about, physics = handled(self.reading, step.after, step.car), self.physics
        names = self._names
        return Watched(
            *(index, step, physics.time_s, physics.capped_steps, self._rows.copy(), self.reading, about),
            (names[step.car], *(names[len(physics.cars) + index] for index in about)),
            *(set(under(self.reading, step.after, step.car)), {step.car}, set(about)),
        )

    def _unbegun(self, step: ScheduledAction, legal: bool) -> Watched:
        """Return an action that was never begun, as it would be judged now."""
        one = self._now(step)
        one.legal = legal
        self._measure(one, None, set(), set())
        return one

    def _expect_rest(self, one: Watched, ended: Watched) -> None:
        """From here on hold it against an action if what one that has ended was about moves."""
        rows = [ended.step.car, *(self._n_cars + index for index in ended.about)]
        one.poses[rows] = self._rows[rows]
        one.meant.difference_update(ended.about)

    def _look(self) -> None:
        self._looked_s = self.physics.time_s
        self.poses: Poses = self._poses.read()
        self._rows = self._drift.poses()
        self.reading: Reading = read_grid(self.poses, self.physics.size, self.physics.walls)

    def _settle(self) -> bool:
        """Wait for what still moves, unless it is unsafe, and return whether it has come to rest."""
        for _ in range(round(SETTLE_S / self.physics.config.control_period_s)):
            if self._drift.speed_m_s() <= SETTLED_M_S or (self.log is not None and self.log.is_unsafe()):
                return True
            self.executor.advance()
        return self._drift.speed_m_s() <= SETTLED_M_S

    def _leave(self, over: Sequence[Watched], swaying: set[int]) -> None:
        """Hold what ended actions handled against where it is now, and what is too far from its place as well.

        The latter has been reported, and is held against no later action again.
        """
        n_cars, limits = self._n_cars, self.thresholds
        drifted = (self._drift.furthest > (limits.bystander_m, limits.bystander_rad)).any(axis=1)
        left = set(np.flatnonzero(drifted).tolist()) - {n_cars + index for index in swaying}
        left.update(one.step.car for one in over)
        left.update(n_cars + index for one in over for index in one.about)
        self._drift.leave(sorted(left))
        self._known = self._beyond()

    def _beyond(self) -> NDArray[np.bool_]:
        """Return (n, 2): which objects are not as they should stand or be carried."""
        return ~(self.reading.bounded <= (self.thresholds.placed_m, self.thresholds.tilt_rad))

    def _measure(self, one: Watched, outcome: Outcome | None, acting: set[int], swaying: set[int]) -> None:
        """Measure what an action has done, at its end."""
        step, car, log = one.step, one.step.car, self.log
        placed, about, objects = self.reading.cars[car], one.about, self.reading.objects
        # What the car should not carry afterwards is set down, folded, unfolded or shoved.
        set_down = about[0] if about and step.after.cars[car, CarField.LOAD] == Kind.AIR else None
        things = [objects[index] for index in about]
        loads = [thing.offset_m for thing in things if thing.carrier is not None]
        others, one.bystanders = self._bystanders(one, acting, swaying)
        one.outcome, one.read = outcome, describe_car(self.grid, car)
        one.differences = tuple(own_differences(step.before, step.after, self.grid, car))
        one.errors = {
            "car_error_m": placed.offset_m,
            "heading_error_rad": abs(placed.heading_rad),
            "height_error_m": abs(placed.height_m),
            "tilt_error_rad": placed.tilt_rad,
            "placed_error_m": None if set_down is None else objects[set_down].offset_m,
            "seat_error_m": max(loads, default=None),
            "thing_heading_rad": max((abs(thing.heading_rad) for thing in things), default=None),
            "thing_tilt_rad": max((max(thing.tilt_rad, thing.hinge_rad) for thing in things), default=None),
            "thing_height_m": max((abs(self._too_high_m(index)) for index in about), default=None),
            "reach_m": max((thing.reach_m for thing in things), default=None),
            **others,
        }
        one.strayed_m = self._drift.strayed_m(car) if self.physics.uneven else None
        one.capped_steps = self.physics.capped_steps - one.capped_steps
        if log is not None:
            names = self._names[self._n_cars :]
            one.contacts = unexpected_contacts(log.news(one.own), names, one.reading, step.after, one.cars)
            one.hazards, one.peak_force_n = log.hazards(), log.peak_n

    def _too_high_m(self, index: int) -> float:
        """Return how much higher a thing stands than the floor of its cell, or is carried than on its seat."""
        thing = self.reading.objects[index]
        if thing.carrier is None:
            return thing.height_m
        machines = self.physics.machines
        return thing.height_m - lift_m(self.poses.kinds[index], machines.car(thing.carrier), machines)

    def _bystanders(
        self, one: Watched, acting: set[int], swaying: set[int]
    ) -> tuple[dict[str, float], dict[str, str]]:
        """Return the largest of each error of what an action does not concern, and the name of what has it, by field.

        What sways under a car that still drives is held against that car's action at its end.
        """
        n_cars = self._n_cars
        excused = np.zeros(len(self._rows), np.bool_)
        excused[list(acting)] = True
        excused[[n_cars + index for index in one.meant | swaying]] = True
        for reading in (one.reading, self.reading):
            excused[[n_cars + i for i, thing in enumerate(reading.objects) if thing.carrier in acting]] = True
        largest = np.zeros((len(_BYSTANDERS), 2))
        _largest_errors(
            *(self._rows, one.poses, self._drift.furthest, self.reading.bounded),
            *(excused, self._known, largest),
        )
        values, at = largest[:, 0].tolist(), largest[:, 1].astype(np.intp).tolist()
        names = (self._names[row] if row >= 0 else "" for row in at)
        return dict(zip(_BYSTANDERS, values, strict=True)), dict(zip(_BYSTANDERS, names, strict=True))

    def _world_cause(self, before: Grid, predicted: Grid, gave_up: int) -> Cause:
        """Compare the reading with the prediction; what is worse than a difference comes first.

        ``gave_up`` counts the physics steps in between in which the solver gave up.
        """
        if self.physics.diverged:
            return "diverged", ("the simulation broke down and started over",)
        cause = compare(before, predicted, self.reading)
        hazards = () if self.log is None else tuple(text for _, text in self.log.hazards())
        if hazards:
            cause = "unsafe", (*hazards, *cause[1])
        elif not self._settled:
            moving = f"something still moves with {self._drift.speed_m_s() * 1e3:.0f} mm/s"
            cause = "unsettled", (moving, *cause[1])
        impossible = () if self.log is None else self.log.impossible
        if cause[0] != "agrees" and gave_up:
            impossible = (capped_text(gave_up), *impossible)
        return ("numerics", (*impossible, *cause[1])) if impossible else cause

    def _cause(self, one: Watched, world: Cause | None, all_watched: Sequence[Watched]) -> Cause:
        """Return what the verdict on one of many actions rests on; ``world`` is None while others still run."""
        car, action = one.step.car, one.step.action
        if one.outcome is None:
            why = f"car {car} waits for an action that failed"
            if not one.legal:
                why = f"the rules forbid it: {self.rules.explain(one.step.before, car, action).why}"
            return "not executed", (why,)
        if world is not None:
            tried = [other for other in all_watched if other.legal or other.outcome is not None]
            nobodys = len(tried) == 1 or all(other.applied for other in tried)
            if nobodys or world[0] in ("agrees", "unsafe", "numerics", "diverged"):
                return world
        return AGREES if one.applied else ("wrong place", one.differences or (str(one.outcome),))


class Drift:
    """How far cars and things are from the places where they should stand still, and driving cars from their paths.

    Machines are numbered as poses are: cars by id, then objects. A place is that of the start, or the one at which
    :meth:`leave` was called last; many small movements add up against it. What moves away and comes back counts as
    well: it is looked at after each control period.
    """

    def __init__(self, physics: PhysicsWorld, places: NDArray[np.intp]) -> None:
        """Take the places where everything is now; ``places`` says where their poses, (n, 7), lie in qpos."""
        self._qpos, self._qvel = physics.data.qpos, physics.data.qvel
        self._places, self._starts = places, places[:, 0].copy()
        joints = [int(np.flatnonzero(physics.model.jnt_qposadr == start)[0]) for start in self._starts]
        self._speeds = physics.model.jnt_dofadr[joints].astype(np.intp)[:, None] + np.arange(3)
        self._left, self.furthest = np.zeros((len(places), 7)), np.zeros((len(places), 2))
        """By how many metres, and by what angle in radians, each has been away from its place at most: that of the
        one rotation that leads there."""
        n_cars = len(physics.cars)
        self._strayed, self._path = np.zeros(n_cars), np.full((n_cars, 2), np.nan)
        self.leave(range(len(places)))

    def poses(self) -> Floats:
        """Return (n, 7): where everything is now."""
        found: Floats = self._qpos[self._places]
        return found

    def speed_m_s(self) -> float:
        """Return how fast the fastest machine moves now."""
        velocity = self._qvel[self._speeds]
        return float(np.sqrt((velocity * velocity).sum(axis=1).max(initial=0.0)))

    def leave(self, machines: Iterable[int]) -> None:
        """From here on hold these against where they are now."""
        rows = list(machines)
        self._left[rows] = self._qpos[self._places[rows]]
        self.furthest[rows] = 0.0

    def settle(self, machines: slice | list[int]) -> None:
        """Forget how far these have been from their places: of what was meanwhile only where it ends counts."""
        self.furthest[machines] = 0.0
        self.look()

    def look(self, _: PhysicsWorld | None = None) -> None:
        """Note how far everything is from its place; call it after each control period."""
        _note_away(self._qpos, self._starts, self._left, self.furthest)

    def begin(self, car: int) -> None:
        """Forget how far a car was beside its path: its next action begins."""
        self._strayed[car], self._path[car] = 0.0, np.nan

    def strayed_m(self, car: int) -> float:
        """Return the furthest that a car was beside its path since its action began, in metres."""
        return float(self._strayed[car])

    def stray(self, paths: Floats) -> None:
        """Note how far each driving car is from its path, (n, 3) as of an executor; call it after each control period.

        A car is a little behind where it should be by now, so it is held against the last piece of its way.
        """
        path, start = paths[:, :2], self._path
        at = self._qpos[self._places[: len(path), :2]]
        way = path - start
        length = np.maximum((way * way).sum(axis=1), 1e-12)
        share = np.clip(((at - start) * way).sum(axis=1) / length, 0.0, 1.0)
        beside = np.hypot(*(at - start - share[:, None] * way).T)
        self._strayed = np.fmax(self._strayed, beside)
        self._path = path


@compiled
def _note_away(qpos: Floats, places: Integers, left: Floats, furthest: Floats) -> None:
    """Note how far each machine, its free joint in qpos at ``places``, is from the pose where it was left."""
    for i in range(len(places)):
        pose = qpos[places[i] : places[i] + 7]
        furthest[i, 0] = max(furthest[i, 0], _apart(pose, left[i]))
        furthest[i, 1] = max(furthest[i, 1], _turned(pose, left[i]))


@compiled
def _apart(one: Floats, other: Floats) -> float:
    """Return how many metres are between two poses (7,)."""
    x, y, z = one[0] - other[0], one[1] - other[1], one[2] - other[2]
    return math.sqrt(x * x + y * y + z * z)


@compiled
def _turned(one: Floats, other: Floats) -> float:
    """Return the angle in radians between the unit quaternions of two poses (7,); exact for small ones."""
    a, b, c, d = one[3], one[4], one[5], one[6]
    e, f, g, h = other[3], other[4], other[5], other[6]
    w = a * e + b * f + c * g + d * h
    x = a * f - b * e - c * h + d * g
    y = a * g - c * e - d * f + b * h
    z = a * h - d * e - b * g + c * f
    return 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))


@plain
def _largest_errors(
    now: Floats,
    then: Floats,
    furthest: Floats,
    bounded: Floats,
    excused: NDArray[np.bool_],
    known: NDArray[np.bool_],
    largest: Floats,
) -> None:
    """Find the largest of each error of bystanders, once an action.

    ``now`` and ``then`` (n, 7) are poses of cars and objects at the end and the start of the action, ``furthest``
    (n, 2) that of :class:`Drift`, ``bounded`` (n_objects, 2) that of the reading; ``known`` (n_objects, 2) of these
    were reported before. ``largest`` (6, 2) takes each error and the machine that has it, -1 for none; nan is largest.
    """
    n_cars = len(now) - len(bounded)
    for k in range(6):
        largest[k, 0], largest[k, 1] = 0.0, -1.0
    for i in range(len(now)):
        if excused[i]:
            continue
        for k in range(6):
            if k >= 4 and (i < n_cars or known[i - n_cars, k - 4]):
                continue
            if k == 0:
                error = _apart(now[i], then[i])
            elif k == 1:
                error = _turned(then[i], now[i])
            elif k < 4:
                error = furthest[i, k - 2]
            else:
                error = bounded[i - n_cars, k - 4]
            best = largest[k, 0]
            if largest[k, 1] < 0 or error > best or (math.isnan(error) and not math.isnan(best)):
                largest[k, 0], largest[k, 1] = error, i


def _is_wrong(found: Watched) -> bool:
    """Return whether the world is not as an action should leave it, for any car that goes on in it."""
    return not found.applied or bool(found.errors["bystander_displacement_m"] > PLACE_TOLERANCE_M)
