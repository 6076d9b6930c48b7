"""Motors that lag follow a commanded speed late, stop at once, and are the world's: the skills know nothing of them."""

import math
from dataclasses import replace

import numpy as np

from craftsim.checking.setup import Setup, set_up
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.models.measuring import Motors
from craftsim.models.randomization import NONE
from craftsim.models.sensing import SensorNoise
from craftsim.models.world import PhysicsWorld

GRID = Grid.empty((3, 1, 1), 1)


def _driven(motors, physics, command, periods):
    """Return the speeds that reach the servos."""
    told = []
    for _ in range(periods):
        motors.drive(0, command)
        told.append(physics.data.ctrl[physics.cars[0].wheel_actuators].copy())
    return np.array(told)


def test_a_commanded_speed_arrives_with_the_declared_time_constant_and_a_stop_at_once():
    physics = PhysicsWorld(GRID)
    motors = Motors(physics, 0.05)
    periods = np.arange(1, 11)[:, None]
    expected = 5.0 * (1 - np.exp(-periods * physics.config.control_period_s / 0.05))
    np.testing.assert_allclose(_driven(motors, physics, (5.0,) * 4, 10), np.tile(expected, 4), rtol=1e-12)
    assert not _driven(motors, physics, (0.0,) * 4, 1).any()


def test_a_setups_motor_lag_reaches_the_wheels():
    def way_m(lag_s):
        judge = set_up(GRID, Setup(randomization=replace(NONE, sensors=SensorNoise(motor_lag_s=lag_s))))
        judge.executor.begin(0, Action.MOVE_RIGHT)
        for _ in range(8):
            judge.executor.advance()
        return judge.physics.data.qpos.item(judge.physics.cars[0].base.qpos)

    assert not math.isclose(way_m(0.0), way_m(0.1), abs_tol=1e-3)
    assert way_m(0.1) < way_m(0.0)
