"""Ideal mecanum kinematics: twist and wheels undo each other, power agrees, and signs are those of the formula."""

import numpy as np
import pytest

from craftsim.models.parameters import NOMINAL
from craftsim.skills.mecanum import body_twist, wheel_speeds, wheel_torques

SMARTCAR = NOMINAL.cars[0]

R = 0.0496
LEVER = 0.060 + 0.083


def test_every_twist_survives_the_way_through_the_wheels():
    twist = np.array([0.3, -0.2, 1.7])
    np.testing.assert_allclose(body_twist(wheel_speeds(twist)), twist, atol=1e-12)


def test_torques_do_the_work_of_the_wrench_and_are_the_smallest_that_do():
    wrench, twist = np.array([2.0, -3.0, 0.5]), np.array([0.3, -0.2, 1.7])
    assert np.dot(wheel_torques(wrench), wheel_speeds(twist)) == pytest.approx(wrench @ twist)
    matrix = np.array([wheel_speeds(axis) for axis in np.eye(3)])
    np.testing.assert_allclose(wheel_torques(wrench), np.linalg.lstsq(matrix, wrench)[0], rtol=1e-12)


@pytest.mark.parametrize(
    ("twist", "rim_speeds"),
    [
        ((1, 0, 0), (1, 1, 1, 1)),
        ((0, 1, 0), (-1, 1, 1, -1)),
        ((0, 0, 1), (-LEVER, LEVER, -LEVER, LEVER)),
        ((1, 1, 1), (-LEVER, 2 + LEVER, 2 - LEVER, LEVER)),
    ],
    ids=["forward", "left", "counter-clockwise", "all three"],
)
def test_the_wheels_turn_as_the_formula_says(twist, rim_speeds):
    np.testing.assert_allclose(wheel_speeds(twist), np.array(rim_speeds) / R, rtol=1e-12)


def test_wheels_that_fight_each_other_give_no_twist():
    np.testing.assert_allclose(body_twist([1, 1, -1, -1]), 0.0, atol=1e-12)


def test_the_lever_and_the_radius_are_those_of_the_car():
    assert SMARTCAR.turn_radius_m == pytest.approx(LEVER)
    assert SMARTCAR.wheel_radius_m == pytest.approx(R)
