"""Pictures of the environment in physics."""

import numpy as np
import pytest

from craftsim.discrete.actions import Action
from craftsim.envs import parallel_env

pytestmark = pytest.mark.usefixtures("rendering")


def test_a_picture_shows_the_physics_and_follows_it_and_other_starts():
    env = parallel_env("strip", "physics", render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (480, 640, 3)
    assert np.ptp(first) > 100
    env.step({"car_0": int(Action.MOVE_LEFT), "car_1": int(Action.STOP)})
    second = env.render()
    assert (first != second).any()
    env.reset(seed=0)
    np.testing.assert_array_equal(env.render(), first)
    grid = env.grid
    grid.cars[0, 0] = 3
    grid.derive_marks()
    env.reset(options={"grid": grid})
    assert (env.render() != first).any()
    env.close()
