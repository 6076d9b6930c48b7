"""A car that is parked on an incline is held by its wheels, whatever its gears; on the flat nothing is commanded."""

import numpy as np
import pytest
from drawn import draw

from craftsim.discrete.grid import Grid, Kind
from craftsim.models.world import PhysicsWorld
from craftsim.skills.executor import Executor


def _moved_m(grid: Grid, gear_friction: float, held: bool = True) -> float:
    """Return how far the first car moves in 6 s with its gears' friction scaled, with or without an executor."""
    physics = PhysicsWorld(grid, reset=False)
    smooth = physics.baseline.copy()
    smooth.dof_frictionloss[physics.cars[0].wheel_dofs] *= gear_friction
    physics.set_baseline(smooth)
    physics.reset()
    start, _ = physics.free_body_state(physics.cars[0].base)
    advance = Executor(physics).advance if held else physics.advance
    for _ in range(300):
        advance()
    end, _ = physics.free_body_state(physics.cars[0].base)
    return float(np.linalg.norm(end - start))


@pytest.mark.parametrize("place", [(2, 0, 1, 0, Kind.BLOCK, 0, 1), (1, 0, 2, 0, Kind.BLOCK, 0, 2)])
def test_a_loaded_car_with_smooth_gears_is_held_on_the_slope(place):
    grid = draw((3, 1, 3), [(Kind.BLOCK, (0, 0, 1)), (Kind.BODY, (1, 0, 1), 0)], [place])
    assert _moved_m(grid, 0.6) < 4e-4
    assert _moved_m(grid, 0.6, held=False) > 1.2e-3


def _pushed_m(way_m: float) -> list[float]:
    """Push a car on the slope by so much to its side, and return how far it is away in the 4 s after that."""
    grid = draw((3, 1, 2), [(Kind.BODY, (1, 0, 1), 0)], [(1, 0, 2, 0)])
    physics = PhysicsWorld(grid)
    executor, base = Executor(physics), physics.cars[0].base
    start, _ = physics.free_body_state(base)
    physics.data.qpos[base.qpos + 1] += way_m
    away = []
    for _ in range(200):
        executor.advance()
        away.append(float(np.linalg.norm(physics.free_body_state(base)[0] - start)))
    return away


def test_a_car_that_crept_without_turning_its_wheels_goes_back():
    away = _pushed_m(0.003)
    assert min(away[:20]) > 2e-3, "it is not sure yet"
    assert away[-1] < 6e-4


def test_a_car_that_crept_by_less_than_it_can_be_sure_of_stays():
    away = _pushed_m(0.0008)
    assert max(away) - min(away) < 2e-4


def test_a_car_on_the_flat_is_left_alone():
    physics = PhysicsWorld(draw((1, 1, 2), cars=[(0, 0, 1, 0, Kind.BLOCK)]))
    executor = Executor(physics)
    for _ in range(50):
        executor.advance()
        assert not physics.data.ctrl.any()
