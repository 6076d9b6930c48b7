"""Many steps of MuJoCo in one compiled call are its own steps, and an error in one is an exception."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from craftsim.discrete.grid import Grid
from craftsim.mjcf.parameters import DRIVES, Machines
from craftsim.models import stepping
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld


def _world() -> PhysicsWorld:
    return PhysicsWorld(Grid.empty((2, 1, 1), n_cars=1), SimulationConfig(sleep=False))


@pytest.mark.parametrize("drive", DRIVES)
def test_many_are_those_of_the_bindings_one_after_the_other(drive):
    grid, config = Grid.empty((3, 1, 1), n_cars=1), replace(SimulationConfig(), sleep=False)
    many, single = (PhysicsWorld(grid, config, machines=Machines(drive=drive)) for _ in range(2))
    for world in (many, single):
        world.drive(0, [5.0, 4.0, 5.0, 4.0])
    many.run(200)
    for _ in range(200):
        single._stepping.run(0)  # turns motors as the car stands
        mujoco.mj_step(single.model, single.data)
        for after_step in single._step_effects:
            after_step(single)
    assert abs(many.data.qpos - many.model.qpos0).max() > 0.01
    np.testing.assert_array_equal(many.data.qpos, single.data.qpos)
    np.testing.assert_array_equal(many.data.qvel, single.data.qvel)


def test_without_batches_the_steps_are_the_same(monkeypatch):
    """As before MuJoCo 3.17."""
    grid, machines = Grid.empty((3, 1, 1), n_cars=1), Machines(drive="reduced")
    compiled = PhysicsWorld(grid, machines=machines)
    monkeypatch.setattr(stepping, "_HAS_BATCHES", False)
    plain = PhysicsWorld(grid, machines=machines)
    for world in (compiled, plain):
        world.drive(0, [5.0, 4.0, 5.0, 4.0])
        world.run(100)
    np.testing.assert_array_equal(compiled.data.qpos, plain.data.qpos)
    assert compiled.capped_steps == plain.capped_steps


def test_an_error_in_a_step_is_an_exception_and_the_world_can_go_on():
    physics = _world()
    integrator, physics.model.opt.integrator = physics.model.opt.integrator, 99
    with pytest.raises(mujoco.FatalError, match="integrator"):
        physics.run(3)
    physics.model.opt.integrator = integrator
    before = physics.time_s
    physics.run(2)
    assert physics.time_s == pytest.approx(before + 2 * physics.config.timestep_s)
