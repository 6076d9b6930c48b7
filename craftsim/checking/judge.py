"""A PhysicsWorld whose every action is predicted by the rules, performed by skills, read from poses, and judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence, Set
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import (
    AGREES,
    Attempt,
    Cause,
    attempt_of,
    capped_text,
    compare_reading,
)
from craftsim.checking.contacts import (
    ContactLog,
    Drift,
    distances,
    handled,
    under,
    unexpected_contacts,
)
from craftsim.checking.measurements import MEASUREMENTS, Ending, sample_all
from craftsim.checking.seating import load_offset
from craftsim.checking.thresholds import thresholds_of
from craftsim.checking.watched import Watched
from craftsim.compiled.arrays import Floats
from craftsim.discrete.geometry import CELL_PITCH_M, INCLINE_RAD
from craftsim.discrete.grid import CarField, Grid, cell_of
from craftsim.discrete.kernel.claims import CHANGES
from craftsim.discrete.kinds import Action, TeamAction
from craftsim.discrete.readback import Poses, Reading, describe_car, own_differences, read_grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import (
    Concurrency,
    Constraints,
    Schedule,
    ScheduledAction,
    make_schedule,
)
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Outcome
from craftsim.skills.setup import Terrain
from craftsim.workers.copying import Copyable

SETTLED_M_S: Final = 0.01
"""Below this speed a thing is at rest: eight times the largest at the end of any good action."""
SETTLE_S: Final = 1.0
"""Time for things to come to rest after the last action, before the world is read."""

_HELD_AGAINST_ALL: Final = ("agrees", "unsafe", "numerics", "diverged")
"""Findings of the whole world that decide on every action, even where some action's own part is wrong."""

OnChange = Callable[[dict[int, ScheduledAction]], None]
"""Called with the running actions by car whenever one begins or ends."""


