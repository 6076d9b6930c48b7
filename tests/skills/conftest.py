"""Small worlds, drawn in a line of code, in which skills act in physics."""

from collections.abc import Callable

import pytest
from drawn import draw

from craftsim.checking.judge import CheckedSite
from craftsim.checking.setup import Setup, set_up
from craftsim.models.config import SimulationConfig
from craftsim.models.world import Site


def _site(size, cars, objects=(), config: SimulationConfig | None = None) -> Site:
    return Site(draw(size, objects, cars), config)


def _checked(size, cars, objects=(), config: SimulationConfig | None = None) -> CheckedSite:
    checked = set_up(draw(size, objects, cars), Setup(simulation=config or SimulationConfig()))
    assert checked.reading.problems == ()
    assert checked.reading.grid.same_visible(draw(size, objects, cars)), "the world is not what was drawn"
    return checked


@pytest.fixture(scope="session")
def make_site() -> Callable[..., Site]:
    """Return a function (size, cars, objects, config): rows of cars as in Grid.cars, objects (kind, cell, yaw)."""
    return _site


@pytest.fixture(scope="session")
def make_checked() -> Callable[..., CheckedSite]:
    """Return the same for a Site whose actions are checked; Kind.WALL stands where the map shows it."""
    return _checked
