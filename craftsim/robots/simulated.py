"""Simulated robots: the cars of a Site, behind the interface that real ones have."""

from __future__ import annotations

from craftsim.models.sensing import CarMeasurement
from craftsim.robots.robot import Robot
from craftsim.skills.fleet import SiteFleet
from craftsim.skills.skill import Command


class SimulatedRobot:
    """A car of a Site."""

    def __init__(self, world: SiteFleet, car: int) -> None:
        """Take car number ``car`` with its sensors and motors."""
        self._world, self._car, self._slope = world, car, -1

    def measure(self) -> CarMeasurement:
        """Return its newest measurement."""
        return self._world.sensors.measure(self._car)

    def command(self, command: Command) -> None:
        """Give its motors these speeds; a hinge turns while its plug is felt."""
        site = self._world.site
        self._world.motors.drive(self._car, command.wheels)
        site.move_board(self._car, command.board)
        slope = self.measure().slope
        slope = -1 if slope is None else slope
        if self._slope not in (-1, slope):
            site.turn_hinge(self._slope, 0.0)
        if slope >= 0:
            site.turn_hinge(slope, command.hinge)
        self._slope = slope


class SimulatedClock:
    """The time of a Site, which passes in its physics alone."""

    def __init__(self, world: SiteFleet) -> None:
        """Let the time of these cars pass."""
        self._world = world

    def wait(self) -> None:
        """Simulate one control period."""
        self._world.advance()


def simulated_robots(world: SiteFleet) -> tuple[Robot, ...]:
    """Return a robot for each car of a Site."""
    return tuple(SimulatedRobot(world, car) for car in range(len(world.site.cars)))
