"""When a row of an audit has trials enough, and how many rows are wrongly judged at most."""

import numpy as np
import pytest

from craftsim.audit.stopping import (
    PERFECT_TRIALS,
    SOUND_SHARE,
    RowRule,
    error_bounds,
    is_settled,
)
from craftsim.checking.attempt import Verdict


class _Row:
    def __init__(self, name, members):
        self.name = name
        self.members = (None,) * members


def _records(*outcomes):
    results = {True: Verdict.AS_PREDICTED, False: Verdict.FAILED, None: Verdict.NUMERICS}
    return [{"attempts": [{"result": results[outcome]}]} for outcome in outcomes]


@pytest.mark.parametrize(
    ("good", "trials", "settled"),
    [(0, 1, False), (0, 2, True), (1, 3, False), (7, 7, False), (8, 8, True), (18, 20, False)],
)
def test_two_failures_settle_a_row_and_eight_trials_without_one(good, trials, settled):
    assert is_settled(good, trials) is settled


def test_a_row_of_many_situations_tries_each_of_them_and_the_solver_tells_nothing():
    rule = RowRule([_Row("few", 2), _Row("many", 12), _Row("failing", 12)])
    sizes = rule.round_sizes()
    assert [next(sizes) for _ in range(4)] == [2, 6, 4, 4]
    assert not rule.is_decided("few", _records(True, True))
    assert not rule.is_decided("few", _records(True, True, True, True, True, None))
    assert rule.is_decided("few", _records(True))
    assert not rule.is_decided("many", _records(*[True] * 8))
    assert rule.is_decided("many", _records(*[True] * 4))
    assert rule.is_decided("failing", _records(False, False))


def test_a_working_row_is_rarely_called_failing():
    rng = np.random.default_rng(2)
    wrong = 0
    for _ in range(1000):
        good = np.cumsum(rng.random(20) < SOUND_SHARE)
        wrong += any(
            good[n - 1] < n and is_settled(int(good[n - 1]), n) for n in (2, 8, 12, 16, 20)
        )
    assert wrong <= 15, "one in a hundred"


def _population(rng, rates):
    trials = rng.random((len(rates), PERFECT_TRIALS)) < rates[:, None]
    return trials, trials.all(axis=1)


@pytest.mark.parametrize("bad_share", [0.0, 0.05, 0.3])
def test_the_number_of_rows_wrongly_called_working_is_within_its_bound(bad_share):
    # A small part of scripts/anytime_coverage.py.
    rng = np.random.default_rng(3)
    missed = 0
    for _ in range(200):
        bad = rng.random(300) < bad_share
        rates = np.where(bad, rng.uniform(0.3, SOUND_SHARE, 300), 1.0)
        trials, _ = _population(rng, rates)
        (bound,) = error_bounds(trials.tolist(), (SOUND_SHARE,))
        passing = trials[:, : PERFECT_TRIALS // 2].all(axis=1) & bad
        missed += bound.rows < (rates[passing] ** (PERFECT_TRIALS // 2)).sum()
    assert missed <= 10


def test_a_planted_population_of_unreliable_rows_is_seen():
    rng = np.random.default_rng(4)
    trials, _ = _population(rng, np.full(300, 0.9))
    (bound,) = error_bounds(trials.tolist(), (0.95,))
    assert bound.rows > 100
    trials, _ = _population(rng, np.full(300, 1.0))
    (bound,) = error_bounds(trials.tolist(), (0.95,))
    assert bound.rows < 14
    assert error_bounds([[False, False], [True]], (0.95,)) == []
