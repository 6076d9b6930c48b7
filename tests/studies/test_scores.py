"""Statistics over runs against what they are by definition."""

import numpy as np
import pytest

from craftsim.studies.scores import TAUS, improvement, iqm, iqm_curve, measures, profile

RNG = np.random.default_rng(0)
RUNS = RNG.random((8, 3))


def test_the_interquartile_mean_is_that_of_the_middle_half():
    middle = np.sort(RUNS.ravel())[6:18]
    assert iqm(RUNS) == pytest.approx(middle.mean())


def test_intervals_hold_their_estimates_and_shrink_with_more_runs():
    few, many = measures(RUNS), measures(np.tile(RUNS, (10, 1)))
    for name, (estimate, low, high) in few.items():
        assert low <= estimate <= high
        assert many[name][2] - many[name][1] < high - low


def test_runs_that_are_all_alike_leave_no_doubt():
    assert measures(np.ones((5, 2)))["iqm"] == [1.0, 1.0, 1.0]


def test_a_profile_is_the_share_of_runs_above():
    at = 20
    assert profile(RUNS)[0][at] == pytest.approx((TAUS[at] < RUNS).mean())


def test_what_is_always_better_is_better_with_certainty_and_equals_are_even():
    assert improvement(RUNS + 1, RUNS) == [1.0, 1.0, 1.0]
    assert improvement(np.ones((3, 2)), np.ones((4, 2)))[0] == 0.5


def test_a_curve_holds_the_last_evaluation_until_the_next():
    curve = iqm_curve([[(10, 0.2), (20, 0.6)]], np.array([0, 10, 19, 20, 99]))
    assert curve[0].tolist() == pytest.approx([0.0, 0.2, 0.2, 0.6, 0.6])
