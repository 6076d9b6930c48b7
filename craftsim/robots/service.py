"""Robots behind a simulated network, one event after the other in the robots' own time; no sockets here."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from craftsim.robots.channel import Channel
from craftsim.robots.messages import (
    COPIES,
    Ack,
    Bye,
    Commands,
    Follow,
    Measurements,
    Message,
    MessageError,
    TruePoses,
    Welcome,
    pack,
    unpack,
)
from craftsim.robots.robot import Clock
from craftsim.robots.station import Station

Send = Callable[[bytes, bytes], None]
"""Sends (to whom, what)."""
_WATCHERS: Final = 8
"""Who look on at most; one more takes the place of the first."""
_TOLD: Final = 10
"""Of what becomes of messages, so much is said within _LATELY_S: whoever sends them, they fill no disk."""
_LATELY_S: Final = 60.0
"""By the robots' clock."""


class Service:
    """Serves a station: takes what comes, and lets the robots' time pass."""

    def __init__(
        self,
        station: Station,
        clock: Clock,
        up: Channel[tuple[bytes, Commands]],
        down: Channel[Measurements],
        send: Send,
        referee: Callable[[Measurements], TruePoses] | None = None,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        """Begin at time 0.

        Args:
            station: the robots.
            clock: lets their control periods pass.
            up: what commands go through, each with its sender.
            down: what measurements go through.
            send: sends to who drives.
            referee: knows where everything truly is, at the time of some measurements.
            tell: says who comes, when the robots stop, and why a message was dropped.
        """
        self.station, self._clock, self._up, self._down = station, clock, up, down
        self._send, self._referee, self._tell = send, referee, tell
        self.now_s = 0.0
        self.periods = 0
        self._measured = False
        """Whether that has been done in this period."""
        self._told: deque[float] = deque(maxlen=_TOLD)
        """When that was."""
        self.malformed = 0
        """Messages that were none, or out of place."""
        self._watchers: deque[bytes] = deque(maxlen=_WATCHERS)
        self._witness: bytes | None = None
        """Who looks on for the driver."""
        self._poses: bytes | None = None
        """Those published last."""
        self.farewells = 0
        """How many have driven the robots and said goodbye, or are gone."""
        self.unseen: set[int] = set()
        """Measurements on which robots that wait have no answer yet."""

    @property
    def next_s(self) -> float:
        """When something happens next, by the robots' clock."""
        return min(self._period_s, self._up.due_s, self._down.due_s)

    @property
    def _period_s(self) -> float:
        return round(self.periods * self.station.period_s, 9)

    def arrive(self, sender: bytes, data: bytes, now_s: float) -> None:
        """Take what has come; a command is then on its way, all else is there at once."""
        try:
            message = unpack(data)
            if isinstance(message, Follow) and self._referee is not None:
                if message.ticket and message.ticket == self.station.ticket:
                    self._witness = sender
                elif sender not in self._watchers:
                    self._watchers.append(sender)
                if self._poses is not None:
                    self._send(sender, self._poses)
                return
            self.station.check(sender, message)
            if isinstance(message, Commands):
                self._up.send(now_s, (sender, message))
            else:
                self._receive(sender, message, now_s)
        except (MessageError, ValueError) as error:
            self.malformed += 1
            self._mention(f"dropped a message: {error}")

    def depart(self, sender: bytes) -> None:
        """Go on without somebody whose connection is closed."""
        if sender == self.station.driver:
            self.station.abandoned = True
            self.farewells += 1
            self.unseen.clear()
        if sender == self._witness:
            self._witness = None
        if sender in self._watchers:
            self._watchers.remove(sender)

    @property
    def clients(self) -> frozenset[bytes]:
        """Who drive the robots or look on."""
        known = (*self._watchers, self._witness, self.station.driver)
        return frozenset(client for client in known if client is not None)

    def step(self) -> None:
        """Let happen what happens next."""
        now_s = self.now_s = self.next_s
        self._deliver(now_s)
        for sender, commands in self._up.due(now_s):
            if sender == self.station.driver:
                self._receive(sender, commands, now_s)
        if self._period_s > now_s:
            return
        if not self._measured:
            # What is commanded in answer comes before the robots act where it takes no time.
            self._measure(now_s)
        else:
            if not self.station.act(now_s):
                self._tell(
                    f"{now_s:.2f} s: no command since {self.station.inbox.heard_s:.2f} s, the robots stop"
                )
            self.periods += 1
            self._clock.wait()
        self._measured = not self._measured

    def _measure(self, now_s: float) -> None:
        measured = self.station.measure(now_s)
        if self._referee is not None:
            self._poses = pack(self._referee(measured))
            for client in self.clients - {self.station.driver}:
                self._send(client, self._poses)
        if self.station.driver is not None:
            for _ in range(COPIES):
                self._down.send(now_s, measured)
            self._deliver(now_s)

    def _receive(self, sender: bytes, message: Message, now_s: float) -> None:
        answer = self.station.receive(sender, message, now_s)
        if answer is not None:
            self._send(sender, pack(answer))
            self._mention(f"{now_s:.2f} s: {answer.kind}")
            if isinstance(answer, Welcome):
                self.unseen.clear()
        if isinstance(message, Ack):
            self.unseen.discard(message.number)
        elif isinstance(message, Bye):
            self.farewells += 1
            self.unseen.clear()

    def _mention(self, line: str) -> None:
        """Say what became of a message, unless as much was said lately as is allowed."""
        if len(self._told) < _TOLD or self.now_s - self._told[0] >= _LATELY_S:
            self._told.append(self.now_s)
            self._tell(line)

    def _deliver(self, now_s: float) -> None:
        for message in self._down.due(now_s):
            if self.station.driver is not None:
                self._send(self.station.driver, pack(message))
                if self.station.waits:
                    self.unseen.add(message.number)
