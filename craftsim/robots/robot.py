"""The interface of a robot: measurements in, commands out, and a clock. Whoever has a machine implements these."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from craftsim.models.measuring import CarMeasurement
from craftsim.skills.skill import Command


class Robot(Protocol):
    """One car."""

    def measure(self) -> CarMeasurement:
        """Return what it measures now, at once; ``time_s`` is its own clock, and all robots of a fleet share it."""

    def command(self, command: Command) -> None:
        """Give its motors these speeds, until the next command comes; ``Command()`` stops them, and they hold."""


class Clock(Protocol):
    """The time of all robots of a fleet."""

    def wait(self) -> None:
        """Return when one more control period has passed."""


class RealClock:
    """The time of the world: each control period ends that long after the one before, however long it was used."""

    def __init__(
        self,
        period_s: float,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Begin the first period now; ``now`` and ``sleep`` are in seconds."""
        self._period_s, self._now, self._sleep = period_s, now, sleep
        self._end_s = now() + period_s
        self.overruns = 0
        """Periods that were over before they were waited for; they are not made up for."""

    def wait(self) -> None:
        """Sleep until the period is over."""
        left_s = self._end_s - self._now()
        if left_s > 0:
            self._sleep(left_s)
        else:
            self.overruns += 1
            self._end_s -= left_s
        self._end_s += self._period_s
