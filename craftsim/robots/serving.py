"""Serving simulated robots to whoever drives them: in real time, at a share of it, or in lock-step."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Final, Protocol

from craftsim.robots.messages import Bye, pack
from craftsim.robots.service import Service

PATIENCE_S: Final = 60.0
"""How long robots in lock-step wait for an answer, by this machine's clock; then their time goes on without."""
_LOOK_S: Final = 0.1
_AT_ONCE: Final = 128
"""Messages that are taken before the robots' time goes on, however many wait."""


class Sockets(Protocol):
    """Where messages come and go."""

    def send(self, receiver: bytes, data: bytes) -> None:
        """Send a message."""

    def receive(self, timeout_s: float, kept: Collection[bytes]) -> tuple[bytes, bytes | None] | None:
        """Return (from whom, what) comes next, or None where nothing does in time.

        There is no message of one who is gone. Who are ``kept`` are never given up for others.
        """


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
        self._heard = now()
        """When their driver was heard last, or had last nothing to say."""
        self._keep_time()

    def run(self, ended: Callable[[], bool]) -> None:
        """Serve until somebody says so."""
        station = self._service.station
        while not ended():
            if station.waits and station.driver is None:
                self._take(_LOOK_S)
                self._keep_time()
            elif self._in_step and self._service.unseen:
                left_s = self._heard + self._patience_s - self._now()
                self._silent = left_s <= 0
                self._take(max(0.0, min(left_s, _LOOK_S)))
                self._keep_time()
            elif self._in_step:
                self._service.step()
                self._heard = self._now()
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
        for _ in range(_AT_ONCE):
            if not self._take(0.0):
                break
        self._service.unseen.clear()  # nobody is waited for
        self._service.step()
        behind_s = (self._now() - self._wall_s(self._service.now_s)) * self._pace
        if behind_s > self._service.station.period_s:
            self.behind_s += behind_s
            self._keep_time()

    def _take(self, timeout_s: float) -> bool:
        """Take the next message that comes in time; return whether one does."""
        service = self._service
        found = self._sockets.receive(timeout_s, service.clients)
        if found is None:
            return False
        sender, data = found
        if data is None:
            was_driven = sender == service.station.driver
            service.depart(sender)
            if was_driven:
                self._keep_time()
            return True
        robots_s = self._anchor[1] + (self._now() - self._anchor[0]) * self._pace
        now_s = service.now_s if self._in_step else min(max(robots_s, service.now_s), service.next_s)
        service.arrive(sender, data, now_s)
        if sender == service.station.driver:
            self._heard, self._silent = self._now(), False
        return True

    @property
    def _in_step(self) -> bool:
        """Whether the robots' time waits for their driver."""
        station = self._service.station
        return station.waits and not self._silent and not station.abandoned

    def _keep_time(self) -> None:
        """Let the robots' time pass from now on."""
        self._anchor = self._now(), self._service.now_s

    def _wall_s(self, robots_s: float) -> float:
        return self._anchor[0] + (robots_s - self._anchor[1]) / self._pace
