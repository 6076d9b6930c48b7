"""Serving simulated robots to whoever drives them: in real time, at a share of it, or in lock-step."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, Protocol

from craftsim.robots.messages import Bye, pack
from craftsim.robots.service import Service

PATIENCE_S: Final = 60.0
"""How long robots in lock-step wait for an answer, by this machine's clock; then their time goes on without."""
_LOOK_S: Final = 0.1


class Sockets(Protocol):
    """Where messages come and go."""

    def send(self, receiver: bytes, data: bytes) -> None:
        """Send a message."""

    def receive(self, timeout_s: float) -> tuple[bytes, bytes] | None:
        """Return (from whom, what) comes next, or None where nothing does in time."""


class Server:
    """Lets the time of robots pass as the clock of this machine does, and messages come and go."""

    def __init__(
        self,
        service: Service,
        sockets: Sockets,
        pace: float = 1.0,
        patience_s: float = PATIENCE_S,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Serve.

        Args:
            service: the robots.
            sockets: where messages come and go.
            pace: seconds of the robots' time in a second.
            patience_s: how long those in lock-step wait for an answer.
            now: this machine's clock, in seconds.
        """
        self._service, self._sockets, self._pace, self._patience_s = service, sockets, pace, patience_s
        self._now = now
        self.behind_s = 0.0
        """By how much the robots' time fell behind all together, because physics took longer; it is not caught up."""
        self._silent = False
        """Whether who drives robots in lock-step has left their patience to run out."""
        self._keep_time()

    def run(self, ended: Callable[[], bool]) -> None:
        """Serve until somebody says so."""
        station = self._service.station
        while not ended():
            if station.waits and station.driver is None:
                self._take(_LOOK_S)
                self._keep_time()
            elif station.waits and self._service.unseen and not self._silent:
                self._silent = not self._take(self._patience_s)
                self._keep_time()
            elif station.waits and not self._silent:
                self._service.step()
            else:
                self._pass_time()

    def end(self) -> None:
        """Say goodbye to who drives the robots."""
        driver = self._service.station.driver
        if driver is not None:
            self._sockets.send(driver, pack(Bye("somebody has ended them")))

    def _pass_time(self) -> None:
        """Wait for what happens next, and take what comes meanwhile."""
        left_s = self._wall_s(self._service.next_s) - self._now()
        if left_s > 0:
            self._take(min(left_s, _LOOK_S))
            return
        while self._take(0.0):
            pass
        self._service.step()
        behind_s = (self._now() - self._wall_s(self._service.now_s)) * self._pace
        if behind_s > self._service.station.period_s:
            self.behind_s += behind_s
            self._keep_time()

    def _take(self, timeout_s: float) -> bool:
        """Take the next message that comes in time; return whether one does."""
        # A poll counts in milliseconds: what is less is left to the loop.
        found = self._sockets.receive(timeout_s)
        if found is None:
            return False
        robots_s = self._anchor[1] + (self._now() - self._anchor[0]) * self._pace
        waits = self._service.station.waits and not self._silent
        now_s = (
            self._service.now_s if waits else min(max(robots_s, self._service.now_s), self._service.next_s)
        )
        if self._silent and found[0] == self._service.station.driver:
            self._service.unseen.clear()
            self._silent = False
        self._service.arrive(*found, now_s)
        return True

    def _keep_time(self) -> None:
        """Let the robots' time pass from now on."""
        self._anchor = self._now(), self._service.now_s

    def _wall_s(self, robots_s: float) -> float:
        return self._anchor[0] + (robots_s - self._anchor[1]) / self._pace
