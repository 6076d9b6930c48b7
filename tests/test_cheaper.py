"""What ``scripts/cheaper.py`` says of choices on a cheaper model."""

import cheaper
import numpy as np
import pytest


@pytest.fixture(autouse=True)
def _few_resamples(monkeypatch):
    monkeypatch.setattr(cheaper, "RESAMPLES", 200)


def trials(rates, seconds, n=400):
    """Return trials of candidates with these rates of success and makespans, of shape (candidates, trials, 2)."""
    rng = np.random.default_rng(0)
    success = rng.random((len(rates), n)) < np.array(rates)[:, None]
    makespans = np.array(seconds)[:, None] + np.zeros(n)
    return np.stack([success, makespans], axis=2)


def test_the_wrong_choice_costs_the_difference_to_the_best():
    reference = trials([0.9, 0.5, 0.1], [10.0, 8.0, 9.0])
    wrong = trials([0.5, 0.9, 0.1], [10.0, 8.0, 9.0])
    estimates = cheaper.estimated(cheaper.REGRETS | cheaper.AGREEMENT, reference, wrong)
    assert estimates["success_regret"][0] == pytest.approx(0.4, abs=0.05)
    assert estimates["success_regret"][1] < 0.4 < estimates["success_regret"][2]
    assert estimates["makespan_regret"][0] == pytest.approx(-0.2)
    # Two of three candidates change places.
    assert estimates["spearman"][0] == pytest.approx(0.5)
    assert estimates["violation"][0] == pytest.approx(2 / 3 * 0.4, abs=0.04)


def test_the_right_choice_costs_nothing():
    reference = trials([0.9, 0.5], [10.0, 8.0])
    halves = (reference[:, :200], reference[:, 200:])
    right = trials([1.0, 0.9], [1.0, 1.0])
    assert cheaper.success_regret(right, *halves) == 0
    assert cheaper.rank_correlation(right, *halves) == pytest.approx(1)
    assert cheaper.violation(right, *halves) == 0


def test_makespans_decide_between_equal_shares_and_failures_have_none():
    alike = trials([1.0, 1.0, 0.0], [10.0, 8.0, 1.0])
    assert cheaper.ranks(alike).tolist() == [1, 2, 0]
    assert cheaper.makespans_s(alike).tolist() == [10.0, 8.0, np.inf]
    hopeless = trials([0.0, 0.0], [1.0, 1.0])
    estimates = cheaper.estimated(cheaper.REGRETS, hopeless, hopeless)
    assert estimates == {"success_regret": [0, 0, 0], "makespan_regret": None}
