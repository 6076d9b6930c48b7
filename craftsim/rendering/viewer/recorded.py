"""Viewing recorded runs."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

from craftsim.errors import InputError
from craftsim.rendering.trajectory import Trajectory
from craftsim.rendering.viewer.moment import recorded
from craftsim.rendering.viewer.page import FRAMES_HZ, SPEEDS, Page
from craftsim.rendering.viewer.playback import Playback

if TYPE_CHECKING:
    from viser import ViserServer


class Opens(Protocol):
    """Returns a trajectory when it is looked at."""

    def __call__(self) -> Trajectory:
        """Raises InputError where it cannot be read."""


class RecordedView:
    """Plays one of some recorded runs in the browsers of a server."""

    def __init__(self, server: ViserServer, runs: Mapping[str, Opens], page: Page | None = None) -> None:
        """Show the start of the first run.

        Args:
            server: of the page.
            runs: what can be chosen, by name.
            page: that of the server, where there is one already.

        Raises InputError where the first run cannot be read.
        """
        self._runs, self.page = runs, page or Page(server)
        page = self.page
        page.run.options, page.run.visible = tuple(runs), len(runs) > 1
        page.speed.options = tuple(SPEEDS)
        for part in (page.back, page.forward, page.slider):
            part.visible = True
        self._open(next(iter(runs)))
        page.when(page.run.on_update, self._choose)
        page.when(page.play.on_click, lambda: self.playback.toggle())
        page.when(page.forward.on_click, lambda: self.playback.step())
        page.when(page.back.on_click, lambda: self.playback.step_back())
        page.when(page.slider.on_update, lambda: self.playback.seek(float(page.slider.value)))

    def run(self) -> None:
        """Play and obey until interrupted."""
        then = time.monotonic()
        while True:
            time.sleep(1 / FRAMES_HZ)
            now = time.monotonic()
            self.advance(now - then)
            then = now

    def advance(self, wall_s: float) -> None:
        """Do what was asked for, let some real time pass, and show where that leads."""
        asked = self.page.attend()
        self.playback.speed = self.page.chosen_speed or 1.0
        if asked or self.playback.playing:
            self.playback.advance(wall_s)
            self.show()

    def show(self) -> None:
        """Show the moment of the playback."""
        trajectory, playback = self.trajectory, self.playback
        if not playback.playing:
            self.page.hurry()
        sample = trajectory.at(playback.time_s)
        self.page.show(
            trajectory.qpos[sample], lambda: recorded(trajectory, sample), trajectory.story.attempts
        )
        self.page.show_playing(playback.playing)

    def _choose(self) -> None:
        try:
            self._open(self.page.run.value)
        except InputError as error:
            self.page.complain(str(error))

    def _open(self, name: str) -> None:
        trajectory = self._runs[name]()
        site, story = trajectory.site, trajectory.story
        self.trajectory, self.playback = trajectory, Playback.of(trajectory)
        slider = self.page.slider
        slider.min, slider.max = self.playback.start_s, max(self.playback.end_s, self.playback.start_s + 0.02)
        self.page.show_world(story.title, site, [cell.cell for cell in story.design])
        self.show()
