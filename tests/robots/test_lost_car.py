"""A robot that stops answering is waited for, named, and built around; a policy drives the others on."""

import numpy as np
import pytest

import craftsim
from craftsim.checking.setup import setup_of
from craftsim.discrete.files.design import Design
from craftsim.discrete.tasks import make_task
from craftsim.robots import simulated
from craftsim.robots.fleet import RobotFleet
from craftsim.robots.server import Network
from craftsim.robots.simulated import SimulatedClock, simulated_network, simulated_robots
from craftsim.skills.skill import Command

BUSY = Network(0.03, 0.01, 0.02)
WHY = r"car {} does not answer since [.\d]+ s of its clock"


class Silent:
    """A robot that hears and says nothing any more from a time on, and stops."""

    def __init__(self, robot, from_s):
        self.robot, self.from_s = robot, from_s
        self.last = robot.measure()

    def measure(self):
        now = self.robot.measure()
        self.last = now if now.time_s < self.from_s else self.last
        return self.last

    def command(self, command):
        self.robot.command(command if self.last is self.measure() and self.last.time_s < self.from_s else Command())
