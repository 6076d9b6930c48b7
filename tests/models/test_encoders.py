"""Encoders count the turning of the wheels, no more and no less, and speeds are whole counts over a control period."""

import math
from dataclasses import replace

import numpy as np

from craftsim.discrete.grid import Grid
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.sensing import SensorNoise, Sensors
from craftsim.models.world import PhysicsWorld

STEP_RAD = 2 * math.pi / 4096
COUNTING = SensorNoise(encoder_step_rad=STEP_RAD)
WHEELS = {
    "forward": (8.0, 8.0, 8.0, 8.0),
    "left": (-8.0, 8.0, 8.0, -8.0),
    "turning": (-5.0, 5.0, -5.0, 5.0),
    "in an arc": (3.0, 9.0, 3.0, 9.0),
}
CAR = NOMINAL.cars[0]


def _driven(drive: str, wheels: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Drive a car for a second; return the readings of its speeds (50, 4), its way and its wheels' turning."""
    physics = PhysicsWorld(Grid.empty((5, 5, 1), 1), machines=replace(NOMINAL, drive=drive))
    sensors, car = Sensors(physics, COUNTING, np.random.default_rng(0)), physics.cars[0]
    joints = physics.model.jnt_qposadr[physics.model.dof_jntid[car.wheel_dofs]]
    speeds, poses, turned = [], [], []
    for _ in range(51):
        poses.append(physics.data.qpos[car.base.qpos : car.base.qpos + 7].copy())
        turned.append(physics.data.qpos[joints].copy())
        physics.drive(0, wheels)
        physics.advance()
        sensors.observe()
        speeds.append(sensors.measure(0).wheel_speeds)
    return np.array(speeds[:-1]), np.array(poses), np.array(turned)


def test_the_counts_of_a_wheel_on_an_axle_add_up_to_its_turning_within_one_count():
    for wheels in WHEELS.values():
        speeds, _, turned = _driven("rollers", wheels)
        counted = 0.02 * speeds.cumsum(axis=0)
        assert abs(counted - (turned[1:] - turned[0])).max() < STEP_RAD * (1 + 1e-9)
        counts = 0.02 * speeds / STEP_RAD
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
        assert np.unique(np.round(counts[25:])).size > 1


def test_the_wheels_of_the_reduced_drive_turn_as_far_as_the_car_rolls():
    for motion in ("forward", "left", "turning"):
        wheels = WHEELS[motion]
        speeds, poses, _ = _driven("reduced", wheels)
        # Of a wheel that rolls without slip.
        heading = 2 * np.unwrap(np.arctan2(poses[:, 6], poses[:, 3]))
        way = np.hypot(*(poses[-1, :2] - poses[0, :2]))
        rolled = CAR.turn_radius_m * abs(heading[-1] - heading[0]) if motion == "turning" else way
        expected = np.sign(wheels) * rolled / CAR.wheel_radius_m
        np.testing.assert_allclose(
            0.02 * speeds.sum(axis=0), expected, atol=STEP_RAD + 2e-4 * abs(expected).max()
        )
