"""Views in the browser: of physics worlds while they run (an observer), and of recorded runs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Final, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import SAME_TIME_S, Attempt
from craftsim.checking.judge import Judge
from craftsim.discrete.grid import Cell, Kind
from craftsim.discrete.schedule import ScheduledAction
from craftsim.errors import InputError, suggestion
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.trajectory import Trajectory
from craftsim.rendering.viewer import VIEWER_HOST, VIEWER_PORT, need_viser
from craftsim.rendering.viewer.page import AS_IT_GOES, FRAMES_HZ, SPEEDS, Moment, ViewerPage
from craftsim.rendering.viewer.scene import MARK
from craftsim.workers.copying import NotCopyable, OfOneProcess

_WHOLE: Final = (Kind.BLOCK, Kind.FSLOPE)  # what of a building fills its cell


class LiveView(OfOneProcess):
    """Shows a PhysicsWorld in the browser; an observer, to be called after every control period.

    It looks, and changes nothing. People may pause what runs, and slow it down.

    Example:
        >>> import craftsim
        >>> physics = craftsim.PhysicsWorld(craftsim.Grid.empty((3, 1, 1), n_cars=1))
        >>> with craftsim.LiveView(port=0) as view:
        ...     outcome = craftsim.Executor(physics, observer=view).run({0: craftsim.Action.ROTATE_LEFT})
        >>> view.address.startswith("http://127.0.0.1:")
        True
    """

    _instead = "open another one, or copy what it shows before it is shown"

    def __init__(
        self, host: str = VIEWER_HOST, port: int = VIEWER_PORT, speed: str = AS_IT_GOES
    ) -> None:
        """Open a page for browsers.

        Args:
            host: address to listen on; other machines reach only what is not the loopback address.
            port: of that address; 0 takes one that is free.
            speed: the page's choice of the speed at first: ``as it goes``, ``1 x`` and so on.

        Raises InputError where viser is missing, for a speed that there is not, and for an address or a port that
        cannot be had.
        """
        need_viser()
        if speed not in SPEEDS:
            raise InputError(
                f"there is no speed '{speed}'{suggestion(speed, SPEEDS)}; there are {', '.join(SPEEDS)}"
            )
        from craftsim.rendering.viewer.server import LocalServer

        server = LocalServer(host, port)
        self._open = ExitStack()
        self._open.callback(server.stop)
        self.address = server.address
        """Address to type into a browser on this machine."""
        self.page = ViewerPage(server, speed)
        self.page.controls = {"toggle": self.toggle}
        self._physics: PhysicsWorld | None = None
        self._forget()
        self._playing = True
        self._due_s = 0.0
        self._pace(0.0)

    def _forget(self) -> None:
        self._judge: Judge | None = None
        self._attempts: Callable[[], Sequence[Attempt]] = tuple
        self._running: dict[int, ScheduledAction] = {}

    @classmethod
    def anywhere(cls) -> Self:
        """Return a view at the usual port of this machine, or at a free one where that is in use."""
        need_viser()
        try:
            return cls()
        except InputError:
            return cls(port=0)

    def follow(
        self,
        judge: Judge,
        title: str = "",
        goals: Sequence[Cell] = (),
        attempts: Callable[[], Sequence[Attempt]] = tuple,
    ) -> None:
        """Show a judged PhysicsWorld from now on, with what its cars do: the judge calls this view.

        ``title`` stands above the page, ``goals`` are cells to mark, and ``attempts`` returns those that were judged so
        far.
        """
        self.check_process()
        self._judge = judge
        self._attempts = attempts
        self._running = {}
        before = judge.on_change

        def change(running: dict[int, ScheduledAction]) -> None:
            before(running)
            self._running = running

        judge.on_change = change
        judge.executor.observers.append(self)
        self._begin(judge.physics, title, goals)
        self._show(judge.physics)

    def __call__(self, physics: PhysicsWorld) -> None:
        """Show a PhysicsWorld as it is now, if it is time; wait where people want it slower, or paused.

        Raises CraftsimError in a forked process, which has not the threads that answer browsers.
        """
        self.check_process()
        if physics is not self._physics:
            self._forget()
            self._begin(physics, "", ())
        speed = SPEEDS[self.page.speed.value]
        if time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + 1 / FRAMES_HZ
            self.page.attend()
            self._show(physics)
        while not self._playing:
            time.sleep(1 / FRAMES_HZ)
            if self.page.attend():
                self._show(physics)
            self._pace(physics.time_s)
        if speed != self._speed or physics.time_s < self._from_s:
            self._pace(physics.time_s)
        ahead_s = self._then + (physics.time_s - self._from_s) / speed - time.monotonic()
        if ahead_s > 0:
            time.sleep(ahead_s)

    @property
    def judged(self) -> Sequence[Attempt]:
        """The attempts of the episode so far."""
        return self._attempts()

    def toggle(self) -> None:
        """Pause what runs, or let it go on."""
        self._playing = not self._playing

    def close(self) -> None:
        """Close the page, unless it is closed; in a forked process it stays the other's."""
        if not self.is_forked:
            self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(self, physics: PhysicsWorld, title: str, goals: Sequence[Cell]) -> None:
        if physics is not self._physics:
            self._physics = physics
            self.page.show_world(title, physics, dict.fromkeys(goals, MARK))
            self.page.offer((), None)
        self._pace(physics.time_s)

    def _show(self, physics: PhysicsWorld) -> None:
        running = {car: action.action.name for car, action in self._running.items()}
        moment = partial(live, physics, self._judge, running, self.judged)
        self.page.show(physics.data.qpos, physics.time_s, self.judged, moment)
        self.page.show_playing(self._playing)

    def _pace(self, time_s: float) -> None:
        self._speed = SPEEDS[self.page.speed.value]
        self._then = time.monotonic()
        self._from_s = time_s


