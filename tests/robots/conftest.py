"""Robots in lock-step in memory: the whole interface but its sockets, and no clock of this machine."""

from collections import deque
from dataclasses import dataclass

import numpy as np
import pytest
from drawn import draw

from craftsim.checking.judge import Judge
from craftsim.checking.setup import judge_on, set_up, setup_of
from craftsim.models.world import PhysicsWorld
from craftsim.robots.connecting import Mirror
from craftsim.robots.link import Link
from craftsim.robots.server import Channel, Network, Service
from craftsim.robots.simulated import SimulatedClock, simulated_referee, simulated_robots


class Caller:
    """A connection in memory: what is awaited makes the robots' time pass."""

    def __init__(self, name: bytes, service: list[Service]) -> None:
        self.name, self._service = name, service
        self.inbox: deque[bytes] = deque()
        self.cut = False

    def send(self, data: bytes) -> None:
        if not self.cut:
            self._service[0].arrive(self.name, data, self._service[0].now_s)

    def receive(self, timeout_s: float) -> bytes | None:
        for _ in range(1000):
            if self.inbox or self.cut or timeout_s == 0 or self._service[0].unseen:
                break
            self._service[0].step()
        return self.inbox.popleft() if self.inbox and not self.cut else None


@dataclass
class Robots:
    """Simulated robots, a link to them, and the judge."""

    physics: PhysicsWorld
    """Their own world."""
    service: Service
    link: Link
    mirror: Mirror
    driver: Caller
    judge: Judge

    def pass_time(self, duration_s: float) -> None:
        """Let their time pass, whatever anybody answers."""
        end_s = self.service.now_s + duration_s
        while self.service.next_s < end_s - 1e-6:
            self.service.unseen.clear()
            self.service.step()


@pytest.fixture
def make_robots():
    """Return a function (size, cars, objects, network, seed) that makes robots with the reduced drive."""

    def make(size, cars, objects=(), network: Network | None = None, seed: int = 0) -> Robots:
        grid, setup = draw(size, objects, cars), setup_of(drive="reduced")
        fleet = set_up(grid, setup, watch_contacts=False).executor.fleet
        physics, made, callers = fleet.physics, [], {}
        up, down = (
            Channel(network or Network(), np.random.default_rng(s))
            for s in np.random.SeedSequence(seed).spawn(2)
        )
        service = Service(
            *(simulated_robots(fleet), SimulatedClock(fleet), (up, down)),
            *(lambda receiver, data: callers[receiver].inbox.append(data), 0.02, len(physics.slopes)),
            referee=simulated_referee(physics),
            waits=True,
        )
        made.append(service)
        for name in (b"driver", b"judge"):
            callers[name] = Caller(name, made)
        link = Link(callers[b"driver"], len(cars), setup.machines)
        seen = PhysicsWorld(grid, setup.simulation, reset=False, machines=setup.machines)
        mirror = Mirror(seen, callers[b"judge"])
        link.let_follow(mirror.follow)
        judge = judge_on(seen, setup, None, False, link)
        return Robots(physics, service, link, mirror, callers[b"driver"], judge)

    return make
