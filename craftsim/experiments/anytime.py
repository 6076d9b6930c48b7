"""Intervals and tests of success rates that hold at every number of trials, however often somebody looks.

The evidence against a hypothesis is the wealth of a gambler who bets against it after every trial, from 1 at the start.
If the hypothesis is true, it ever reaches ``1 / error`` with at most the probability ``error`` (Ville 1939), so that a
run may be watched, stopped and continued at will. Here the bets are a mixture of likelihood ratios (Robbins 1970;
Waudby-Smith and Ramdas, "Estimating means of bounded random variables by betting", 2024), of which the evidence depends
on the counts alone. Trials are taken to succeed independently, at one rate. Where their rates differ, as over several
plans, the mean rate is bounded at a number of trials that was fixed before.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

CONFIDENCE: Final = 0.95
_PERFECT_SHARE: Final = 0.5
"""Part of the first wealth that is bet on trials without an exception; the rest is spread over all other stakes."""
_STAKES: Final = 400
"""Stakes that a paired test mixes, the largest ones at both ends."""
_TOLERANCE: Final = 1e-12


def log_evidence_above(successes: ArrayLike, trials: ArrayLike, rate: ArrayLike) -> Any:
    """Return the logarithm of the evidence that the success rate is above ``rate``.

    The arguments broadcast; rates are between 0 and 1, both excluded.
    """
    from scipy.special import betaincc, betaln, xlog1py, xlogy

    n_good = np.asarray(successes, float)
    n_bad = np.asarray(trials, float) - n_good
    threshold = np.asarray(rate, float)
    log_likelihood = xlogy(n_good, threshold) + xlog1py(n_bad, -threshold)
    with np.errstate(divide="ignore"):
        mass_above = np.log(betaincc(n_good + 1, n_bad + 1, threshold))
        log_perfect = np.where(n_bad == 0, math.log(_PERFECT_SHARE), -np.inf)
    spread = math.log(1 - _PERFECT_SHARE) + betaln(n_good + 1, n_bad + 1) + mass_above
    log_spread = spread - np.log1p(-threshold)
    return np.logaddexp(log_perfect, log_spread) - log_likelihood


def log_evidence_below(successes: ArrayLike, trials: ArrayLike, rate: ArrayLike) -> Any:
    """Return the logarithm of the evidence that the success rate is below ``rate``; otherwise as above."""
    failures = np.subtract(trials, successes)
    return log_evidence_above(failures, trials, np.subtract(1.0, rate))


def lower_bound(successes: int, trials: int, confidence: float = CONFIDENCE) -> float:
    """Return the success rate that the true one exceeds with this confidence, at every number of trials."""
    if successes == 0:
        return 0.0
    log_needed = -math.log1p(-confidence)

    def excess(rate: float) -> float:
        return float(log_evidence_above(successes, trials, rate)) - log_needed

    return _crossing(excess, 0.0, successes / trials)


def bounds(successes: int, trials: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the interval that holds the success rate with this confidence, at every number of trials; (0, 1) for
    none."""
    one_sided = (1 + confidence) / 2
    low = lower_bound(successes, trials, one_sided)
    high = 1 - lower_bound(trials - successes, trials, one_sided)
    return low, high


