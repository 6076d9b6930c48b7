"""A car that is parked on an incline is held by its wheels, whatever its gears; on the flat nothing is commanded."""

import numpy as np
import pytest
from drawn import draw

from craftsim.discrete.grid import Grid, Kind
from craftsim.models.world import Site
from craftsim.skills.executor import Executor


def _moved_m(grid: Grid, gear_friction: float, held: bool = True) -> float:
    """Return how far the first car moves in 10 s with its gears' friction scaled, with or without an executor."""
    site = Site(grid, reset=False)
    smooth = site.baseline.copy()
    smooth.dof_frictionloss[site.cars[0].wheel_dofs] *= gear_friction
    site.set_baseline(smooth)
    site.reset()
    start, _ = site.free_body_state(site.cars[0].base)
    advance = Executor(site).advance if held else site.advance
    for _ in range(500):
        advance()
    end, _ = site.free_body_state(site.cars[0].base)
    return float(np.linalg.norm(end - start))


@pytest.mark.parametrize("place", [(2, 0, 1, 0, Kind.BLOCK, 0, 1), (1, 0, 2, 0, Kind.BLOCK, 0, 2)])
def test_a_loaded_car_with_smooth_gears_is_held_on_the_slope(place):
    grid = draw((3, 1, 3), [(Kind.BLOCK, (0, 0, 1)), (Kind.BODY, (1, 0, 1), 0)], [place])
    assert _moved_m(grid, 0.6) < 4e-4
    assert _moved_m(grid, 0.6, held=False) > 2e-3


def test_a_car_on_the_flat_is_left_alone():
    site = Site(draw((1, 1, 2), cars=[(0, 0, 1, 0, Kind.BLOCK)]))
    executor = Executor(site)
    for _ in range(50):
        executor.advance()
        assert not site.data.ctrl.any()
