"""Robots in lock-step in memory: the whole interface but its sockets, and no clock of this machine."""

from dataclasses import dataclass

import numpy as np
import pytest
from discrete.drawn import draw
from robots.made_keys import make_key

from craftsim.checking.judge import Judge
from craftsim.checking.setup import judge_on, set_up, setup_of
from craftsim.models.world import PhysicsWorld
from craftsim.robots.link import Link, Mirror
from craftsim.robots.server import Network, Service
from craftsim.robots.simulated import Memory


class Caller(Memory):
    """A connection in memory that a test may cut."""

    cut = False

    def send(self, data: bytes) -> None:
        if not self.cut:
            super().send(data)

    def receive(self, timeout_s: float) -> bytes | None:
        return None if self.cut else super().receive(timeout_s)


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
    """Return a function (size, cars, objects, network, seed) that makes robots."""

    def make(size, cars, objects=(), network: Network | None = None, seed: int = 0) -> Robots:
        grid, setup = draw(size, objects, cars), setup_of(drive="wheels")
        fleet = set_up(grid, setup, watch_contacts=False).executor.fleet
        rngs = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2)]
        driver = Caller(fleet, "", network or Network(), rngs)
        seen = PhysicsWorld(grid, setup.simulation, reset=False, machines=setup.machines)
        mirror = Mirror(seen)
        link = Link(driver, len(cars), setup.machines, mirror=mirror)
        judge = judge_on(seen, setup, None, False, link)
        return Robots(fleet.physics, driver.service, link, mirror, driver, judge)

    return make


@pytest.fixture(scope="session")
def key(tmp_path_factory):
    """Return the file of a key of robots."""
    return make_key(tmp_path_factory.mktemp("keys") / "robots.pem")


@pytest.fixture(scope="session")
def other_key(tmp_path_factory):
    """Return the file of another key."""
    return make_key(tmp_path_factory.mktemp("keys") / "other.pem")
