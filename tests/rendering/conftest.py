"""A recorded run, and a page of the viewer."""

import pytest
from rendering.recorded import record

from craftsim import Action, Grid, LiveView, Trajectory
from craftsim.discrete.grid import Kind
from craftsim.rendering.viewer.page import REAL_TIME


@pytest.fixture(scope="session")
def run() -> Trajectory:
    grid = Grid.empty((3, 2, 1), n_cars=1)
    grid.kind[2, 0, 1] = Kind.BLOCK
    return record(grid, Action.ROTATE_LEFT, Action.MOVE_RIGHT, title="a <turn> and a *move*")


@pytest.fixture
def opened():
    with LiveView(port=0, speed=REAL_TIME) as opened:
        yield opened
