"""A recorded run, and a page of the viewer."""

import pytest

from craftsim import Action, Grid, LiveView, Trajectory
from craftsim.checking.episode import Recipe, Step, do, start
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Kind
from craftsim.rendering.recorder import Recorder
from craftsim.rendering.viewer.page import REAL_TIME

ACTIONS = (Action.ROTATE_LEFT, Action.MOVE_RIGHT)


@pytest.fixture(scope="session")
def run() -> Trajectory:
    grid = Grid.empty((3, 2, 1), n_cars=1)
    grid.kind[2, 0, 1] = Kind.BLOCK
    recipe = Recipe(blueprint_text(grid), tuple(Step.single(n, 0, act) for n, act in enumerate(ACTIONS)))
    judge, recorder = start(recipe), Recorder()
    recorder.begin(judge)
    attempts = [attempt for step in recipe.steps for attempt in do(judge, step)]
    return recorder.trajectory("a <turn> and a *move*", recipe, attempts)


@pytest.fixture
def opened():
    with LiveView(port=0, speed=REAL_TIME) as opened:
        yield opened