def live(
    physics: PhysicsWorld,
    judge: Judge | None,
    running: Mapping[int, str],
    attempts: Sequence[Attempt],
    car: int,
) -> Moment:
    """Return what is known of a car now; ``running`` are names of actions on their way, ``attempts`` those judged."""
    measured = None
    contact_n = math.nan
    if judge is not None:
        reading = judge.executor.readings()[car]
        measured = [float(reading[name]) for name in ("x", "y", "heading")]
        if judge.log is None:
            contact_n = math.nan
        else:
            contact_n = judge.log.period_n
    return Moment(
        physics.time_s,
        running.get(car, ""),
        physics.free_body_state(physics.cars[car].base)[0].tolist(),
        measured,
        _motors(physics, physics.data.actuator_force, car),
        _last(attempts, car, physics.time_s),
        contact_n,
    )


class RecordedView(NotCopyable):
    """Plays one of some recorded runs on a page; times are simulated seconds."""

    _instead = "open another one"

    def __init__(
        self,
        page: ViewerPage,
        runs: Mapping[str, Callable[[], Trajectory]],
        at_failure: bool = False,
    ) -> None:
        """Show the start of the first run, of ``runs`` by name with what reads each; ``page`` asks this view.

        ``at_failure`` shows where the first action begins that is not as predicted, if there is one. Raises InputError
        where the first run cannot be read.
        """
        self._page = page
        self._runs = runs
        self._at_failure = at_failure
        self.time_s = 0.0
        """Simulated time of the moment that is shown."""
        self.playing = False
        """Whether it plays on."""
        self._open(next(iter(runs)))
        orders = (self.toggle, self.step, self.step_back, self.seek, self.choose)
        page.controls = {order.__name__: order for order in orders}

    def serve(self) -> NoReturn:
        """Play and carry out what the page asks for, until interrupted."""
        last_wall_s = time.monotonic()
        while True:
            time.sleep(1 / FRAMES_HZ)
            wall_s = time.monotonic()
            self.advance(wall_s - last_wall_s)
            last_wall_s = wall_s

    def advance(self, wall_s: float) -> None:
        """Do what was asked for, let some real time pass at the page's speed, and show where that leads."""
        has_requests = self._page.attend()
        if has_requests or self.playing:
            if self.playing:
                self.seek(self.time_s + SPEEDS[self._page.speed.value] * wall_s)
                self.playing = self.time_s < self._end_s
            self._show()

    def toggle(self) -> None:
        """Play, from the start if it is at its end, or pause."""
        if not self.playing and self.time_s >= self._end_s:
            self.time_s = self._start_s
        self.playing = not self.playing

    def step(self) -> None:
        """Pause where the next action begins, or at the end."""
        self.playing = False
        later = (begin for begin in self._begins if begin > self.time_s + SAME_TIME_S)
        self.time_s = next(later, self._end_s)

    def step_back(self) -> None:
        """Pause where the action before began, or at the start."""
        self.playing = False
        earlier = (begin for begin in reversed(self._begins) if begin < self.time_s - SAME_TIME_S)
        self.time_s = next(earlier, self._start_s)

    def seek(self, time_s: float) -> None:
        """Go to a moment, the nearest that there is."""
        self.time_s = min(max(time_s, self._start_s), self._end_s)

    def choose(self, run: str) -> None:
        """Go to the start of another run, or say why that cannot be shown."""
        try:
            self._open(run)
        except InputError as error:
            self._page.print_error(str(error))

    def _open(self, name: str) -> None:
        trajectory = self._runs[name]()
        story = trajectory.story
        self._start_s, self._end_s = trajectory.time[[0, -1]].tolist()
        marks = {piece.cell: 1.0 if piece.kind in _WHOLE else MARK for piece in trajectory.wanted}
        marks = marks or dict.fromkeys(story.recipe.goals, MARK)
        self._page.show_world(story.title, trajectory.physics, marks)
        self._page.offer(tuple(self._runs), (self._start_s, self._end_s))
        self.trajectory = trajectory
        self.time_s = self._start_s
        self.playing = False
        begins = {attempt.start_s for attempt in story.attempts}
        self._begins = sorted(begin for begin in begins if self._start_s <= begin < self._end_s)
        failed = [attempt.start_s for attempt in story.attempts if not attempt.agrees]
        if self._at_failure and failed:
            self.seek(min(failed))
        self._show()

    def _show(self) -> None:
        trajectory = self.trajectory
        sample = self.trajectory.at(self.time_s)
        if not self.playing:
            self._page.hurry()
        time_s = float(trajectory.time[sample])
        moment = partial(recorded, trajectory, sample)
        self._page.show(trajectory.qpos[sample], time_s, trajectory.story.attempts, moment)
        self._page.show_playing(self.playing)


