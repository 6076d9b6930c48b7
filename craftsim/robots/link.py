"""Robots on a network as a fleet that an executor drives, and their world as a judge sees it.

One control period is that of the robots' clock: it is over when a measurement has come that is younger by a period.
Commands say when they are to begin, late enough for all but a few to be there by then, so that a delay that varies
does no harm; and the skills are given what the robots will measure at that time (:mod:`craftsim.robots.extrapolation`).
Poses are estimated from what was measured, before that: what is extrapolated would hide how old localisations are.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, Protocol

import numpy as np

from craftsim.checking.judge import Judge
from craftsim.checking.setup import Setup, judge_on
from craftsim.compiled.arrays import Records
from craftsim.compiled.jit import records
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M
from craftsim.discrete.grid import Cell, Grid
from craftsim.errors import InputError
from craftsim.mjcf.machines import Machines
from craftsim.models.measuring import READING, write_reading
from craftsim.models.world import PhysicsWorld
from craftsim.robots.extrapolation import Extrapolation
from craftsim.robots.fleet import RemoteCars
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
    TruePoses,
    Welcome,
    pack,
    unpack,
)
from craftsim.skills.skill import Command

_TIMEOUT_S: Final = 1.0
"""Time without a message after which robots are lost, by the clock of the transport."""
_GREETED_S: Final = 5.0
"""How long robots may take to answer the first message: they may be about to start."""
_AGAIN_S: Final = 0.2
"""Time after which robots that obey another driver are asked again."""
_LISTENED: Final = 25
"""Control periods in which the delay of commands is measured at first."""
_REMEMBERED: Final = 50
"""Control periods whose delays are remembered."""
_SPARE_S: Final = 0.01
"""Margin beyond the longest of these delays."""
_MOST_LEAD_S: Final = 0.5
_MOST_BEHIND_S: Final = 1.0
"""Largest lead of the robots' clock over the driver during an action."""
_AT_ONCE: Final = 4096
"""Messages that are taken at once: more than wait in a connection."""
_EPSILON_S: Final = 1e-6
_AROUND_M: Final = 10.0
"""Measured positions may be so far outside the world."""
_KEPT: Final = 64
"""TruePoses that are kept: those of a measurement arrive before it."""
_AHEAD_S: Final = 12.0
"""Largest difference of the clocks of referee and robots: as much as a network can delay."""


