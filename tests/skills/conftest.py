"""Small worlds, drawn in a line of code, in which skills act in physics."""

from collections.abc import Callable, Sequence

import pytest

from craftsim.discrete.grid import KINDS_WITH_YAW, SECOND_PART, Grid, beside
from craftsim.discrete.rules import Rules
from craftsim.models.config import SimulationConfig
from craftsim.models.site import Site
from craftsim.skills.executor import Executor
from craftsim.validation.attempts.checked_run import CheckedSite


def _draw(size, cars: Sequence[Sequence[int]], objects: Sequence[tuple] = ()) -> Grid:
    grid = Grid.empty(size, len(cars))
    for row, values in zip(grid.cars, cars, strict=True):
        row[: len(values)] = values
    for kind, cell, *yaw in objects:
        parts = [(kind, cell)]
        if kind in SECOND_PART:
            parts.append((SECOND_PART[kind], beside(cell, *yaw)))
        for part, where in parts:
            grid.kind[where] = part
            grid.yaw[where] = yaw[0] if kind in KINDS_WITH_YAW else 0
    grid.derive_marks()
    return grid


def _site(size, cars, objects=(), config: SimulationConfig | None = None) -> Site:
    return Site(_draw(size, cars, objects), config)


def _checked(size, cars, objects=(), config: SimulationConfig | None = None) -> CheckedSite:
    site = _site(size, cars, objects, config)
    checked = CheckedSite(site, Rules("physical"), Executor(site))
    assert checked.reading.problems == ()
    assert checked.reading.grid.same_visible(_draw(size, cars, objects)), "the world is not what was drawn"
    return checked


@pytest.fixture(scope="session")
def make_site() -> Callable[..., Site]:
    """Return a function (size, cars, objects, config): rows of cars as in Grid.cars, objects (kind, cell, yaw)."""
    return _site


@pytest.fixture(scope="session")
def make_checked() -> Callable[..., CheckedSite]:
    """Return the same for a Site whose actions are checked; Kind.WALL stands where the map shows it."""
    return _checked
