"""Cars find out how much their motors lag, and compensate for it."""

import math

import numpy as np
import pytest

from craftsim.checking.setup import set_up, setup_of
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.models.sensing import SensorNoise
from craftsim.models.world import PhysicsWorld
from craftsim.skills.estimator import likeliest_delay
from craftsim.skills.executor import Executor
from craftsim.skills.laws import LAG_STEP_S, compensate_lag

PERIOD_S = 0.02


def _car():
    """Return the record of a car that has not moved."""
    return Executor(PhysicsWorld(Grid.empty((1, 1, 1), 1)))._cars[0]


def _sent(car, wanted, turning, level=True):
    """Return what is commanded for wheels to have these speeds."""
    car["command"]["wheels"], car["now"]["wheel_speeds"] = wanted, turning
    compensate_lag(car, level)
    return car["command"]["wheels"].copy()


def _lag_s(car):
    return LAG_STEP_S * likeliest_delay(car["lag"]["mismatches"])[0]


def _turn(lag_s, n=60):
    """Let ideal motors of a lag follow a ramp; return the found lag and how far the wheels are behind at its end."""
    car, speeds = _car(), np.zeros(4)
    share = 1 - math.exp(-PERIOD_S / lag_s) if lag_s else 1.0
    for k in range(n):
        wanted = np.full(4, 0.2 * (k + 1))
        speeds += share * (_sent(car, wanted, speeds) - speeds)
    return _lag_s(car), float(wanted[0] - speeds[0])


@pytest.mark.parametrize("lag_s", [0.0, 0.015, 0.05, 0.08])
def test_wheels_keep_up_with_what_is_wanted_however_much_motors_lag(lag_s):
    found_s, behind = _turn(lag_s)
    assert found_s == pytest.approx(lag_s, abs=0.006)
    # Without compensation a ramp of 10 rad/s^2 would be behind by the lag.
    assert abs(behind) < 0.03


def test_wheels_that_lack_grip_are_not_taken_to_lag():
    car, speeds = _car(), np.zeros(4)
    for k in range(30):
        # Prompt motors, whose wheels speed up by no more than this.
        speeds += np.minimum(_sent(car, np.full(4, 0.8 * (k + 1)), speeds) - speeds, 0.4)
    assert _lag_s(car) < 0.025


def test_four_zeros_stop_at_once():
    car = _car()
    _sent(car, np.full(4, 3.0), np.zeros(4), level=False)
    assert not _sent(car, np.zeros(4), np.zeros(4), level=False).any()
    assert not car["lag"]["servos"].any()


@pytest.mark.parametrize("action", [Action.MOVE_RIGHT, Action.ROTATE_LEFT])
def test_a_car_whose_motors_lag_by_50_ms_does_as_predicted(action):
    grid = Grid.empty((3, 1, 1), 1)
    attempt = set_up(grid, setup_of("none", noise=SensorNoise(motor_lag_s=0.05))).perform(0, action)
    assert attempt.agrees, attempt
