"""Intervals and tests that hold at every number of trials: closed forms, another library, and simulation."""

import math

import numpy as np
import pytest

from craftsim.experiments.anytime import (
    bounds,
    difference_bounds,
    log_evidence_above,
    log_evidence_below,
    log_evidence_of_difference,
    lower_bound,
    play_bounds,
)
from craftsim.experiments.intervals import wilson


def test_evidence_of_perfect_trials_is_a_closed_form():
    n, rate = 30, 0.9
    spread = (1 - rate ** (n + 1)) / ((n + 1) * (1 - rate))
    assert math.exp(log_evidence_above(n, n, rate)) == pytest.approx((1 + spread) / 2 / rate**n)
    assert log_evidence_below(0, n, 1 - rate) == pytest.approx(log_evidence_above(n, n, rate))


@pytest.mark.parametrize("rate", [0.2, 0.8, 0.95])
def test_evidence_is_a_fair_game_at_the_bound_and_a_losing_one_below(rate):
    # One more trial changes the wealth by its expectation under the true rate: by nothing at the bound itself.
    for good, n in ((0, 0), (3, 5), (18, 20)):

        def expected(true_rate, good=good, n=n):
            win, lose = (math.exp(log_evidence_above(good + more, n + 1, rate)) for more in (1, 0))
            return true_rate * win + (1 - true_rate) * lose

        wealth = math.exp(log_evidence_above(good, n, rate))
        assert expected(rate) == pytest.approx(wealth)
        assert expected(rate - 0.05) < wealth


def test_a_paired_test_is_a_fair_game():
    truth = {(1, 0): 0.1, (0, 1): 0.2, (0, 0): 0.7}  # a difference of 0.1
    for worse, better, n in ((0, 0, 0), (2, 5, 20)):
        expected = sum(
            share * math.exp(log_evidence_of_difference(worse + w, better + b, n + 1, 0.1))
            for (w, b), share in truth.items()
        )
        assert expected == pytest.approx(
            math.exp(log_evidence_of_difference(worse, better, n, 0.1))
        )


# Both ends of ville 0.1.0's BernoulliCS(alpha=0.05, prior=(1, 1), intersect=False), another construction: where trials
# are alike ours has to be the narrower one, elsewhere about as wide.
VILLE = {
    (20, 20): (0.7393, 1.0),
    (19, 20): (0.6576, 0.9999),
    (300, 310): (0.9172, 0.9922),
    (50, 100): (0.3446, 0.6554),
}


@pytest.mark.parametrize("counts", VILLE)
def test_intervals_are_about_as_wide_as_those_of_another_library(counts):
    low, high = bounds(*counts)
    other_low, other_high = VILLE[counts]
    assert high - low <= 1.1 * (other_high - other_low)
    wilson_low, wilson_high = wilson(*counts)
    assert low < wilson_low
    assert high >= wilson_high


def test_bounds_without_trials_and_at_the_ends():
    assert bounds(0, 0) == (0.0, 1.0)
    assert bounds(0, 10)[0] == 0.0
    assert bounds(10, 10)[1] == 1.0
    assert lower_bound(0, 10) == 0.0
    assert difference_bounds(0, 0, 0) == (-1.0, 1.0)
    assert difference_bounds(0, 10, 10)[1] == 1.0
    low, high = difference_bounds(3, 3, 1_000_000)
    assert low == pytest.approx(-high)


def test_looking_after_every_trial_misleads_in_at_most_a_twentieth_of_runs():
    # A small part of scripts/anytime_coverage.py.
    rng = np.random.default_rng(0)
    runs, n, rate = 400, 300, 0.9
    trials = np.arange(1, n + 1)
    good = np.cumsum(rng.random((runs, n)) < rate, axis=1)
    needed = math.log(20)
    for log_evidence in (log_evidence_above, log_evidence_below):
        wrong = (log_evidence(good, trials, rate) >= needed).any(axis=1)
        assert wrong.mean() <= 0.05


def test_the_simulation_sees_an_interval_that_does_not_hold_at_every_number_of_trials():
    rng = np.random.default_rng(1)
    missed = 0
    for _ in range(200):
        good = np.cumsum(rng.random(300) < 0.9)
        looks = [wilson(int(good[n - 1]), n) for n in range(10, 301, 10)]
        missed += any(not low <= 0.9 <= high for low, high in looks)
    assert missed > 30, "a nominal twentieth would be 10"


def test_where_rates_differ_the_mean_is_bounded_at_a_fixed_number_of_trials():
    rng = np.random.default_rng(2)
    good = (rng.random((1000, 300)) < np.tile((0.8, 1.0), 150)).sum(axis=1)
    needed = math.log(20)
    assert (log_evidence_above(good, 300, 0.9) >= needed).mean() <= 0.05
    assert (log_evidence_above(good, 300, 0.8) >= needed).mean() > 0.95


def test_play_is_bounded_although_its_actions_depend_on_each_other():
    assert play_bounds([], [], 192) == (0, 1)
    low, high = play_bounds([78] * 65, [False] * 65, 192)
    # Without a failure the bound is about that of as many independent actions.
    assert lower_bound(65 * 78, 65 * 78, 0.975) > low > 0.999
    assert high == 1
    rng = np.random.default_rng(0)
    # Half of the episodes fail at once; the others are long, and never do.
    share = 192 / 193
    n_runs = 60
    misses = 0
    misses_of_independent = 0
    for _ in range(n_runs):
        failed = rng.random(20) < 0.5
        actions = np.where(failed, 1, 192)
        is_missed = False
        is_missed_by_independent = False
        for n in (2, 3, 5, 8, 12, 20):
            low, high = play_bounds(actions[:n], failed[:n], 192)
            is_missed |= not low <= share <= high
            n_actions = int(actions[:n].sum())
            low, high = bounds(n_actions - int(failed[:n].sum()), n_actions)
            is_missed_by_independent |= not low <= share <= high
        misses += is_missed
        misses_of_independent += is_missed_by_independent
    assert misses <= 0.05 * n_runs < misses_of_independent
