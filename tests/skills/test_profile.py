"""A profile goes from rest to rest over its distance, within its limits, and is its own derivative."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from craftsim.skills.laws import Profile

DISTANCES = st.floats(1e-4, 10.0)
LIMITS = st.floats(0.01, 20.0)
PARTS = st.floats(0.0, 1.0)


@given(DISTANCES, LIMITS, LIMITS)
def test_it_starts_at_rest_and_ends_at_rest_at_the_distance(distance, speed, acceleration):
    profile = Profile.within(distance, speed, acceleration)
    end = profile.duration_s
    assert profile.distance(0.0) == pytest.approx(0.0, abs=1e-9 * distance)
    assert profile.distance(end) == pytest.approx(distance, rel=1e-9)
    assert profile.distance(end + 5.0) == profile.distance(end)
    assert [profile.motion(0.0)[0], profile.motion(end)[0], profile.motion(end + 5.0)[0]] == [0.0, 0.0, 0.0]
    assert [profile.motion(0.0)[1], profile.motion(end)[1]] == [0.0, 0.0]


@given(DISTANCES, LIMITS, LIMITS, PARTS)
def test_it_keeps_to_both_limits(distance, speed, acceleration, part):
    profile = Profile.within(distance, speed, acceleration)
    t = part * profile.duration_s
    assert 0.0 <= profile.motion(t)[0] <= speed * (1 + 1e-12)
    assert abs(profile.motion(t)[1]) <= acceleration * (1 + 1e-9)


@given(DISTANCES, LIMITS, LIMITS)
def test_it_uses_one_of_its_limits_in_full(distance, speed, acceleration):
    profile = Profile.within(distance, speed, acceleration)
    steepest = profile.motion(profile.ramp_s / 2)[1]
    assert steepest == pytest.approx(acceleration, rel=1e-6)
    cruises = profile.duration_s > 2 * profile.ramp_s * (1 + 1e-9)
    if cruises:
        assert profile.motion(profile.duration_s / 2)[0] == pytest.approx(speed, rel=1e-9)


@given(DISTANCES, LIMITS, LIMITS, PARTS, PARTS)
def test_it_never_goes_back(distance, speed, acceleration, one, other):
    profile = Profile.within(distance, speed, acceleration)
    early, late = sorted((one * profile.duration_s, other * profile.duration_s))
    assert profile.distance(early) <= profile.distance(late) + 1e-12 * distance


@given(DISTANCES, LIMITS, LIMITS, st.floats(0.01, 0.99))
def test_speed_is_the_derivative_of_distance_and_acceleration_that_of_speed(
    distance, speed, acceleration, part
):
    profile = Profile.within(distance, speed, acceleration)
    t, h = part * profile.duration_s, 1e-4 * profile.duration_s
    slope = (profile.distance(t + h) - profile.distance(t - h)) / (2 * h)
    assert slope == pytest.approx(profile.motion(t)[0], abs=1e-4 * profile.cruise_speed)
    curve = (profile.motion(t + h)[0] - profile.motion(t - h)[0]) / (2 * h)
    corners = (0.0, profile.ramp_s, profile.duration_s - profile.ramp_s, profile.duration_s)
    if min(abs(t - corner) for corner in corners) > h:
        steepest = 1.5 * profile.cruise_speed / profile.ramp_s
        assert curve == pytest.approx(profile.motion(t)[1], abs=1e-3 * steepest)


@given(DISTANCES, LIMITS, LIMITS)
def test_the_second_half_mirrors_the_first(distance, speed, acceleration):
    profile = Profile.within(distance, speed, acceleration)
    middle = profile.duration_s / 2
    assert profile.distance(middle) == pytest.approx(distance / 2, rel=1e-9)


def test_no_distance_takes_no_time():
    profile = Profile.within(0.0, 1.0, 1.0)
    values = (profile.duration_s, profile.distance(1.0), profile.motion(1.0)[0], profile.motion(1.0)[1])
    assert values == (0.0, 0.0, 0.0, 0.0)
    assert all(math.isfinite(v) for v in values)