def _tell_nobody(_: dict[int, ScheduledAction]) -> None:
    """Do nothing when an action begins or ends."""


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
        watch_contacts: bool = True,
    ) -> None:
        """Read the start from poses.

        Args:
            executor: moves the cars; nothing else may command its PhysicsWorld.
            rules: for the predictions.
            watch_contacts: False saves the contact log, 3 % of the time; nothing is unsafe then.
        """
        self.executor = executor
        self.physics = executor.physics
        self.rules = rules
        self.thresholds = thresholds_of(self.physics.machines)
        self.on_change: OnChange = _tell_nobody
        if not watch_contacts:
            self.log = None
        else:
            self.log = ContactLog(self.physics)
        """Contacts since an action last began while no other ran; of a car and its things since its last beginning."""
        if self.log is not None:
            executor.observers.append(self.log.sample)
            executor.step_observer = self.log.look
            # Not a method of this object: a cycle would keep the whole simulation until garbage is collected.
            executor.guard = self.log.is_unsafe
        self._drift = Drift(self.physics)
        executor.observers.append(self._drift.look)
        self._confirmed: Grid | None = None
        """The confirmed world of the last reading, once it was asked for."""
        self.look()
        self._n_cars = len(self.physics.cars)
        self._names = [f"car {car}" for car in range(self._n_cars)]
        self._names += map(self.poses.name, range(len(self.poses.kinds)))
        self._reported = self._out_of_place()
        """(n, 2): objects that do not stand, or are not carried, as they should, and have been reported."""
        self._running: dict[int, Watched] = {}
        """By car, in the order in which they began."""
        self._stranded: dict[int, tuple[str, ...]] = {}
        """Lost cars and what their last actions handled, by name."""
        self._last: ScheduledAction
        """The action that last began by itself."""
        self._over: list[Watched] = []
        """Actions that have ended since then."""
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
        return {car: watched.step for car, watched in self._running.items()}

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
        size_x, size_y, size_z = grid.cells.shape[:3]
        for car, watched in self._running.items():
            start = watched.reading.grid
            grid.cars[car] = start.cars[car]
            for x, y, z, bits in watched.step.footprint.tolist():
                inside = 0 <= x < size_x and 0 <= y < size_y and 0 <= z < size_z
                if inside and bits & CHANGES:
                    grid.cells[x, y, z] = start.cells[x, y, z]
        grid.derive_marks()
        return grid

    @property
    def committed(self) -> Grid:
        """The confirmed world with the effects of what runs, in the order in which it began; decisions start here."""
        grid = self.confirmed
        for car, watched in self._running.items():
            grid = self.rules.enforce(grid, car, watched.step.action)
        return grid

    @property
    def problems(self) -> tuple[str, ...]:
        """Reasons why the world cannot be read as a grid any more, or its cars be driven.

        What running actions handle is left out, and lost cars with what their last actions handled.
        """
        problems = []
        if self.physics.diverged:
            problems.append("the simulation broke down")
        if self.executor.fleet.lost:
            problems.append(self.executor.fleet.lost)
        excused: list[str] = []
        for watched in self._running.values():
            excused += watched.names
        for names in self._stranded.values():
            excused += names
        beginnings = tuple(f"{name} " for name in excused)
        problems += [line for line in self.reading.problems if not line.startswith(beginnings)]
        return tuple(problems)

    def perform(
        self, car: int, action: Action, intended: Grid | None = None, tick: int = 0
    ) -> Attempt:
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
        ended = self._run(until_s)
        names: list[str] = []
        for watched in ended:
            names += watched.names
        self.handled = frozenset(names)
        if not ended:
            return ()
        self._over += ended
        self.on_change(self.running)
        world: Cause | None = None
        if not self._running:
            n_capped = max(watched.capped_steps for watched in self._over)
            world = self._world_cause(self._last.before, self._last.after, n_capped)
        return self._attempts(ended, world, self._over)

    def refuse(self, step: ScheduledAction) -> Attempt:
        """Return the attempt of an action that the rules forbid in ``step.before``. It is not performed."""
        watched = self._watched(step, legal=False)
        acting = set(self._running)
        for running in self._running.values():
            acting.update(running.handled)
        self._measure(watched, None, acting, set())
        return attempt_of(watched, self._cause(watched, None, ()), self.thresholds)

    def _perform(
        self, schedule: Schedule, legal: bool = True, halts: bool = False
    ) -> tuple[Attempt, ...]:
        """Perform a schedule; with ``halts`` nothing begins once an action has not ended as predicted."""
        start = self.grid
        capped_before = self.physics.capped_steps
        self._settled = True
        if schedule.steps:
            self._watch()
        ended, waiting = self._run_all(schedule.steps, legal, halts)

        unbegun = [self._watched(step, legal=True) for step in waiting]
        unbegun += [self._watched(step, legal=False) for step in schedule.forbidden]
        for watched in unbegun:
            self._measure(watched, None, set(), set())

        n_capped = self.physics.capped_steps - capped_before
        world = self._world_cause(start, schedule.final, n_capped)
        watched_actions = ended + unbegun
        attempts = self._attempts(watched_actions, world, watched_actions)
        place = {act: number for number, act in enumerate(schedule.acts)}
        return tuple(sorted(attempts, key=lambda attempt: place[attempt.tick, attempt.car]))

    def _run_all(
        self, steps: Sequence[ScheduledAction], legal: bool, halts: bool
    ) -> tuple[list[Watched], list[ScheduledAction]]:
        """Begin each action as soon as those it waits for have succeeded, and run until nothing runs.

        Return the actions that have ended, in the order of their endings, and those that never began.
        """
        index_of = {(step.tick, step.car): index for index, step in enumerate(steps)}
        waiting = list(steps)
        succeeded: set[int] = set()
        ended: list[Watched] = []
        while True:
            if not (halts and any(watched.stops_plan for watched in ended)):
                waiting = self._begin_ready(waiting, succeeded, legal)
            self.on_change(self.running)
            if not self._running:
                return ended, waiting
            for watched in self._run():
                ended.append(watched)
                if watched.outcome is not None and watched.outcome.succeeded:
                    succeeded.add(index_of[watched.step.tick, watched.step.car])

    def _begin_ready(
        self, waiting: Sequence[ScheduledAction], succeeded: Set[int], legal: bool
    ) -> list[ScheduledAction]:
        """Begin what waits for nothing any more, of cars that do not act; return what still waits."""
        still_waiting = []
        for step in waiting:
            if step.waits_for <= succeeded and step.car not in self._running:
                self._begin(step, legal)
            else:
                still_waiting.append(step)
        return still_waiting

    def _attempts(
        self, judged: Sequence[Watched], world: Cause | None, watched_actions: Sequence[Watched]
    ) -> tuple[Attempt, ...]:
        """Return an attempt for each of the ``judged`` actions, some or all of the watched ones."""
        attempts = []
        for watched in judged:
            cause = self._cause(watched, world, watched_actions)
            attempts.append(attempt_of(watched, cause, self.thresholds))
        return tuple(attempts)

    def _watch(self) -> None:
        self._drift.settle(slice(None))
        if self.log is not None:
            self.log.begin()

    def _run(self, until_s: float | None = None) -> list[Watched]:
        """Run to the next ending, or to a time, read the world, and return the measured actions that have ended."""
        outcomes = self._advance(until_s)
        if outcomes and len(outcomes) == len(self._running):
            self._settled = self._settle()
        self.look()
        if not outcomes:
            return []
        acting = set(self._running)
        ended = [self._running.pop(car) for car in outcomes]
        self._note_stranded(ended)
        self._accept_sway(ended)
        swaying = set(_rows_below(self._running.values()))
        for watched in ended:
            self._measure(watched, outcomes[watched.step.car], acting, swaying)
            self._accept_motion(watched)
        self._leave(ended, swaying)
        return ended

    def _advance(self, until_s: float | None) -> dict[int, Outcome]:
        """Run until actions end and their effects show, or to a time; return the outcomes by car."""
        fleet = self.executor.fleet
        half_s = self.physics.config.control_period_s / 2
        outcomes: dict[int, Outcome] = {}
        while not outcomes:
            if until_s is not None and self.physics.time_s >= until_s - half_s:
                return {}
            if fleet.lost and not self.executor.busy:
                return {}
            outcomes = self.executor.advance()
        # A fleet may show effects some periods late; what ends in these belongs to the same ending.
        periods_left = fleet.late_periods
        while periods_left:
            periods_left -= 1
            newly_ended = self.executor.advance()
            if newly_ended:
                outcomes = outcomes | newly_ended
                periods_left = fleet.late_periods
        return outcomes

    def _note_stranded(self, ended: Iterable[Watched]) -> None:
        """Remember what lost cars handled last."""
        for watched in ended:
            if watched.step.car in self.executor.fleet.lost_cars:
                self._stranded[watched.step.car] = watched.names

    def _accept_sway(self, ended: Sequence[Watched]) -> None:
        """Take the present poses of what stands below the cars of ended actions, for all other actions.

        A stack that swayed under a car has to be back at the end of that car's action, and of no other: actions that
        began meanwhile saw it elsewhere. The flap of a slope gives way to a car that drives on it: it need not lie flat
        on an uneven floor.
        """
        self._drift.leave_hinges(_rows_below(ended))
        for watched in ended:
            for other_action in (*ended, *self._running.values()):
                if other_action is not watched:
                    other_action.poses[watched.below] = self._rows[watched.below]

    def _accept_motion(self, ended: Watched) -> None:
        """Hold it against what still runs, from now on, if the car of an ended action or what it handled moves."""
        rows = [ended.step.car, *ended.handled]
        for running in self._running.values():
            running.poses[rows] = self._rows[rows]
            running.movable.difference_update(ended.handled)

    def _begin(self, step: ScheduledAction, legal: bool = True) -> None:
        if self._running and self._looked_s != self.physics.time_s:
            self.look()
        watched = self._watched(step, legal)
        for running in self._running.values():
            running.cars |= watched.cars
            running.movable.update(watched.handled)
            watched.movable.update(running.handled)
        watched.cars.update(self._running)
        if self.log is not None:
            self.log.begin_with(watched.names)
        self._follow(watched)
        terrain = Terrain(*step.inclines, step.tight)
        if self.executor.recovers:
            terrain = replace(terrain, free_side=step.free_side)
        if step.action is Action.LIFT and self.executor.recovers and watched.handled:
            index = watched.handled[0] - self._n_cars
            terrain = replace(terrain, load_offset=load_offset(self.poses, self.reading, index))
        self.executor.begin(step.car, step.action, terrain)
        self._running[step.car] = watched

    def _follow(self, watched: Watched) -> None:
        """Watch the car of an action on its way."""
        step = watched.step
        steepest_rad = 0.0
        for grid in (step.before, step.after):
            if grid.cars[step.car, CarField.SLOPE]:
                steepest_rad = INCLINE_RAD
        start = cell_of(step.before, step.car)
        end = cell_of(step.after, step.car)
        for row in watched.handled:
            fit = self.reading.objects[row - self._n_cars]
            if fit.carrier is None and fit.cell == end:
                # It pushes that into the next cell before it comes back.
                end = 2 * end[0] - start[0], 2 * end[1] - start[1], end[2]
                break
        self._drift.follow(step.car, start, end, steepest_rad)

    def _watched(self, step: ScheduledAction, legal: bool) -> Watched:
        """Return an action as it begins in the world that was read last."""
        n_cars = self._n_cars
        rows = [n_cars + index for index in handled(self.reading, step.after, step.car)]
        return Watched(
            step,
            legal,
            start_s=self.physics.time_s,
            capped_before=self.physics.capped_steps,
            poses=self._rows.copy(),
            reading=self.reading,
            handled=rows,
            names=tuple(self._names[row] for row in (step.car, *rows)),
            below=[n_cars + index for index in under(self.reading, step.after, step.car)],
            cars={step.car},
            movable=set(rows),
        )

    def look(self) -> None:
        """Read the world as it is now."""
        self._looked_s = self.physics.time_s
        self._confirmed = None
        self.poses: Poses = self.physics.poses()
        self._rows: Floats = self.physics.data.qpos[self.physics.pose_places]
        self.reading: Reading = read_grid(self.poses, self.physics.size, self.physics.walls)

    def take_over(self, judge: Judge) -> None:
        """Take over from a judge of the same PhysicsWorld where things were left, and what has been reported.

        What has been put into another cell since that judge looked, or was in the middle of an action, stands where it
        was left.
        """
        self._drift.take_over(judge._drift)
        moved = distances(judge.poses, self.poses)
        put_rows = set(
            np.flatnonzero((moved > (CELL_PITCH_M / 2, math.pi / 4)).any(axis=1)).tolist()
        )
        for watched in judge._running.values():
            put_rows.update((watched.step.car, *watched.handled))
        self._drift.leave(put_rows)
        is_put = np.isin(np.arange(self._n_cars, len(self._rows)), list(put_rows))
        self._reported[~is_put] = judge._reported[~is_put]

    def _settle(self) -> bool:
        for _ in range(round(SETTLE_S / self.physics.config.control_period_s)):
            if self._drift.speed_m_s() <= SETTLED_M_S or (
                self.log is not None and self.log.is_unsafe()
            ):
                return True
            self.executor.advance()
        return self._drift.speed_m_s() <= SETTLED_M_S

    def _leave(self, ended: Sequence[Watched], swaying: Set[int]) -> None:
        """Take the present poses as the places of what ended actions handled, and of what has drifted too far.

        The latter has been reported, and does not count against later actions.
        """
        drifted = (self._drift.furthest > self._limits("drift_m", "drift_rad")).any(axis=1)
        rows = set(np.flatnonzero(drifted).tolist()) - swaying
        for watched in ended:
            rows.add(watched.step.car)
            rows.update(watched.handled)
        self._drift.leave(rows)
        self._reported = self._out_of_place()

    def _out_of_place(self) -> NDArray[np.bool_]:
        """Return (n, 2): which objects do not stand, or are not carried, as they should."""
        limits = self._limits("bystander_reach_m", "bystander_tilt_rad")
        return ~(self.reading.bounded <= limits)

    def _limits(self, *names: str) -> list[float]:
        """Return the limits of these measurements."""
        return [MEASUREMENTS[name].limit_in(self.thresholds) for name in names]

    def _measure(
        self, watched: Watched, outcome: Outcome | None, acting: Set[int], swaying: Set[int]
    ) -> None:
        """Complete a watched action with the measurements at its end; what sways then is no bystander of it."""
        step = watched.step
        watched.outcome = outcome
        watched.read = describe_car(self.grid, step.car)
        watched.readable = not self.problems
        watched.differences = tuple(own_differences(step.before, step.after, self.grid, step.car))
        excused = acting | watched.movable | swaying | self._loads_of(acting, watched.reading)
        if self.log is not None:
            object_names = self._names[self._n_cars :]
            contacts = self.log.news(watched.names)
            watched.contacts = unexpected_contacts(
                contacts, object_names, watched.reading, self.reading, step.after, watched.cars
            )
            watched.hazards = self.log.hazards()
        ending = self._ending_of(watched, excused)
        watched.measured, watched.bystanders = sample_all(ending, self._names)

    def _ending_of(self, watched: Watched, excused: Set[int]) -> Ending:
        """Return an action and the world as it was read last; ``excused`` are the rows of what is no bystander."""
        boards_m = [self.physics.data.qpos[car.board.qpos] for car in self.physics.cars]
        way = self._drift.ways[watched.step.car]
        peak_force_n = 0.0
        if self.log is not None:
            peak_force_n = self.log.peak_n
        return Ending(
            action=watched,
            machines=self.physics.machines,
            poses=self.poses,
            rows=self._rows,
            boards_m=np.array(boards_m),
            reading=self.reading,
            furthest=self._drift.furthest,
            way_m=float(way["away_m"]),
            way_lean_rad=float(way["lean_rad"]),
            reported=self._reported,
            excused=excused,
            capped_steps=self.physics.capped_steps,
            peak_force_n=peak_force_n,
        )

    def _loads_of(self, cars: Set[int], start: Reading) -> set[int]:
        """Return the rows of the objects that these cars carry now, or carried at the start."""
        rows = set()
        for reading in (start, self.reading):
            for index, fit in enumerate(reading.objects):
                if fit.carrier in cars:
                    rows.add(self._n_cars + index)
        return rows

    def _world_cause(self, start: Grid, predicted: Grid, n_capped: int) -> Cause:
        """Compare the reading with the prediction; ``n_capped`` counts physics steps without convergence."""
        if self.physics.diverged:
            return Cause("diverged", ("the simulation broke down and started over",))
        hazards: tuple[str, ...] = ()
        impossible: tuple[str, ...] = ()
        if self.log is not None:
            hazards = tuple(text for _, text in self.log.hazards())
            impossible = self.log.impossible
        cause = compare_reading(start, predicted, self.reading)
        if hazards:
            cause = Cause("unsafe", (*hazards, *cause.differences))
        elif not self._settled:
            moving = f"something still moves with {self._drift.speed_m_s() * 1e3:.0f} mm/s"
            cause = Cause("unsettled", (moving, *cause.differences))
        if cause.finding != "agrees" and n_capped:
            impossible = (capped_text(n_capped), *impossible)
        if impossible:
            return Cause("numerics", (*impossible, *cause.differences))
        return cause

    def _cause(
        self, watched: Watched, world: Cause | None, watched_actions: Sequence[Watched]
    ) -> Cause:
        """Return the cause of the verdict on one of many actions; ``world`` is None while others still run."""
        car = watched.step.car
        if watched.outcome is None:
            reason = f"car {car} waits for an action that failed"
            if not watched.legal:
                explanation = self.rules.explain(watched.step.before, car, watched.step.action)
                reason = f"the rules forbid it: {explanation.why}"
            return Cause("not executed", (reason,))
        if world is not None and _is_held_against(watched, world, watched_actions):
            return world
        if watched.applied:
            return AGREES
        return Cause("wrong place", watched.differences or (str(watched.outcome),))


def _rows_below(actions: Iterable[Watched]) -> list[int]:
    """Return the rows of the objects below the cars of these actions."""
    rows = []
    for watched in actions:
        rows += watched.below
    return rows


def _is_held_against(watched: Watched, world: Cause, watched_actions: Sequence[Watched]) -> bool:
    """Return whether what is wrong with the whole world is held against a performed action."""
    if world.finding == "unsafe" and not watched.hazards:
        return False
    if world.finding == "unreadable" and watched.readable:
        return False
    if world.finding in _HELD_AGAINST_ALL:
        return True
    tried = [action for action in watched_actions if action.legal or action.outcome is not None]
    return len(tried) == 1 or all(action.applied for action in tried)
