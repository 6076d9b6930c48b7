"""Cars find out how much their motors lag, and lead by as much."""

import math

import numpy as np
import pytest

from craftsim.checking.settings import setup_of
from craftsim.checking.world import set_up
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.models.parameters import NOMINAL
from craftsim.models.sensing import SensorNoise
from craftsim.skills.ages import likeliest_age
from craftsim.skills.gains import load_gains
from craftsim.skills.leading import lead_wheels, leads
from craftsim.skills.state import constants_of

PERIOD_S = 0.02
CAR = constants_of(NOMINAL.cars[0], NOMINAL, load_gains(), PERIOD_S)[0]["car"]


def _turn(lag_s, n=60):
    """Let ideal motors of a lag follow a ramp; return the found lag and how far the wheels are behind at its end."""
    lead, speeds = leads(1, PERIOD_S)[0], np.zeros(4)
    share = 1 - math.exp(-PERIOD_S / lag_s) if lag_s else 1.0
    for k in range(n):
        wanted = np.full(4, 0.2 * (k + 1))
        commanded = wanted.copy()
        lead_wheels(lead, commanded, speeds, CAR, PERIOD_S, True)
        speeds += share * (commanded - speeds)
    return 0.01 * likeliest_age(lead["mismatches"])[0], float(wanted[0] - speeds[0])


@pytest.mark.parametrize("lag_s", [0.0, 0.015, 0.05, 0.08])
def test_wheels_keep_up_with_what_is_wanted_however_much_motors_lag(lag_s):
    found_s, behind = _turn(lag_s)
    assert found_s == pytest.approx(lag_s, abs=0.006)
    # Without a lead a ramp of 10 rad/s^2 would be behind by the lag.
    assert abs(behind) < 0.03


def test_wheels_that_lack_grip_are_not_taken_to_lag():
    lead, speeds = leads(1, PERIOD_S)[0], np.zeros(4)
    for k in range(30):
        commanded = np.full(4, 0.8 * (k + 1))
        lead_wheels(lead, commanded, speeds, CAR, PERIOD_S, True)
        # Prompt motors, whose wheels speed up by no more than this.
        speeds += np.minimum(commanded - speeds, 0.4)
    assert 0.01 * likeliest_age(lead["mismatches"])[0] < 0.025


def test_four_zeros_stop_at_once():
    lead = leads(1, PERIOD_S)[0]
    for commanded in (np.full(4, 3.0), np.zeros(4)):
        lead_wheels(lead, commanded, np.zeros(4), CAR, PERIOD_S, False)
    assert not commanded.any()
    assert not lead["servos"].any()


@pytest.mark.parametrize("action", [Action.MOVE_RIGHT, Action.ROTATE_LEFT])
def test_a_car_whose_motors_lag_by_50_ms_does_as_predicted(action):
    grid = Grid.empty((3, 1, 1), 1)
    attempt = set_up(grid, setup_of("none", noise=SensorNoise(motor_lag_s=0.05))).perform(0, action)
    assert attempt.agrees, attempt
