"""A profile goes from rest to rest over its distance, within its limits, and is its own derivative."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from craftsim.skills.laws import Profile

DISTANCES, LIMITS = st.floats(1e-4, 10.0), st.floats(0.01, 20.0)


@given(DISTANCES, LIMITS, LIMITS, st.floats(0.0, 1.0))
@settings(max_examples=60)
def test_it_goes_from_rest_to_rest_within_both_limits_and_uses_one_in_full(
    distance, speed, acceleration, part
):
    profile = Profile.within(distance, speed, acceleration)
    end, t = profile.duration_s, part * profile.duration_s
    assert profile.distance(0.0) == pytest.approx(0.0, abs=1e-9 * distance)
    assert profile.distance(end) == pytest.approx(distance, rel=1e-9)
    assert profile.distance(end + 5.0) == profile.distance(end)
    assert profile.motion(0.0) == profile.motion(end) == profile.motion(end + 5.0) == (0.0, 0.0)
    assert 0.0 <= profile.motion(t)[0] <= speed * (1 + 1e-12)
    assert abs(profile.motion(t)[1]) <= acceleration * (1 + 1e-9)
    assert profile.distance(part * t) <= profile.distance(t) + 1e-12 * distance, "it never goes back"
    # The second half mirrors the first.
    assert profile.distance(t) + profile.distance(end - t) == pytest.approx(distance, rel=1e-9)
    assert profile.motion(profile.ramp_s / 2)[1] == pytest.approx(acceleration, rel=1e-6)
    if end > 2 * profile.ramp_s * (1 + 1e-9):
        assert profile.motion(end / 2)[0] == pytest.approx(speed, rel=1e-9)


@given(DISTANCES, LIMITS, LIMITS, st.floats(0.01, 0.99))
@settings(max_examples=60)
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


def test_no_distance_takes_no_time():
    profile = Profile.within(0.0, 1.0, 1.0)
    assert (profile.duration_s, profile.distance(1.0), profile.motion(1.0)) == (0.0, 0.0, (0.0, 0.0))
