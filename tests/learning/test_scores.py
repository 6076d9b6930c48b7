"""Statistics over runs against what they are by definition."""

import numpy as np
import pytest

from craftsim.learning.curve import share_reaching
from craftsim.learning.study_results import TAUS, improvement, iqm, iqm_curve, measures, profile

RUNS = np.random.default_rng(0).random((8, 3))


def test_measures_are_what_they_are_by_definition():
    assert iqm(RUNS) == pytest.approx(np.sort(RUNS.ravel())[6:18].mean())
    assert measures(np.ones((5, 2)))["iqm"] == [1.0, 1.0, 1.0]
    assert profile(RUNS)[0][20] == pytest.approx((TAUS[20] < RUNS).mean())
    assert improvement(RUNS + 1, RUNS) == [1.0, 1.0, 1.0]
    assert improvement(np.ones((3, 2)), np.ones((4, 2)))[0] == 0.5
    curve = iqm_curve([[(10, 0.2), (20, 0.6)]], np.array([0, 10, 19, 20, 99]))
    assert curve[0].tolist() == pytest.approx([0.0, 0.2, 0.2, 0.6, 0.6])


def test_intervals_hold_their_estimates_and_shrink_with_more_runs():
    few, many = measures(RUNS), measures(np.tile(RUNS, (10, 1)))
    for name, (estimate, low, high) in few.items():
        assert low <= estimate <= high
        assert many[name][2] - many[name][1] < high - low


def test_the_last_part_of_a_run_counts_where_its_return_reaches_the_threshold():
    returns = [(100, 9.0), (750, 3.0), (800, 2.9), (900, 3.0), (1000, 4.0)]
    assert share_reaching(returns, 3.0, 0.2) == pytest.approx(2 / 3)
    assert share_reaching(returns, 3.0, 0.25) == 0.75
    assert share_reaching(returns, 5.0, 0.2) == 0.0
    assert share_reaching([], 0.0, 0.2) == 0.0
