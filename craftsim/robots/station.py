"""Robots as a network sees them: messages in, messages out, one control period after the other; no sockets here."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field

from craftsim.robots.inbox import WATCHDOG_S, Inbox
from craftsim.robots.messages import Ack, Bye, Commands, Hello, Measurements, Message, Refused, Welcome
from craftsim.robots.robot import Robot
from craftsim.skills.skill import Command

LEASE_S = 2.0
"""After so long without a message from its driver somebody else may drive the robots."""


@dataclass
class Station:
    """Some robots in one world, and whoever drives them."""

    robots: Sequence[Robot]
    n_slopes: int
    period_s: float
    world: str = ""
    """Digest of the world, which a driver's must equal; empty for any."""
    referee: bool = False
    """Whether there is one."""
    waits: bool = False
    watchdog_s: float = WATCHDOG_S
    driver: bytes | None = None
    """Whose commands are obeyed."""
    abandoned: bool = False
    """Whether the driver has gone without a word: the watchdog will stop the robots, and somebody else may come."""
    stopped_at_s: list[float] = field(default_factory=list)
    """When the robots stopped because no command came."""
    heard_at_s: list[float] = field(default_factory=list)
    """When the last command before each of these came."""

    def __post_init__(self) -> None:
        self.inbox = Inbox(self.watchdog_s)
        self.number = 0
        """Of the newest measurements."""
        self._heard_s = 0.0
        self.ticket = ""
        """Of the driver: who looks on with it is the driver's."""

    def check(self, sender: bytes, message: Message) -> None:
        """Raise ValueError for a message that is out of place."""
        if isinstance(message, Hello):
            return
        if not isinstance(message, Commands | Ack | Bye):
            raise ValueError(f"{message.kind} is nothing to tell robots")
        if sender != self.driver:
            raise ValueError(f"{message.kind} of somebody who does not drive the robots")
        if isinstance(message, Commands) and len(message.cars) != len(self.robots):
            raise ValueError(f"commands for {len(message.cars)} cars; there are {len(self.robots)}")

    def receive(self, sender: bytes, message: Message, now_s: float) -> Message | None:
        """Take a message that is in place, and return the answer if there is one."""
        if isinstance(message, Hello):
            return self._greet(sender, message, now_s)
        self._heard_s = now_s
        match message:
            case Commands():
                self.inbox.take(message, now_s)
            case Bye():
                self.leave()
        return None

    def _greet(self, sender: bytes, hello: Hello, now_s: float) -> Message:
        silent = self.abandoned or now_s - self._heard_s >= LEASE_S
        if self.driver not in (None, sender) and not silent:
            return Refused("the robots obey somebody else; try again when that has ended", busy=True)
        if hello.cars != len(self.robots):
            return Refused(f"there are {len(self.robots)} robots, not {hello.cars}")
        if self.world and hello.world and hello.world != self.world:
            return Refused("the robots stand in another world; start both with the same task and files")
        self.inbox.begin()
        self.driver, self._heard_s = sender, now_s
        self.abandoned, self.ticket = False, secrets.token_hex(16)
        return Welcome(
            *(len(self.robots), self.n_slopes, self.period_s, self.watchdog_s),
            *(self.referee, self.waits, self.ticket),
        )

    def leave(self) -> None:
        """Let the driver go; the robots stop."""
        self.driver, self.abandoned, self.ticket = None, False, ""
        self.inbox.begin()

    def measure(self, now_s: float) -> Measurements:
        """Return what the robots measure now."""
        self.number += 1
        inbox, cars = self.inbox, tuple(robot.measure() for robot in self.robots)
        return Measurements(self.number, now_s, inbox.heard, inbox.late_s, inbox.stops, cars)

    def act(self, now_s: float) -> bool:
        """Let the robots do what they were told for now; stop them, and return False, once they are told nothing."""
        before = self.inbox.stops
        commands = self.inbox.obey(now_s)
        if self.inbox.stops > before:
            self.stopped_at_s.append(now_s)
            self.heard_at_s.append(self.inbox.heard_s)
        for car, robot in enumerate(self.robots):
            robot.command(Command() if commands is None else commands.cars[car])
        if self.abandoned and self.inbox.standing:
            self.leave()
        return self.inbox.stops == before
