"""A car that does not get to its goal shakes across the way that is left, for two cycles out of four."""

import numpy as np
import pytest

from craftsim.discrete.kernel.jit import records
from craftsim.mjcf.parameters import NOMINAL
from craftsim.skills.gains import careful, load_gains
from craftsim.skills.laws import shake
from craftsim.skills.state import DRIVE_TASK, constants_of

ERROR = (0.003, 0.004, 0.0)
"""Five millimetres are left."""
DURATION_S = 2.0
CAREFUL = careful(load_gains())


def _shaken(times_s, gains=CAREFUL, error=ERROR):
    """Return the velocities (n, 2) by which a car is shaken so long after its profile's end."""
    drive = records(1, DRIVE_TASK)
    drive[0]["profile"]["duration_s"] = DURATION_S
    known = constants_of(NOMINAL.cars[0], NOMINAL, gains, 0.02)
    return np.array([shake(drive[0], known[0]["drive"], error, DURATION_S + t) for t in times_s])


@pytest.fixture
def after_s():
    return CAREFUL.drive.shake_after


def test_a_car_shakes_across_what_is_left_with_the_speed_of_its_gains(after_s):
    gains = CAREFUL.drive
    found = _shaken(after_s + np.linspace(1e-6, 1.99 / gains.shake_rate, 400))
    assert abs(found @ ERROR[:2]).max() < 1e-12
    assert np.linalg.norm(found, axis=1).max() == pytest.approx(gains.shake_speed, rel=1e-3)
    ways = found @ (-0.8, 0.6)
    assert ways.min() == pytest.approx(-ways.max(), rel=1e-3), "to and fro"


def test_it_settles_in_between(after_s):
    rate = CAREFUL.drive.shake_rate
    assert not _shaken(after_s + np.linspace(2.01, 3.99, 20) / rate).any()
    assert _shaken(after_s + np.linspace(4.05, 4.2, 5) / rate).any()


def test_a_car_that_is_there_or_has_only_just_ended_its_path_does_not(after_s):
    near = 0.9 * CAREFUL.drive.position_tolerance
    for error in ((0.0, 0.0, 0.0), (near, 0.0, 0.0)):
        assert not _shaken(after_s + np.linspace(0.01, 0.3, 20), error=error).any()
    assert not _shaken([0.0, after_s / 2, after_s]).any()


def test_a_car_that_feels_no_uneven_floor_never_does():
    for preset in ("robust", "fast"):
        gains = load_gains(preset)
        assert not _shaken(np.linspace(0, gains.drive.settle_allowance, 200), gains).any()
