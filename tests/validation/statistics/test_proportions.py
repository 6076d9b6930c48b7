"""Shares, their intervals, and the comparison of two settings."""

import numpy as np
import pytest
from synthetic import attempt, record

from craftsim.checking.attempt import Verdict
from craftsim.experiments.compare import compare_paired
from craftsim.experiments.intervals import Proportion, wilson
from craftsim.experiments.statistics import attempts_frame, legality_matrix


def test_wilson_interval_of_known_cases():
    # Wilson's score interval of 0 and of all of n has the closed forms 0 .. z^2/(n+z^2) and n/(n+z^2) .. 1.
    z2 = 1.959963984540054**2
    assert wilson(0, 20) == pytest.approx((0.0, z2 / (20 + z2)), abs=1e-9)
    assert wilson(20, 20) == pytest.approx((20 / (20 + z2), 1.0), abs=1e-9)
    assert wilson(0, 0) == (0.0, 1.0)


def test_wilson_interval_as_published():
    # Newcombe, Statistics in Medicine 17 (1998), table I, method 3, without continuity correction.
    for successes, trials, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (1, 29, 0.0061, 0.1718),
    ):
        assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


def test_the_share_of_nothing_is_not_known():
    assert Proportion.of(0, 0).rate is None
    assert Proportion.of(3, 4).rate == 0.75


def test_the_matrix_counts_results_by_legality():
    attempts = [attempt()] * 5 + [attempt(Verdict.UNSAFE)] * 2 + [attempt(Verdict.FAILED, legal=False)] * 3
    attempts.append(attempt(Verdict.SIDE_EFFECT, legal=False))
    matrix = legality_matrix(attempts_frame([record("a", *attempts)]))
    legal, forbidden = matrix.legal, matrix.forbidden
    assert (legal.trials, legal.as_predicted, legal.failed, legal.side_effect, legal.unsafe) == (
        7,
        5,
        0,
        0,
        2,
    )
    assert (forbidden.trials, forbidden.as_predicted, forbidden.failed, forbidden.side_effect) == (4, 0, 3, 1)
    assert legal.success.rate == pytest.approx(5 / 7)


def _runs(table):
    """Return two runs whose pairs are as often (both, only the first, only the second, neither) good as asked."""
    outcomes = [(True, True), (True, False), (False, True), (False, False)]
    pairs = [pair for pair, n in zip(outcomes, table, strict=True) for _ in range(n)]
    return tuple(
        [record(str(i), attempt(), agrees=pair[side]) for i, pair in enumerate(pairs)] for side in (0, 1)
    )


def test_mcnemar_of_a_published_table():
    # Agresti, Categorical Data Analysis, table 10.1: approval at two surveys; z^2 = 17.36, so p is about 3e-5.
    first, second = _runs((794, 150, 86, 570))
    paired = compare_paired(first, second)
    assert (paired.both, paired.only_first, paired.only_second, paired.neither) == (794, 150, 86, 570)
    assert (paired.first.successes, paired.second.successes) == (944, 880)
    assert paired.p_value == pytest.approx(3.1e-5, rel=0.3)


def test_mcnemar_is_the_exact_binomial_of_the_differing_pairs():
    paired = compare_paired(*_runs((10, 1, 7, 2)))
    assert paired.p_value == pytest.approx(2 * (1 + 8) / 2**8)


def test_pairs_are_matched_by_key_and_what_tried_nothing_is_left_out():
    def tried(key, **changes):
        return record(key, attempt(), **changes)

    first = [tried("a"), tried("b", agrees=False), tried("c"), tried("only here"), record("nothing")]
    second = [
        tried("c"),
        tried("a", agrees=False),
        tried("b", error="killed", agrees=False),
        record("nothing"),
    ]
    paired = compare_paired(first, second)
    assert (paired.pairs, paired.unpaired, paired.both, paired.only_first) == (2, 2, 1, 1)


def test_no_pairs_tell_nothing():
    paired = compare_paired([record("a", attempt())], [record("a", attempt(), error="killed")])
    assert (paired.pairs, paired.p_value, paired.first.rate) == (0, 1.0, None)


def test_wilson_covers_the_truth_as_often_as_it_says():
    counts = np.random.default_rng(0).binomial(60, 0.8, 2000)
    known = {int(n): wilson(int(n), 60) for n in set(counts.tolist())}
    covered = np.mean([known[int(n)][0] <= 0.8 <= known[int(n)][1] for n in counts])
    assert 0.93 < covered < 0.98
