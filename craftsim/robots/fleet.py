"""Robots of this process as a fleet that an executor drives. For a real machine, implement Robot."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Protocol

import numpy as np

from craftsim.compiled.arrays import Records
from craftsim.compiled.jit import records
from craftsim.models.measuring import READING, CarMeasurement, write_reading
from craftsim.skills.skill import Command
from craftsim.workers.copying import NotCopyable

PATIENCE: Final = 50
"""Control periods, 1 s of the usual ones, after which a car that does not answer is lost."""


class Robot(Protocol):
    """One car."""

    def measure(self) -> CarMeasurement:
        """Return what it measures now, at once; ``time_s`` is its own clock, and all robots of a fleet share it.

        The same ``time_s`` again says that it does not answer.
        """

    def command(self, command: Command) -> None:
        """Give its motors these speeds, until the next command comes; ``Command()`` stops them, and they hold."""


class RealClock:
    """The time of the world: each control period ends that long after the one before, however long it was used."""

    def __init__(
        self,
        period_s: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Begin the first period now; ``clock`` and ``sleep`` are in seconds."""
        self._period_s = period_s
        self._clock = clock
        self._sleep = sleep
        self._end_s = clock() + period_s
        self.overruns = 0
        """Periods that were over before they were waited for; they are not made up for."""

    def wait(self) -> None:
        """Sleep until the period is over."""
        left_s = self._end_s - self._clock()
        if left_s > 0:
            self._sleep(left_s)
        else:
            self.overruns += 1
            self._end_s -= left_s
        self._end_s += self._period_s


class RemoteCars(NotCopyable):
    """Last measurements and commands of n cars that are not of a PhysicsWorld."""

    _instead = "there is one of each robot: copy a world whose cars are simulated"

    def __init__(self, n_cars: int, n_slopes: int, patience: int = PATIENCE) -> None:
        """Command nothing. A car whose clock stands for ``patience`` periods is lost."""
        self.readings: Records = records(n_cars, READING)
        """(n,) READING: what was measured last."""
        self.commands: tuple[Command, ...] = (Command(),) * n_cars
        self._n_slopes = n_slopes
        self.lost_cars: Mapping[int, str] = {}
        self._patience = patience
        """Number of periods without an answer after which a car is lost."""
        self._silent = np.zeros(n_cars, np.int64)
        """(n,): for how many periods each car has not answered."""

    def measured(self, measurements: Sequence[CarMeasurement]) -> None:
        """Take a measurement of each car. Raises ValueError for other slopes than there are."""
        before = self.readings["time_s"].copy()
        for car, measurement in enumerate(measurements):
            if measurement.slope is not None and not 0 <= measurement.slope < self._n_slopes:
                raise ValueError(
                    f"car {car} is docked to slope {measurement.slope}, and there are {self._n_slopes}"
                )
            write_reading(measurement, self.readings[car : car + 1])
        self._silent = np.where(self.readings["time_s"] == before, self._silent + 1, 0)
        for car in np.flatnonzero(self._silent >= self._patience).tolist():
            reason = f"car {car} has not answered since {before[car]:.2f} s of its clock"
            self.lost_cars = {car: reason, **self.lost_cars}

    def begin(self, car: int) -> None:
        """Do nothing."""

    def command(self, cars: Records) -> None:
        """Take the commands of all cars; that of a hinge needs a slope."""
        slopes = cars["now"]["slope"].tolist()
        commands = []
        for (wheels, board, hinge), slope in zip(cars["command"].tolist(), slopes, strict=True):
            if slope < 0:
                hinge = 0.0
            commands.append(Command(tuple(wheels.tolist()), board, hinge))
        self.commands = tuple(commands)

    def stop(self, car: int) -> None:
        """Command a car's motors to zero, and the hinge of its slope."""
        self.commands = (*self.commands[:car], Command(), *self.commands[car + 1 :])


class RobotFleet(RemoteCars):
    """Some robots with a common clock, each control period measured at its start and commanded at once."""

    lost = ""
    late_periods = 0

    def __init__(
        self,
        robots: Sequence[Robot],
        wait: Callable[[], None],
        n_slopes: int = 0,
        patience: int = PATIENCE,
    ) -> None:
        """Drive these robots, in the order of their cars' ids, in a world with so many slopes.

        ``wait`` returns when one more control period has passed, such as that of a :class:`RealClock`.
        """
        super().__init__(len(robots), n_slopes, patience)
        self._robots = tuple(robots)
        self._wait = wait
        self.attend()

    def read(self) -> Records:
        """Return the newest readings of all cars."""
        return self.readings

    def ahead(self, readings: Records) -> Records:
        """Return the readings: commands begin at once."""
        return readings

    def attend(self) -> None:
        """Measure anew: the robots' time has gone on."""
        self.measured([robot.measure() for robot in self._robots])

    def advance(self, observe: Callable[[], None] | None = None) -> None:
        """Command the robots, wait until the control period is over, and measure; there are no physics steps."""
        for robot, command in zip(self._robots, self.commands, strict=True):
            robot.command(command)
        self._wait()
        self.attend()