def play_bounds(
    actions: ArrayLike, failed: ArrayLike, most_actions: int, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Return the interval that holds the share of actions that succeed in play, at every number of episodes.

    Episodes are alike and independent, and end with their first failure; actions of one may depend on each other in any
    way. The share is of all actions of many episodes. (0, 1) for none.

    Args:
        actions: (n,) actions of each episode, 1 or more.
        failed: (n,) whether its last one failed.
        most_actions: that an episode has at most, known before.
    """
    one_sided = (1 + confidence) / 2
    low = play_lower_bound(actions, failed, one_sided)
    n_actions = np.asarray(actions, float)
    has_failed = np.asarray(failed, float)
    if not n_actions.size:
        return 0.0, 1.0
    log_needed = -math.log1p(-one_sided)

    def excess(rate: float) -> float:
        gains = (has_failed / rate - n_actions) / most_actions
        return _log_wealth(gains) - log_needed

    return low, 1 - _crossing(excess, 0.0, has_failed.sum() / n_actions.sum())


def play_lower_bound(
    actions: ArrayLike, failed: ArrayLike, confidence: float = CONFIDENCE
) -> float:
    """Return the share of actions that succeed in play which the true one exceeds; see :func:`play_bounds`."""
    n_actions = np.asarray(actions, float)
    has_failed = np.asarray(failed, float)
    if not n_actions.size:
        return 0.0
    log_needed = -math.log1p(-confidence)

    def excess(rate: float) -> float:
        # If actions fail at this rate or more often, this has a mean of at most 0; it is -1 or more.
        gains = rate * n_actions - has_failed
        return _log_wealth(gains) - log_needed

    return 1 - _crossing(excess, 1.0, has_failed.sum() / n_actions.sum())


def _log_wealth(gains: NDArray[np.float64]) -> float:
    """Return the logarithm of the wealth of a gambler who bets on all gains (n,), of -1 or more, with mixed stakes."""
    from scipy.special import logsumexp

    stakes = (1 - np.cos(np.linspace(0, np.pi, _STAKES))) / 2
    shares = np.full(_STAKES, (1 - _PERFECT_SHARE) / (_STAKES - 1))
    shares[-1] = _PERFECT_SHARE
    with np.errstate(divide="ignore"):
        log_wealth = np.log1p(np.maximum(np.outer(stakes, gains), -1)).sum(axis=1)
    return float(logsumexp(log_wealth, b=shares))


def log_evidence_of_difference(worse: int, better: int, pairs: int, difference: float) -> float:
    """Return the logarithm of the evidence that two settings, tried in pairs, differ by something else than this.

    Args:
        worse: number of pairs in which only the first setting succeeds.
        better: those in which only the second does.
        pairs: all pairs.
        difference: success rate of the second setting minus that of the first, between -1 and 1, both excluded.
    """
    from scipy.special import logsumexp, xlog1py

    fractions = (1 - np.cos(np.linspace(0, np.pi, _STAKES))) / 2
    lowest_stake = -1 / (1 - difference)
    highest_stake = 1 / (1 + difference)
    stakes: NDArray[np.float64] = lowest_stake + fractions * (highest_stake - lowest_stake)
    shares = np.full(_STAKES, (1 - _PERFECT_SHARE) / (_STAKES - 2))
    shares[[0, -1]] = _PERFECT_SHARE / 2
    alike = pairs - worse - better
    with np.errstate(divide="ignore"):
        log_wealth = (
            xlog1py(worse, np.maximum(-stakes * (1 + difference), -1))
            + xlog1py(alike, -stakes * difference)
            + xlog1py(better, np.maximum(stakes * (1 - difference), -1))
        )
    return float(logsumexp(log_wealth, b=shares))


def difference_bounds(
    worse: int, better: int, pairs: int, confidence: float = CONFIDENCE
) -> tuple[float, float]:
    """Return the interval that holds the difference of the success rates of two settings, second minus first, with this
    confidence, at every number of pairs; the arguments are those of :func:`log_evidence_of_difference`."""
    if pairs == 0:
        return -1.0, 1.0
    log_needed = -math.log1p(-confidence)

    def excess(difference: float) -> float:
        return log_evidence_of_difference(worse, better, pairs, difference) - log_needed

    mean = (better - worse) / pairs
    return _crossing(excess, -1.0, mean), _crossing(excess, 1.0, mean)


def _crossing(excess: Callable[[float], float], outside: float, inside: float) -> float:
    """Return where a decreasing excess on the way from ``outside`` to ``inside`` becomes zero."""
    from scipy.optimize import brentq

    if inside == outside:
        return outside
    start = outside + _TOLERANCE * (inside - outside)
    end = inside - _TOLERANCE * (inside - outside)
    if excess(start) <= 0:
        return outside
    return float(brentq(excess, start, end, xtol=_TOLERANCE))
