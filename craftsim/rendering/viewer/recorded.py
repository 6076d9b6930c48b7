"""Viewing recorded runs: which moment is shown, and whether it plays on."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, NoReturn

from craftsim.discrete.grid import Kind
from craftsim.errors import InputError
from craftsim.rendering.trajectory import Trajectory
from craftsim.rendering.viewer.page import FRAMES_HZ, SPEEDS, Moment, ViewerPage, last_attempt, motors_of
from craftsim.rendering.viewer.scene import MARK

_WHOLE: Final = (Kind.BLOCK, Kind.FSLOPE)
"""What of a building fills its cell."""
_SAME_S: Final = 1e-6


class RecordedView:
    """Plays one of some recorded runs on a page; times are simulated seconds."""

    def __init__(self, page: ViewerPage, runs: Mapping[str, Callable[[], Trajectory]]) -> None:
        """Show the start of the first run, paused.

        Args:
            page: takes its orders from here from now on.
            runs: what can be chosen: by name, what reads it.

        Raises InputError where the first run cannot be read.
        """
        self._page, self._runs = page, runs
        self.time_s, self.playing = 0.0, False
        """Of the moment that is shown, and whether it plays on."""
        self._open(next(iter(runs)))
        orders = (self.toggle, self.step, self.step_back, self.seek, self.choose)
        page.controls = {order.__name__: order for order in orders}

    def serve(self) -> NoReturn:
        """Play and obey until interrupted."""
        then = time.monotonic()
        while True:
            time.sleep(1 / FRAMES_HZ)
            now = time.monotonic()
            self.advance(now - then)
            then = now

    def advance(self, wall_s: float) -> None:
        """Do what was asked for, let some real time pass at the page's speed, and show where that leads."""
        asked = self._page.attend()
        if asked or self.playing:
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
        later = (begin for begin in self._begins if begin > self.time_s + _SAME_S)
        self.time_s = next(later, self._end_s)

    def step_back(self) -> None:
        """Pause where the action before began, or at the start."""
        self.playing = False
        earlier = (begin for begin in reversed(self._begins) if begin < self.time_s - _SAME_S)
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
        self._page.show_world(
            story.title, trajectory.physics, marks or dict.fromkeys(story.recipe.goals, MARK)
        )
        self._page.offer(tuple(self._runs), (self._start_s, self._end_s))
        self.trajectory, self.time_s, self.playing = trajectory, self._start_s, False
        begins = {attempt.start_s for attempt in story.attempts}
        self._begins = sorted(begin for begin in begins if self._start_s <= begin < self._end_s)
        self._show()

    def _show(self) -> None:
        trajectory, sample = self.trajectory, self.trajectory.at(self.time_s)
        if not self.playing:
            self._page.hurry()
        time_s = float(trajectory.time[sample])
        moment = partial(recorded, trajectory, sample)
        self._page.show(trajectory.qpos[sample], time_s, trajectory.story.attempts, moment)
        self._page.show_playing(self.playing)


def recorded(trajectory: Trajectory, sample: int, car: int) -> Moment:
    """Return what a trajectory knows of a car at one of its samples."""
    time_s = float(trajectory.time[sample])
    attempt = last_attempt(trajectory.story.attempts, car, time_s)
    runs = attempt is not None and time_s < attempt.start_s + attempt.duration_s - _SAME_S
    return Moment(
        time_s,
        attempt.action if attempt is not None and runs else "",
        trajectory.pose(f"car {car}")[sample, :3].tolist(),
        trajectory.measured[sample, car].tolist(),
        motors_of(trajectory.physics, trajectory.force[sample], car),
        attempt,
        float(trajectory.contact[sample]),
    )
