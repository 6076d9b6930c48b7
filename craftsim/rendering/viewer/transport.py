"""Where the playing of a recorded run stands: at which moment, and whether it goes on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

_SAME_S = 1e-6


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