class Messenger(Protocol):
    """A transport of messages to robots and back."""

    @property
    def now_s(self) -> float:
        """Time in seconds by which waiting for a message ends: of this machine, or of robots that are simulated."""

    def send(self, data: bytes) -> None:
        """Send a message; it may be lost."""

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message that comes in time, or None; raise ConnectionError where none can come any more."""

    def close(self) -> None:
        """Close the connection."""


def world_digest(grid: Grid) -> str:
    """Return the SHA-256 of a world, by which robots and who drives them know that they mean the same."""
    return hashlib.sha256(blueprint_text(grid).encode()).hexdigest()


def connect(
    transport: Messenger,
    grid: Grid,
    setup: Setup,
    goals: Sequence[Cell] = (),
    timeout_s: float = _TIMEOUT_S,
) -> Judge:
    """Return the judge, blind to contacts, of robots that should stand in a world, driven until the fleet is closed.

    Raises InputError where they do not answer or refuse, or where no referee shows their world.
    """
    try:
        physics = PhysicsWorld(grid, setup.simulation, goals, reset=False, machines=setup.machines)
        link = Link(
            transport,
            grid.n_cars,
            setup.machines,
            world_digest(grid),
            timeout_s,
            mirror=Mirror(physics),
        )
    except BaseException:
        transport.close()
        raise
    return judge_on(physics, setup, watch_contacts=False, fleet=link)


class Mirror:
    """Shows on a PhysicsWorld, which is never stepped, where everything truly is, and boards where they were measured.

    Velocities are what changed since what was shown before; wheels stand still.
    """

    def __init__(self, physics: PhysicsWorld) -> None:
        self.physics = physics
        self._seen: deque[TruePoses] = deque(maxlen=_KEPT)

    def take(self, poses: TruePoses) -> None:
        """Keep poses that are newer; raise MessageError for what cannot be of this world."""
        n_cars = len(self.physics.cars)
        n_slopes = len(self.physics.slopes)
        counts = len(poses.cars), len(poses.things), len(poses.hinges)
        expected = n_cars, len(self.physics.pose_places) - n_cars, n_slopes
        if counts != expected:
            raise MessageError(
                f"{counts[0]} cars, {counts[1]} things and {counts[2]} hinges; "
                f"there are {expected[0]}, {expected[1]} and {expected[2]}"
            )
        if not _inside(self.physics.size, [*poses.cars, *poses.things]):
            raise MessageError("poses outside the world")
        if not self._seen or poses.time_s > self._seen[-1].time_s + _EPSILON_S:
            self._seen.append(poses)

    def knows(self, time_s: float) -> bool:
        """Return whether the poses of a time, or later ones, have come."""
        return bool(self._seen) and self._seen[-1].time_s >= time_s - _EPSILON_S

    def show(self, measured: Measurements) -> str:
        """Show how things stood when that was measured; return why that cannot be, or nothing."""
        poses = next(poses for poses in self._seen if poses.time_s >= measured.time_s - _EPSILON_S)
        if poses.time_s > measured.time_s + _AHEAD_S:
            return f"the referee's clock shows {poses.time_s:g} s where the robots measure {measured.time_s:g} s"
        physics = self.physics
        data = self.physics.data
        places = physics.pose_places
        rows = np.array((*poses.cars, *poses.things))
        passed_s = poses.time_s - data.time
        if passed_s > 0:
            data.qvel[physics.speed_places] = (rows[:, :3] - data.qpos[places[:, :3]]) / passed_s
        data.qpos[places] = rows
        for slope, hinge in zip(physics.slopes, poses.hinges, strict=True):
            data.qpos[slope.hinge.qpos] = hinge
        for car, measurement in zip(physics.cars, measured.cars, strict=True):
            data.qpos[car.board.qpos] = measurement.board_m
        data.time = poses.time_s
        physics.capped_steps = poses.capped_steps
        return ""


def _inside(size: Cell, places: Sequence[Sequence[float]]) -> bool:
    """Return whether (n, 3) in metres, or poses, are about a world of a size in cells."""
    ends = np.array(size) * (CELL_PITCH_M, CELL_PITCH_M, LEVEL_HEIGHT_M)
    at = np.array(places)[:, :3]
    return bool(((at >= -_AROUND_M) & (at <= ends + _AROUND_M)).all())


class Link(RemoteCars):
    """A connection to robots: what they are commanded is sent to them, and what they will measure is read."""

    def __init__(
        self,
        transport: Messenger,
        n_cars: int,
        machines: Machines,
        world: str = "",
        timeout_s: float = _TIMEOUT_S,
        mirror: Mirror | None = None,
    ) -> None:
        """Say hello to the robots, and listen for half a second how long messages take.

        ``world`` is the digest of that in which they should stand; without a message of use for ``timeout_s`` they are
        lost, and so is a car whose clock stands so long; ``mirror`` shows what their referee says.

        Raises InputError where nobody answers, or they refuse.
        """
        self._transport = transport
        self._timeout_s = timeout_s
        self._mirror = mirror
        self.lost = ""
        self._dead = False
        self._dropped, self._why_dropped = 0, ""
        """Messages that were none, or said what cannot be, and why the last one, in brackets."""
        self.welcome = self._greet(n_cars, world)
        period_s = self.period_s = self.welcome.period_s
        super().__init__(n_cars, self.welcome.slopes, math.ceil(timeout_s / period_s))
        self._ahead = records(n_cars, READING)
        """(n,) READING: what the cars will measure when the next command begins, beside poses of 0."""
        self._cars = [Extrapolation(machines.car(car), machines, period_s) for car in range(n_cars)]
        self._sent: deque[tuple[float, Commands]] = deque(
            maxlen=round(2 * _MOST_LEAD_S / period_s) + _REMEMBERED
        )
        """The newest commands last, each with the lead that it had."""
        self._takes: deque[float] = deque(maxlen=_REMEMBERED)
        self._lead_s = 0.0
        """Time from a measurement to the beginning of the commands that answer it."""
        self._number = 0
        self._first = 1
        self._owed: list[int] = []
        self._newest = Measurements(0, -math.inf, 0, 0.0, 0, ())
        self._wait_until(lambda: bool(self._newest.cars), "the robots measure nothing")
        if not self.lost:
            self.measured(self._newest.cars)
            self._due_s = self._newest.time_s
            self._stops = self._newest.stops
        for _ in range(_LISTENED):
            self.advance()
        if self.lost:
            raise InputError(self.lost)

    @property
    def late_periods(self) -> int:
        """Control periods until what is commanded now has been done and seen."""
        return round(self._lead_s / self.period_s) + 1

    def read(self) -> Records:
        """Return what the cars have measured since the last control period, shape (n,) of READING."""
        return self.readings

    def ahead(self, readings: Records) -> Records:
        """Return what the cars will measure when the next command begins, (n,) of READING, a new array.

        ``readings`` are those of :meth:`read`, or have estimated poses.
        """
        ahead = self._ahead.copy()
        forward = self._ahead["x"]
        leftward = self._ahead["y"]
        c = np.cos(readings["heading"])
        s = np.sin(readings["heading"])
        ahead["x"] = readings["x"] + c * forward - s * leftward
        ahead["y"] = readings["y"] + s * forward + c * leftward
        heading = readings["heading"] + self._ahead["heading"]
        ahead["heading"] = np.arctan2(np.sin(heading), np.cos(heading))
        for name in ("position_std_m", "heading_std_rad"):
            ahead[name] = readings[name]
        return ahead

    def attend(self) -> None:
        """Take up with the robots' clock, which has gone on."""
        if self._dead:
            return
        self.lost = ""
        self._first = self._number + 1
        takes_s = max(self._takes, default=0.0)
        if takes_s > _EPSILON_S:
            takes_s += _SPARE_S
        lead_s = math.ceil(takes_s / self.period_s - _EPSILON_S) * self.period_s
        self._lead_s = min(max(lead_s, 0.0), _MOST_LEAD_S)
        self._take_all()
        self._listen_until(self._newest.time_s + self.period_s)
        self._due_s = self._newest.time_s
        self._stops = self._newest.stops
        self._predict()

    def advance(self, observe: Callable[[], None] | None = None) -> None:
        """Send the commands, and wait until a control period of the robots is over."""
        if self.lost:
            return
        self._number += 1
        message = Commands(self._number, self._due_s + self._lead_s, self.commands)
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
            self.lost = (
                f"the robots had no command for {1e3 * self.welcome.watchdog_s:.0f} ms, and stopped"
            )
        elif ahead_s > _MOST_BEHIND_S and not self.lost:
            self.lost = (
                f"the clock of the robots was {ahead_s:.4g} s ahead of what they were commanded"
            )
        self._predict()
        self._show()

    def stop(self, car: int) -> None:
        """Command a car's motors to zero, and the hinge of its slope; tell the robots at once, unless it is lost."""
        super().stop(car)
        if car in self.lost_cars:
            return
        self._number += 1
        self._transport.send(pack(Commands(self._number, 0.0, self.commands)))

    def close(self) -> None:
        """Let go of the robots, and close the connection."""
        self._transport.send(pack(Bye()))
        self._transport.close()

    def _greet(self, n_cars: int, world: str) -> Welcome:
        hello = pack(Hello(n_cars, world))
        self._transport.send(hello)
        deadline = self._transport.now_s + max(_GREETED_S, self._timeout_s)
        while (left_s := deadline - self._transport.now_s) > 0:
            message = self._message(left_s)
            if self.lost:
                raise InputError(f"{self.lost}; is it craftsim robot that listens there?")
            if isinstance(message, Refused):
                if not message.busy or left_s < 2 * _AGAIN_S:
                    raise InputError(message.why)
                time.sleep(_AGAIN_S)
                self._transport.send(hello)
            if isinstance(message, Welcome):
                self._check(message, n_cars)
                return message
        raise InputError(
            f"no robots answer within {max(_GREETED_S, self._timeout_s):g} s{self._why_dropped}; "
            "start some with: craftsim robot serve"
        )

    def _check(self, welcome: Welcome, n_cars: int) -> None:
        if welcome.cars != n_cars:
            raise InputError(f"{welcome.cars} robots answer, and there should be {n_cars}")
        if self._mirror is None:
            return
        n_slopes = len(self._mirror.physics.slopes)
        period_s = self._mirror.physics.config.control_period_s
        if welcome.slopes != n_slopes:
            raise InputError(
                f"the robots know of {welcome.slopes} slopes, and there are {n_slopes}"
            )
        if abs(welcome.period_s - period_s) > 1e-9:
            raise InputError(
                f"the robots' control period is {welcome.period_s:g} s, and that of the skills {period_s:g} s"
            )
        if not welcome.referee:
            raise InputError("nobody shows the world of these robots: there is no referee")

    def _show(self) -> None:
        if self._mirror is None or self.lost:
            return
        mirror = self._mirror
        measured = self._newest
        self._wait_until(
            lambda: mirror.knows(measured.time_s), "the referee has shown nothing of use"
        )
        if not self.lost:
            problem = mirror.show(measured)
            if problem:
                self._lose(problem)

    def _listen_until(self, time_s: float) -> None:
        self._wait_until(
            lambda: self._newest.time_s >= time_s - _EPSILON_S, "nothing has come from the robots"
        )

    def _wait_until(self, is_there: Callable[[], bool], problem: str) -> None:
        """Take messages until something is there; the robots are lost, with a reason, where it is not in time."""
        deadline = self._transport.now_s + self._timeout_s
        while not self.lost and not is_there():
            for number in self._owed:
                self._transport.send(pack(Ack(number)))
            self._owed.clear()
            left_s = deadline - self._transport.now_s
            # What is of no use does not count, however much of it comes.
            if (left_s <= 0 or not self._take(left_s)) and not self.lost:
                self._lose(f"{problem} for {self._timeout_s:g} s{self._why_dropped}")

    def _take_all(self) -> None:
        for _ in range(_AT_ONCE):
            if not self._take(0.0):
                break

    def _take(self, timeout_s: float) -> bool:
        """Take the next message that comes in time; return whether there was one."""
        before = self._dropped
        message = self._message(timeout_s)
        if isinstance(message, Bye):
            self._lose(f"the robots have ended{': ' if message.why else ''}{message.why}")
        elif isinstance(message, Measurements):
            if self.welcome.waits:
                self._owed.append(message.number)
            if message.number > self._newest.number and self._fits(message):
                if self._newest.cars:
                    self._learn(message)
                self._newest = message
        elif isinstance(message, TruePoses) and self._mirror is not None:
            try:
                self._mirror.take(message)
            except MessageError as error:
                self._drop(str(error))
        return message is not None or self._dropped > before

    def _fits(self, message: Measurements) -> bool:
        """Return whether measurements are newer, of these cars where they can be, and of slopes that there are."""
        problem = ""
        before_s = self._newest.time_s
        if len(message.cars) != self.welcome.cars:
            problem = f"measurements of {len(message.cars)} cars; there are {self.welcome.cars}"
        elif message.time_s <= before_s:
            problem = f"a clock that went from {before_s:g} s to {message.time_s:g} s"
        for car, measurement in enumerate(message.cars):
            place = measurement.x, measurement.y, measurement.z
            if measurement.slope is not None and measurement.slope >= self.welcome.slopes:
                problem = f"car {car} docked to slope {measurement.slope}; there are {self.welcome.slopes}"
            elif self._mirror is not None and not _inside(self._mirror.physics.size, [place]):
                problem = f"car {car} at ({measurement.x:g}, {measurement.y:g}, {measurement.z:g}) m, outside the world"
        if problem:
            self._drop(problem)
        return not problem

    def _drop(self, problem: str) -> None:
        self._dropped += 1
        self._why_dropped = f" (dropped: {problem})"

    def _learn(self, message: Measurements) -> None:
        """Learn from measurements how long commands take, and how fast wheels turn."""
        if message.heard > self._newest.heard:
            leads = (lead_s for lead_s, sent in self._sent if sent.number == message.heard)
            self._takes.extend(lead_s + message.late_s for lead_s in leads)
        acted = self._acting(message.time_s - self.period_s)
        # Over a longer gap robots stand; wheels that do not, by a clock that leaps, cannot be reckoned with.
        gap_s = min(message.time_s - self._newest.time_s, _MOST_BEHIND_S)
        periods = round(gap_s / self.period_s)
        for car, measurement, command in zip(self._cars, message.cars, acted, strict=True):
            car.note(measurement, command, periods)

    def _message(self, timeout_s: float) -> Message | None:
        """Return the next message that comes in time, if it is one; the robots are lost where none can come."""
        try:
            data = self._transport.receive(timeout_s)
            if data is None:
                return None
            return unpack(data)
        except ConnectionError as error:
            self._lose(str(error))
        except MessageError as error:
            self._drop(str(error))
        return None

    def _lose(self, problem: str) -> None:
        self.lost = problem
        self._dead = True

    def _predict(self) -> None:
        newest = self._newest
        period_s = self.period_s
        begins_s = self._due_s + self._lead_s
        periods = max(0, round((begins_s - newest.time_s) / period_s))
        to_act = [self._acting(newest.time_s + n * period_s) for n in range(periods)]
        measurements = []
        for number, (car, newly_measured) in enumerate(zip(self._cars, newest.cars, strict=True)):
            measurement = car.since(newly_measured)
            measurements.append(measurement)
            commands = [tick[number] for tick in to_act]
            at_origin = measurement._replace(x=0.0, y=0.0, heading=0.0)
            write_reading(car.after(at_origin, commands), self._ahead[number : number + 1])
        self.measured(measurements)

    def _acting(self, time_s: float) -> tuple[Command, ...]:
        """Return what the cars do, or have done, in the control period that begins at a time."""
        for _, message in reversed(self._sent):
            if message.at_s <= time_s + _EPSILON_S:
                return message.cars
        return (Command(),) * self.welcome.cars
