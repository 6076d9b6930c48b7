"""Simulated robots: the cars of a PhysicsWorld, behind the interface that real ones have."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from craftsim.models.measuring import CarMeasurement, PoseReader
from craftsim.models.world import PhysicsWorld
from craftsim.robots.fleet import Robot
from craftsim.robots.messages import Measurements, TruePoses
from craftsim.robots.server import Channel, Network, Service
from craftsim.robots.sockets import Host
from craftsim.skills.fleet import PhysicsFleet
from craftsim.skills.skill import Command


class SimulatedRobot:
    """A car of a PhysicsWorld."""

    def __init__(self, world: PhysicsFleet, car: int) -> None:
        """Take car number ``car`` with its sensors and motors."""
        self._world, self._car, self._slope = world, car, -1

    def measure(self) -> CarMeasurement:
        """Return its newest measurement."""
        return self._world.sensors.measure(self._car)

    def command(self, command: Command) -> None:
        """Give its motors these speeds; a hinge turns while its plug is felt."""
        physics = self._world.physics
        self._world.motors.drive(self._car, command.wheels)
        physics.move_board(self._car, command.board)
        slope = self.measure().slope
        slope = -1 if slope is None else slope
        if self._slope not in (-1, slope):
            physics.turn_hinge(self._slope, 0.0)
        if slope >= 0:
            physics.turn_hinge(slope, command.hinge)
        self._slope = slope


class SimulatedClock:
    """The time of a PhysicsWorld, which passes in its physics alone."""

    def __init__(self, world: PhysicsFleet) -> None:
        """Let the time of these cars pass."""
        self._world = world

    def wait(self) -> None:
        """Simulate one control period."""
        self._world.advance()


def simulated_robots(world: PhysicsFleet) -> tuple[Robot, ...]:
    """Return a robot for each car of a PhysicsWorld."""
    return tuple(SimulatedRobot(world, car) for car in range(len(world.physics.cars)))


def simulated_referee(physics: PhysicsWorld) -> Callable[[Measurements], TruePoses]:
    """Return what says where everything in a PhysicsWorld truly is, at the time of some measurements."""
    reader, n_slopes = PoseReader(physics), len(physics.slopes)

    def see(measured: Measurements) -> TruePoses:
        poses = reader.read()
        cars = np.hstack([poses.car_positions, poses.car_quaternions])
        things = np.hstack([poses.positions, poses.quaternions])
        return TruePoses(
            measured.number,
            measured.time_s,
            tuple(map(tuple, cars.tolist())),
            tuple(map(tuple, things.tolist())),
            tuple(poses.hinges[len(poses.hinges) - n_slopes :].tolist()),
            physics.capped_steps,
        )

    return see


def serve_simulated(
    world: PhysicsFleet,
    digest: str,
    sockets: Host,
    network: Network,
    rngs: tuple[np.random.Generator, np.random.Generator],
    waits: bool,
    tell: Callable[[str], None],
) -> Service:
    """Return the service of the cars of a PhysicsWorld, whose digest is given.

    ``rngs`` draw what becomes of commands, and of measurements, in the network; the rest is as for Service.
    """
    physics = world.physics
    return Service(
        simulated_robots(world),
        SimulatedClock(world),
        (Channel(network, rngs[0]), Channel(network, rngs[1])),
        sockets.send,
        physics.config.control_period_s,
        len(physics.slopes),
        digest,
        simulated_referee(physics),
        waits,
        tell,
    )
