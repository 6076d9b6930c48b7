"""Simulated robots: the cars of a PhysicsWorld, behind the interface that real ones have."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from craftsim.checking.judge import Judge
from craftsim.checking.setup import Seed, SetUp, Setup, set_up
from craftsim.discrete.grid import Cell, Grid
from craftsim.errors import InputError
from craftsim.models.measuring import CarMeasurement
from craftsim.robots.fleet import Robot
from craftsim.robots.link import connect, world_digest
from craftsim.robots.server import Network, Service
from craftsim.skills.fleet import PhysicsFleet
from craftsim.skills.skill import Command

_SAME_S: Final = 1e-6
"""Largest difference of times that are the same: those of a world are sums of time steps."""
_AWAITED: Final = 1000
"""Events of the robots' time within which a message should arrive."""


class SimulatedRobot:
    """A car of a PhysicsWorld."""

    def __init__(self, world: PhysicsFleet, car: int, silent_s: float = math.inf) -> None:
        """Take car number ``car`` with its sensors and motors; from ``silent_s`` of its clock on it does not answer."""
        self._world = world
        self._car = car
        self._silent_s = silent_s
        self._last = self._measured

    @property
    def _measured(self) -> CarMeasurement:
        return self._world.sensors.measure(self._car)

    def measure(self) -> CarMeasurement:
        """Return its newest measurement, the last one before it fell silent."""
        measurement = self._measured
        if measurement.time_s < self._silent_s - _SAME_S:
            self._last = measurement
        return self._last

    def command(self, command: Command) -> None:
        """Give its motors these speeds, none once it is silent; a hinge turns while its plug is felt."""
        slope = self.measure().slope
        if self._measured.time_s >= self._silent_s - _SAME_S:
            command = Command()
        self._world.drive(self._car, command, -1 if slope is None else slope)


def simulated_robots(
    world: PhysicsFleet, silent: Iterable[tuple[int, float]] = ()
) -> tuple[Robot, ...]:
    """Return a robot for each car; some fall silent, at a second of their clocks. Raises InputError for no such car."""
    cars = range(len(world.physics.cars))
    since_s = dict(silent)
    unknown = since_s.keys() - cars
    if unknown:
        raise InputError(f"no car {min(unknown)} to fall silent; there are cars 0 to {cars[-1]}")
    return tuple(SimulatedRobot(world, car, since_s.get(car, math.inf)) for car in cars)


class Memory:
    """A connection to simulated robots of this process: their time passes while something is awaited from them."""

    name: Final = b"memory"

    def __init__(
        self,
        world: PhysicsFleet,
        digest: str,
        network: Network,
        rngs: Sequence[np.random.Generator],
    ) -> None:
        """Connect to the cars of a PhysicsWorld through a network, in lock-step; arguments are as for Service."""
        self.inbox = deque[bytes]()
        robots = simulated_robots(world, network.silent)
        self.service = Service(robots, world, self._take, network, rngs, digest, waits=True)

    @property
    def now_s(self) -> float:
        """The robots' time, in seconds: how fast this process is plays no part."""
        return self.service.now_s

    def _take(self, receiver: bytes, data: bytes) -> None:
        self.inbox.append(data)

    def send(self, data: bytes) -> None:
        """Send a message."""
        self.service.arrive(self.name, data, self.service.now_s)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next message that comes, or None where the robots wait for an answer, or nothing comes."""
        for _ in range(_AWAITED):
            if self.inbox or timeout_s <= 0 or self.service.unseen:
                break
            self.service.step()
        if self.inbox:
            return self.inbox.popleft()
        return None

    def close(self) -> None:
        """Close the connection."""
        self.service.depart(self.name)


def simulated_network(network: Network) -> SetUp:
    """Return what sets up worlds of simulated robots that are driven through a network, in this process.

    It is in lock-step: time passes while a message is awaited, and the same seed gives the same run, bit for bit.
    """

    def begin(grid: Grid, setup: Setup, seed: Seed, goals: Sequence[Cell]) -> Judge:
        world = set_up(grid, setup, seed, watch_contacts=False).executor.fleet
        assert isinstance(world, PhysicsFleet)
        rngs = [
            np.random.default_rng(s) for s in seed.sequence().spawn(5)[3:]
        ]  # others are those of set_up
        return connect(Memory(world, world_digest(grid), network, rngs), grid, setup, goals)

    return begin
