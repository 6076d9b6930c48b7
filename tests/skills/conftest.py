"""Small worlds, drawn in a line of code, in which skills act in physics."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from discrete.drawn import draw

from craftsim.checking.judge import Judge
from craftsim.checking.setup import Setup, set_up
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld


def _judge(size, cars, objects=(), drive="rollers") -> Judge:
    machines, grid = replace(NOMINAL, drive=drive), draw(size, objects, cars)
    judge = set_up(grid, Setup(machines=machines, simulation=SimulationConfig()))
    assert judge.reading.problems == ()
    assert judge.reading.grid.same_visible(grid), "the world is not what was drawn"
    return judge


@pytest.fixture(scope="session")
def make_site() -> Callable[..., PhysicsWorld]:
    """Return a function (size, cars, objects): rows of cars as in Grid.cars, objects (kind, cell, yaw)."""
    return lambda size, cars, objects=(): PhysicsWorld(draw(size, objects, cars))


@pytest.fixture(scope="session")
def make_checked() -> Callable[..., Judge]:
    """Return the same, with a drive, for a world whose actions are checked; Kind.WALL stands where the map shows it."""
    return _judge
