"""Robots on a network as a fleet that an executor drives.

One control period is that of the robots' clock: it is over when a measurement has come that is younger by a period.
Commands say when they are to begin, late enough for all but a few to be there by then, so that a delay that varies
does no harm; and the skills are given what the robots will measure at that time (:mod:`craftsim.robots.extrapolation`).
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from typing import Final, Protocol

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import Cell
from craftsim.errors import InputError
from craftsim.mjcf.parameters import Machines
from craftsim.models.measuring import Records
from craftsim.robots.extrapolation import Extrapolation
from craftsim.robots.fleet import Harness
from craftsim.robots.messages import (
    COPIES,
    Ack,
    Bye,
    Commands,
    Hello,
    Measurements,
    Message,
    MessageError,
    Refused,
    Welcome,
    pack,
    unpack,
)
from craftsim.skills.skill import Command

TIMEOUT_S: Final = 1.0
"""Without a message from the robots for so long they count as lost; by this machine's clock."""
_GREETED_S: Final = 5.0
"""How long robots may take to answer the first message: they may be about to start."""
_AGAIN_S: Final = 0.2
"""After so long one asks robots again that obey somebody else."""
_LISTENED: Final = 25
"""Control periods in which one first listens to how long commands take."""
_REMEMBERED: Final = 50
"""Control periods of which that is remembered."""
_SPARE_S: Final = 0.01
"""That commands are given beyond the longest that any of these took."""
_MOST_LEAD_S: Final = 0.5
_MOST_BEHIND_S: Final = 1.0
"""By how much the robots' clock may be ahead of who drives them during an action: their watchdog is quicker."""
_AT_ONCE: Final = 4096
"""Messages that are taken at once: more than wait in a connection."""
EPSILON_S: Final = 1e-6
_AROUND_M: Final = 10.0
"""Around a world: what is further off was not measured there, however badly."""


