"""Viewing recorded runs: which moment is shown, and whether it plays on."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final, NoReturn, Self

from craftsim.errors import InputError
from craftsim.rendering.trajectory import Trajectory
from craftsim.rendering.viewer.moment import recorded
from craftsim.rendering.viewer.page import FRAMES_HZ, SPEEDS, Controls, ViewerPage
from craftsim.rendering.viewer.scene import MARK

WHOLE: Final = ("block", "fslope")
"""What of a building fills its cell."""
_SAME_S: Final = 1e-6


@dataclass
class Transport:
    """Plays from a start to an end; times are simulated seconds."""

    start_s: float
    end_s: float
    stops: tuple[float, ...]
    """Where actions begin, in order, and the end."""
    time_s: float
    """Of the moment that is shown."""
    playing: bool = False

    @classmethod
    def between(cls, start_s: float, end_s: float, begins: Iterable[float] = ()) -> Self:
        """Return a playback that stands at its start; ``begins`` are the times at which actions begin."""
        inside = {begin for begin in begins if start_s <= begin < end_s}
        return cls(start_s, end_s, (*sorted(inside), end_s), start_s)

    def toggle(self) -> None:
        """Play, from the start if it is at its end, or pause."""
        if not self.playing and self.time_s >= self.end_s:
            self.time_s = self.start_s
        self.playing = not self.playing

    def seek(self, time_s: float) -> None:
        """Go to a moment, the nearest that there is."""
        self.time_s = min(max(time_s, self.start_s), self.end_s)

    def step(self) -> None:
        """Pause where the next action begins, or at the end."""
        self.playing = False
        self.time_s = next((stop for stop in self.stops if stop > self.time_s + _SAME_S), self.end_s)

    def step_back(self) -> None:
        """Pause where the action before began, or at the start."""
        self.playing = False
        earlier = (stop for stop in reversed(self.stops) if stop < self.time_s - _SAME_S)
        self.time_s = next(earlier, self.start_s)

    def advance(self, wall_s: float, speed: float) -> None:
        """Let some real time pass, in seconds, at a speed in simulated seconds a second; at its end it pauses."""
        if self.playing:
            self.seek(self.time_s + speed * wall_s)
            self.playing = self.time_s < self.end_s


class RecordedView(Controls):
    """Plays one of some recorded runs on a page."""

    def __init__(self, page: ViewerPage, runs: Mapping[str, Callable[[], Trajectory]]) -> None:
        """Show the start of the first run.

        Args:
            page: takes its orders from here from now on.
            runs: what can be chosen: by name, what reads it.

        Raises InputError where the first run cannot be read.
        """
        self._page, self._runs = page, runs
        self._open(next(iter(runs)))
        page.controls = self

    def serve(self) -> NoReturn:
        """Play and obey until interrupted."""
        then = time.monotonic()
        while True:
            time.sleep(1 / FRAMES_HZ)
            now = time.monotonic()
            self.advance(now - then)
            then = now

    def advance(self, wall_s: float) -> None:
        """Do what was asked for, let some real time pass, and show where that leads."""
        asked = self._page.attend()
        if asked or self.playback.playing:
            self.playback.advance(wall_s, SPEEDS[self._page.speed.value])
            self._show()

    def toggle(self) -> None:
        """Play or pause."""
        self.playback.toggle()

    def step(self) -> None:
        """Go to where the next action begins."""
        self.playback.step()

    def step_back(self) -> None:
        """Go to where the action before began."""
        self.playback.step_back()

    def seek(self, time_s: float) -> None:
        """Go to a moment."""
        self.playback.seek(time_s)

    def choose(self, run: str) -> None:
        """Go to the start of another run, or say why that cannot be shown."""
        try:
            self._open(run)
        except InputError as error:
            self._page.print_error(str(error))

    def _open(self, name: str) -> None:
        trajectory = self._runs[name]()
        story, times_s = trajectory.story, (float(trajectory.time[0]), float(trajectory.time[-1]))
        marks = {goal.cell: 1.0 if goal.kind in WHOLE else MARK for goal in story.design}
        self._page.show_world(
            story.title, trajectory.physics, marks or dict.fromkeys(story.recipe.goals, MARK)
        )
        self._page.offer(tuple(self._runs), times_s)
        self.trajectory = trajectory
        self.playback = Transport.between(*times_s, (attempt.start_s for attempt in story.attempts))
        self._show()

    def _show(self) -> None:
        trajectory, playing = self.trajectory, self.playback.playing
        sample = trajectory.at(self.playback.time_s)
        if not playing:
            self._page.hurry()
        moment = recorded(trajectory, sample)
        self._page.show(trajectory.qpos[sample], moment, trajectory.story.attempts)
        self._page.show_playing(playing)