def recorded(trajectory: Trajectory, sample: int, car: int) -> Moment:
    """Return what a trajectory knows of a car at one of its samples."""
    time_s = float(trajectory.time[sample])
    attempt = _last(trajectory.story.attempts, car, time_s)
    runs = attempt is not None and not attempt.has_ended(time_s)
    return Moment(
        time_s,
        attempt.action if attempt is not None and runs else "",
        trajectory.pose(f"car {car}")[sample, :3].tolist(),
        trajectory.measured[sample, car].tolist(),
        _motors(trajectory.physics, trajectory.force[sample], car),
        attempt,
        float(trajectory.contact[sample]),
    )


def _motors(
    physics: PhysicsWorld, force: NDArray[np.floating], car: int
) -> tuple[tuple[str, float, float], ...]:
    machine = physics.cars[car]
    model = physics.model
    columns = [*machine.wheel_actuators.tolist(), machine.board.actuator]
    names = [model.actuator(column).name.split("/")[-1] for column in columns]
    limits = model.actuator_forcerange[columns, 1].tolist()
    return tuple(zip(names, force[columns].tolist(), limits, strict=True))


def _last(attempts: Sequence[Attempt], car: int, time_s: float) -> Attempt | None:
    for attempt in reversed(attempts):
        if attempt.car == car and attempt.has_begun(time_s):
            return attempt
    return None