class Messenger(Protocol):
    """How messages get to robots and back."""

    def send(self, data: bytes) -> None:
        """Send a message; it may be lost."""

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message that comes, or None where none does in time.

        Raises ConnectionError where none can come any more.
        """

    def close(self) -> None:
        """Close the connection."""


def inside(size: Cell, x: float, y: float, z: float) -> bool:
    """Return whether a car, or what it handles, can be at a position in metres in a world of a size in cells.

    Example:
        >>> inside((3, 1, 1), 0.2, -5.0, 0.1), inside((3, 1, 1), 40.0, 0.0, 0.1)
        (True, False)
    """
    nx, ny, nz = size
    ends = zip((x, y, z), (nx * CELL_PITCH_M, ny * CELL_PITCH_M, nz * LEVEL_HEIGHT_M), strict=True)
    return all(-_AROUND_M <= place <= end + _AROUND_M for place, end in ends)


class Link(Harness):
    """A connection to robots: what stands on its wires is sent to them, and what they will measure is read."""

    def __init__(
        self,
        transport: Messenger,
        n_cars: int,
        machines: Machines,
        world: str = "",
        timeout_s: float = TIMEOUT_S,
        size: Cell | None = None,
    ) -> None:
        """Say hello to the robots, and listen for half a second how long messages take.

        Args:
            transport: reaches them.
            n_cars: how many there should be.
            machines: their parameters.
            world: digest of the world in which they should stand.
            timeout_s: without a message of use for so long they are lost, and so is a car whose clock stands so long.
            size: of the world in cells, if that is known: no car is far outside.

        Raises InputError where nobody answers, or they refuse.
        """
        self._transport, self._timeout_s = transport, timeout_s
        self._follow: Callable[[Measurements, float], str] = lambda measured, timeout_s: ""
        self.lost, self._dead = "", False
        self.dropped = 0
        """Messages that were none, or said what cannot be."""
        self._why_dropped = ""
        """Of the last of these, in brackets."""
        self._size = size
        self.welcome = self._greet(n_cars, world)
        period_s = self.period_s = self.welcome.period_s
        super().__init__(n_cars, self.welcome.slopes, math.ceil(timeout_s / period_s))
        self._cars = [Extrapolation(machines.car(car), machines, period_s) for car in range(n_cars)]
        self._sent: deque[tuple[float, Commands]] = deque(
            maxlen=round(2 * _MOST_LEAD_S / period_s) + _REMEMBERED
        )
        """The newest commands last, each with the lead that it had."""
        self._takes: deque[float] = deque(maxlen=_REMEMBERED)
        self._lead_s = 0.0
        """How long after the measurement that they answer commands are to begin."""
        self._number, self._first = 0, 1
        self._owed: list[int] = []
        self._newest = self._first_measurements()
        self._due_s, self._stops = self._newest.time_s, self._newest.stops
        for _ in range(_LISTENED):
            self.advance()
        if self.lost:
            raise InputError(self.lost)

    @property
    def late_periods(self) -> int:
        """Control periods until what is commanded now has been done and seen."""
        return round(self._lead_s / self.period_s) + 1

    def read(self) -> Records:
        """Return what the cars will measure when the next command begins, shape (n,) of READING."""
        return self.readings

    def attend(self) -> None:
        """Take up with the robots' clock, which has gone on."""
        if self._dead:
            return
        self.lost, self._first = "", self._number + 1
        takes_s = max(self._takes, default=0.0)
        if takes_s > EPSILON_S:
            takes_s += _SPARE_S
        lead_s = math.ceil(takes_s / self.period_s - EPSILON_S) * self.period_s
        self._lead_s = min(max(lead_s, 0.0), _MOST_LEAD_S)
        self._take_all()
        self._listen_until(self._newest.time_s + self.period_s)
        self._due_s, self._stops = self._newest.time_s, self._newest.stops
        self._predict()

    def advance(self, observe: Callable[[], None] | None = None) -> None:
        """Send what stands on the wires, and wait until a control period of the robots is over."""
        if self.lost:
            return
        self._number += 1
        message = Commands(self._number, self._due_s + self._lead_s, self.commands())
        for _ in range(COPIES):
            self._transport.send(pack(message))
        self._sent.append((self._lead_s, message))
        self._due_s += self.period_s
        if not self.welcome.waits:
            self._take_all()
        self._listen_until(self._due_s)
        ahead_s = self._newest.time_s - self._due_s
        if self._newest.heard < self._first:
            self._stops = self._newest.stops
        elif self._newest.stops > self._stops and not self.lost:
            self.lost = f"the robots had no command for {1e3 * self.welcome.watchdog_s:.0f} ms, and stopped"
        elif ahead_s > _MOST_BEHIND_S and not self.lost:
            self.lost = f"the clock of the robots was {ahead_s:.4g} s ahead of what they were commanded"
        self._predict()
        self._look_on()

    def stop(self, car: int, slope: int) -> None:
        """Command a car's motors to zero, and the hinge of a slope; tell the robots at once, unless it is lost."""
        super().stop(car, slope)
        if car in self.lost_cars:
            return
        self._number += 1
        self._transport.send(pack(Commands(self._number, 0.0, self.commands())))

    def close(self) -> None:
        """Let go of the robots."""
        self._transport.send(pack(Bye()))

    def let_follow(self, follow: Callable[[Measurements, float], str]) -> None:
        """Let somebody look on from now on, such as a mirror. Raises InputError where it sees nothing.

        It is called with measurements and a time limit in seconds, and returns why it did not see in time how things
        stood when they were made, or nothing.
        """
        self._follow = follow
        self._look_on()
        if self.lost:
            raise InputError(self.lost)

    def _look_on(self) -> None:
        if not self.lost and (why := self._follow(self._newest, self._timeout_s)):
            self._lose(why)

    def _greet(self, n_cars: int, world: str) -> Welcome:
        self._transport.send(pack(Hello(n_cars, world)))
        deadline = time.monotonic() + max(_GREETED_S, self._timeout_s)
        while (left_s := deadline - time.monotonic()) > 0:
            message = self._message(left_s)
            if self.lost:
                raise InputError(f"{self.lost}; is it craftsim robot that listens there?")
            if isinstance(message, Refused):
                if not message.busy or left_s < 2 * _AGAIN_S:
                    raise InputError(message.why)
                time.sleep(_AGAIN_S)
                self._transport.send(pack(Hello(n_cars, world)))
            if isinstance(message, Welcome):
                if message.cars != n_cars:
                    raise InputError(f"{message.cars} robots answer, and there should be {n_cars}")
                return message
        raise InputError(
            f"no robots answer within {max(_GREETED_S, self._timeout_s):g} s{self._why_dropped}; "
            "start some with: craftsim robot"
        )

    def _first_measurements(self) -> Measurements:
        """Return the first measurements that come; raise InputError where none do."""
        deadline = time.monotonic() + self._timeout_s
        while (left_s := deadline - time.monotonic()) > 0:
            message = self._message(left_s)
            if self.lost:
                raise InputError(self.lost)
            if isinstance(message, Measurements) and self._fits(message, -math.inf):
                self._owed.append(message.number)
                self.measured(message.cars)
                return message
        raise InputError(f"the robots measure nothing for {self._timeout_s:g} s{self._why_dropped}")

    def _listen_until(self, time_s: float) -> None:
        """Take messages until there is a measurement of a time, or later, by the robots' clock; or lose them."""
        deadline = time.monotonic() + self._timeout_s
        while not self.lost and self._newest.time_s < time_s - EPSILON_S:
            for number in self._owed:
                self._transport.send(pack(Ack(number)))
            self._owed.clear()
            left_s = deadline - time.monotonic()
            # What is no measurement does not count, however much of it comes.
            if left_s <= 0 or not self._take(left_s):
                self._lose(f"nothing has come from the robots for {self._timeout_s:g} s{self._why_dropped}")

    def _take_all(self) -> None:
        """Take the messages that have come already."""
        for _ in range(_AT_ONCE):
            if not self._take(0.0):
                break

    def _take(self, timeout_s: float) -> bool:
        """Take the next message that comes in time; return whether there was one."""
        before = self.dropped
        message = self._message(timeout_s)
        if isinstance(message, Bye):
            self._lose(f"the robots have ended{': ' if message.why else ''}{message.why}")
        elif isinstance(message, Measurements):
            if self.welcome.waits:
                self._owed.append(message.number)
            if message.number > self._newest.number and self._fits(message, self._newest.time_s):
                self._note(message)
        return message is not None or self.dropped > before

    def _fits(self, message: Measurements, before_s: float) -> bool:
        """Return whether measurements are newer, of these cars where they can be, and of slopes that there are."""
        why = ""
        if len(message.cars) != self.welcome.cars:
            why = f"measurements of {len(message.cars)} cars; there are {self.welcome.cars}"
        elif message.time_s <= before_s:
            why = f"a clock that went from {before_s:g} s to {message.time_s:g} s"
        for car, now in enumerate(message.cars):
            if now.slope is not None and now.slope >= self.welcome.slopes:
                why = f"car {car} docked to slope {now.slope}; there are {self.welcome.slopes}"
            elif self._size is not None and not inside(self._size, now.x, now.y, now.z):
                why = f"car {car} at ({now.x:g}, {now.y:g}, {now.z:g}) m, outside the world"
        if why:
            self._drop(why)
        return not why

    def _drop(self, why: str) -> None:
        self.dropped += 1
        self._why_dropped = f" (dropped: {why})"

    def _note(self, message: Measurements) -> None:
        if message.heard > self._newest.heard:
            leads = (lead_s for lead_s, sent in self._sent if sent.number == message.heard)
            self._takes.extend(lead_s + message.late_s for lead_s in leads)
        acted = self._acting(message.time_s - self.period_s)
        # Over a longer gap robots stand; wheels that do not, by a clock that leaps, cannot be reckoned with.
        gap_s = min(message.time_s - self._newest.time_s, _MOST_BEHIND_S)
        periods = round(gap_s / self.period_s)
        for car, now, command in zip(self._cars, message.cars, acted, strict=True):
            car.note(now, command, periods)
        self._newest = message

    def _message(self, timeout_s: float) -> Message | None:
        """Return the next message that comes in time, if it is one; the robots are lost where none can come."""
        try:
            data = self._transport.receive(timeout_s)
            return None if data is None else unpack(data)
        except ConnectionError as error:
            self._lose(str(error))
        except MessageError as error:
            self._drop(str(error))
        return None

    def _lose(self, why: str) -> None:
        self.lost, self._dead = why, True

    def _predict(self) -> None:
        """Let the cars read what they will measure when the next command begins."""
        now, period_s = self._newest, self.period_s
        begins_s = self._due_s + self._lead_s
        periods = max(0, round((begins_s - now.time_s) / period_s))
        to_act = [self._acting(now.time_s + n * period_s) for n in range(periods)]
        self.measured(
            [
                car.after(measured, [commands[i] for commands in to_act])
                for i, (car, measured) in enumerate(zip(self._cars, now.cars, strict=True))
            ]
        )

    def _acting(self, time_s: float) -> tuple[Command, ...]:
        """Return what the cars do, or have done, in the control period that begins at a time."""
        for _, message in reversed(self._sent):
            if message.at_s <= time_s + EPSILON_S:
                return message.cars
        return (Command(),) * self.welcome.cars
