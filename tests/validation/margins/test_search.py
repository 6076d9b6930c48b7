"""A search finds what all trials stand, and says truly how sure that is."""

import numpy as np
import pytest
from scipy.stats import binom

from craftsim.validation.margins.search import BASE, RANKS, SHARE, TRIALS, confidence, search

LEVELS = 40


def _stands(critical):
    return lambda trial, level: level <= critical[trial]


def test_the_margin_is_what_the_weakest_trial_stands():
    critical = np.random.default_rng(1).integers(5, 60, TRIALS)
    found = search(_stands(critical), LEVELS, TRIALS)
    assert found.margin == min(critical)
    assert found.upper == sorted(critical[:16])[2] + 1
    trial, level = found.edge
    assert level == found.margin + 1
    assert critical[trial] == found.margin


def test_what_all_stand_has_no_edge():
    found = search(_stands([LEVELS] * 20), LEVELS, 20)
    assert (found.margin, found.upper, found.edge) == (LEVELS, None, None)


def test_a_base_that_is_not_stood_ends_the_search():
    found = search(_stands([7] * 19 + [-1]), LEVELS, 20)
    assert found.margin is None
    assert found.edge == (19, BASE)


def test_at_the_margin_every_trial_stands_even_where_higher_levels_are_stood_and_lower_ones_not():
    """Trial 0 fails at levels 3 to 6 alone; another one leads the search down to level 6."""
    critical = [LEVELS, 6, *[LEVELS] * 5]

    def stands(trial, level):
        return not 3 <= level <= 6 if trial == 0 else level <= critical[trial]

    found = search(stands, LEVELS, 7)
    assert all(stands(trial, found.margin) for trial in range(7))
    assert not stands(*found.edge)


def test_a_margin_takes_few_trials():
    tried = set()
    critical = np.random.default_rng(2).integers(10, 50, TRIALS)
    search(lambda trial, level: tried.add((trial, level)) or level <= critical[trial], LEVELS, TRIALS)
    assert len(tried) < 4 * TRIALS


def test_59_trials_make_95_percent_of_95_percent():
    assert confidence(TRIALS) >= 0.95 > confidence(TRIALS - 1)


@pytest.mark.parametrize(("first", "rank"), RANKS)
def test_the_upper_end_is_one_by_the_binomial_distribution(first, rank):
    """Were at most 5 % of all worlds to fail, so many of the first trials would with 5 % probability at most."""
    assert binom.sf(rank - 1, first, 1 - SHARE) <= 0.05 + 1e-12


def test_margins_of_drawn_worlds_are_stood_by_95_percent_as_often_as_claimed():
    rng, held = np.random.default_rng(3), []
    for _ in range(200):
        critical = np.floor(rng.normal(20, 4, TRIALS)).astype(int)
        found = search(_stands(critical), LEVELS, TRIALS)
        lower = np.mean(np.floor(rng.normal(20, 4, 2000)) >= found.margin) >= 0.94
        upper = found.upper is None or np.mean(np.floor(rng.normal(20, 4, 2000)) < found.upper) >= 0.04
        held.append((lower, upper))
    assert np.all(np.mean(held, axis=0) >= 0.93)
