"""Small worlds, drawn in a line of code, in which skills act in physics."""

from collections.abc import Callable

import pytest
from drawn import draw

from craftsim.checking.judge import Judge
from craftsim.checking.setup import Setup, set_up
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld


def _physics(size, cars, objects=(), config: SimulationConfig | None = None) -> PhysicsWorld:
    return PhysicsWorld(draw(size, objects, cars), config)


def _judge(size, cars, objects=(), config: SimulationConfig | None = None) -> Judge:
    judge = set_up(draw(size, objects, cars), Setup(simulation=config or SimulationConfig()))
    assert judge.reading.problems == ()
    assert judge.reading.grid.same_visible(draw(size, objects, cars)), "the world is not what was drawn"
    return judge


@pytest.fixture(scope="session")
def make_site() -> Callable[..., PhysicsWorld]:
    """Return a function (size, cars, objects, config): rows of cars as in Grid.cars, objects (kind, cell, yaw)."""
    return _physics


@pytest.fixture(scope="session")
def make_checked() -> Callable[..., Judge]:
    """Return the same for a PhysicsWorld whose actions are checked; Kind.WALL stands where the map shows it."""
    return _judge
