"""Ideal mecanum kinematics: twist and wheels undo each other, power agrees, and signs are those of the formula."""

import numpy as np
import pytest

from craftsim.discrete.kinds import Kind
from craftsim.mjcf.parameters import NOMINAL, SmartcarParameters
from craftsim.models.sensing import measure
from craftsim.skills.mecanum import Mecanum

SMARTCAR = NOMINAL.cars[0]

CAR = Mecanum(SMARTCAR)
R = 0.0496
LEVER = 0.060 + 0.083


def test_every_twist_survives_the_way_through_the_wheels():
    twist = np.array([0.3, -0.2, 1.7])
    np.testing.assert_allclose(CAR.body_twist(CAR.wheel_speeds(twist)), twist, atol=1e-12)


def test_torques_do_the_work_of_the_wrench_and_are_the_smallest_that_do():
    wrench, twist = np.array([2.0, -3.0, 0.5]), np.array([0.3, -0.2, 1.7])
    assert np.dot(CAR.wheel_torques(wrench), CAR.wheel_speeds(twist)) == pytest.approx(wrench @ twist)
    matrix = np.array([CAR.wheel_speeds(axis) for axis in np.eye(3)])
    np.testing.assert_allclose(CAR.wheel_torques(wrench), np.linalg.lstsq(matrix, wrench)[0], rtol=1e-12)
    np.testing.assert_allclose(CAR.wrench(CAR.wheel_torques(wrench)), wrench, rtol=1e-12)


def test_the_wheels_turn_as_the_formula_says():
    for twist, rim_speeds in (
        ((1, 0, 0), (1, 1, 1, 1)),
        ((0, 1, 0), (-1, 1, 1, -1)),
        ((0, 0, 1), (-LEVER, LEVER, -LEVER, LEVER)),
        ((1, 1, 1), (-LEVER, 2 + LEVER, 2 - LEVER, LEVER)),
    ):
        np.testing.assert_allclose(CAR.wheel_speeds(twist), np.array(rim_speeds) / R, rtol=1e-12)


def test_smaller_wheels_turn_faster_and_a_wider_car_turns_its_wheels_further():
    other = Mecanum(SmartcarParameters(wheel_radius_m=0.0490, wheel_y_m=0.09))
    np.testing.assert_allclose(other.wheel_speeds((1, 0, 0)), np.ones(4) / 0.0490)
    np.testing.assert_allclose(other.wheel_speeds((0, 0, 1)), 0.15 / 0.0490 * np.array([-1, 1, -1, 1]))


def test_a_car_feels_by_its_motors_what_pushes_against_it_and_what_it_carries(make_site):
    free = measure(make_site((1, 1, 1), [(0, 0, 1, 0)]), 0)
    felt = CAR.felt_forces(free, (0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose([*felt.wheels_n, *felt.wrench, felt.board_n], 0.0, atol=0.05)
    physics = make_site((1, 1, 2), [(0, 0, 1, 0, Kind.BLOCK)])
    for _ in range(50):
        physics.advance()
    carried_n = CAR.felt_forces(measure(physics, 0), (0.0,) * 4).board_n
    # The screw's friction takes its share of the weight.
    assert abs(carried_n - NOMINAL.block.mass_kg * 9.81) < SMARTCAR.screw_friction_n
    # Held at a wall, while its wheels are commanded to turn: as much as the motors give, less what gears take.
    pushing = CAR.felt_forces(free._replace(wheel_speeds=(0.0,) * 4), (50.0,) * 4)
    most = 4 * (SMARTCAR.wheel_torque_nm - SMARTCAR.gear_friction_nm) / R
    np.testing.assert_allclose(pushing.wrench, (most, 0.0, 0.0), atol=0.05)
