"""A start that has come to rest once is taken again for every world of that start, with the same numbers."""

import numpy as np
import pytest

from craftsim.checking.setup import Setup, set_up
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import StartError
from craftsim.models.config import SimulationConfig
from craftsim.models.world import _kept


@pytest.fixture(autouse=True)
def _nothing_kept():
    _kept.cache_clear()


def _grid(y=1):
    grid = Grid.empty((4, 3, 2), 1)
    grid.cars[0, :4] = 1, y, 1, 0
    grid.kind[2, y, 1] = Kind.BLOCK
    return grid


def _numbers(physics):
    return np.concatenate(
        [physics.data.qpos, physics.data.qvel, physics.data.qacc_warmstart, physics.data.tree_asleep]
    )


def _moved(grid, setup):
    judge = set_up(grid, setup)
    start = _numbers(judge.physics)
    attempt = judge.perform(0, Action.MOVE_RIGHT)
    return start, attempt, _numbers(judge.physics)


def test_a_start_is_settled_once_and_goes_on_alike():
    first, second = _moved(_grid(), Setup()), _moved(_grid(), Setup())
    assert (_kept.cache_info().misses, _kept.cache_info().hits) == (1, 1)
    assert second[1] == first[1]
    for a, b in zip(first[::2], second[::2], strict=True):
        np.testing.assert_array_equal(a, b)


def test_another_start_configuration_or_goal_is_not_taken_for_it():
    config = SimulationConfig(settle_s=0.1)
    for grid, setup, goals in (
        (_grid(), Setup(), ()),
        (_grid(2), Setup(), ()),
        (_grid(), Setup(simulation=config), ()),
        (_grid(), Setup(), [(0, 0, 1)]),
    ):
        set_up(grid, setup, goals=goals)
    assert _kept.cache_info().misses == 4
    assert set_up(_grid(2), Setup()).grid.same_visible(_grid(2))


def test_a_start_that_cannot_be_is_refused_each_time():
    grid = _grid()
    grid.cars[0, :6] = 1, 1, 1, 0, Kind.BLOCK, 0
    grid.kind[2, 1, 1], grid.kind[1, 1, 1] = Kind.AIR, Kind.BLOCK
    for _ in range(2):
        with pytest.raises(StartError, match=r"stand .* mm in each other"):
            set_up(grid, Setup())
