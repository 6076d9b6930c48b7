"""Robots of this process as a fleet that an executor drives."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from craftsim.models.measuring import Records
from craftsim.robots.robot import Clock, Robot
from craftsim.robots.wires import Harness


class RobotFleet:
    """Some robots with a common clock, each control period measured at its start and commanded at once."""

    lost = ""
    late_periods = 0

    def __init__(self, robots: Sequence[Robot], clock: Clock, n_slopes: int = 0) -> None:
        """Drive these robots, in the order of their cars' ids, in a world with so many slopes."""
        self._robots, self._clock = tuple(robots), clock
        self._harness = Harness(len(self._robots), n_slopes)
        self.wires = self._harness.wires
        self.attend()

    def read(self) -> Records:
        """Return the newest readings of all cars."""
        return self._harness.readings

    def attend(self) -> None:
        """Measure anew: the robots' time has gone on."""
        self._harness.measured([robot.measure() for robot in self._robots])

    def advance(self, observe: Callable[[], None] | None = None) -> None:
        """Command the robots, wait until the control period is over, and measure; there are no physics steps."""
        for robot, command in zip(self._robots, self._harness.commands(), strict=True):
            robot.command(command)
        self._clock.wait()
        self.attend()

    def stop(self, car: int, slope: int) -> None:
        """Command a car's motors to zero, and the hinge of a slope."""
        self._harness.stop(car, slope)
