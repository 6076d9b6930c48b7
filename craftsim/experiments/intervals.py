"""95 % intervals of shares and differences, and the rank agreement of two worlds over policies."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from craftsim.experiments.anytime import CONFIDENCE, bounds, difference_bounds

_Samples: TypeAlias = NDArray[np.float64]
_QUANTILE: Final = 1.959963984540054
"""``scipy.stats.norm.ppf(0.975)``, half an interval in standard deviations: scipy.stats takes a second to import."""
RESAMPLES: Final = 9999
MIN_POLICIES: Final = 3


@dataclass(frozen=True)
class Proportion:
    """Successes among trials, with intervals at 95 % confidence."""

    successes: int
    trials: int
    rate: float | None
    low: float
    """The interval that holds at every number of trials, see :mod:`craftsim.experiments.anytime`."""
    high: float
    wilson_low: float
    """Wilson's score interval, which holds for a number of trials that was fixed before the first one."""
    wilson_high: float

    @classmethod
    def of(cls, successes: int, trials: int) -> Proportion:
        """Return the proportion of successes among trials."""
        rate = None
        if trials:
            rate = successes / trials
        return cls(successes, trials, rate, *bounds(successes, trials), *wilson(successes, trials))


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return Wilson's 95 % score interval of a success rate; (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    rate = successes / trials
    square = _QUANTILE * _QUANTILE
    width = 2 * (trials + square)
    middle = (2 * trials * rate + square) / width
    half = _QUANTILE / width * math.sqrt(4 * trials * rate * (1 - rate) + square)
    low = 0.0
    if successes > 0:
        low = middle - half
    high = 1.0
    if successes < trials:
        high = middle + half
    return low, high


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval; None if undefined."""

    value: float | None
    low: float | None
    high: float | None


def mean_of(values: Sequence[float]) -> Estimate:
    """Return a mean with its t interval; without one where fewer than two values differ."""
    from scipy.stats import ttest_1samp

    if len(values) == 0:
        return Estimate(None, None, None)
    if len(set(values)) < 2:
        return Estimate(values[0], None, None)
    low, high = ttest_1samp(values, 0.0).confidence_interval(CONFIDENCE)
    return Estimate(float(np.mean(values)), float(low), float(high))


@dataclass(frozen=True)
class RankAgreement:
    """Agreement of success in the grid world and in physics over several policies."""

    policies: int
    pearson: Estimate
    spearman: Estimate
    mmrv: float
    """Mean maximum rank violation; 0 if physics ranks all policies as the grid world does."""


def agreement_of(
    predicted: Sequence[float], actual: Sequence[float], seed: int
) -> RankAgreement | None:
    """Return the rank agreement of success rates by policy, in a model world and in the world that it models."""
    if len(predicted) < MIN_POLICIES:
        return None
    x = np.array(predicted, float)
    y = np.array(actual, float)
    return RankAgreement(
        policies=len(predicted),
        pearson=_estimate(_pearson, x, y, seed),
        spearman=_estimate(_spearman, x, y, seed),
        mmrv=mean_maximum_rank_violation(x, y),
    )


def mean_maximum_rank_violation(
    grid: Sequence[float] | _Samples, physics: Sequence[float] | _Samples
) -> float:
    """Return the mean maximum rank violation of success rates, both of shape (n,), by policy.

    If the worlds rank two policies differently, their rank violation is the difference of their success rates in
    physics, else 0. The maximum of each policy is averaged over policies: 0 is best, 1 worst. From Li et al.,
    "Evaluating Real-World Robot Manipulation Policies in Simulation" (2024), with the grid world as the simulation and
    physics as reality.
    """
    x = np.asarray(grid, float)
    y = np.asarray(physics, float)
    differs = (x[:, None] < x) != (y[:, None] < y)
    violations = np.where(differs, np.abs(y[:, None] - y), 0.0)
    return float(violations.max(axis=1).mean())


def _pearson(x: _Samples, y: _Samples, axis: int = -1) -> _Samples:
    from scipy.stats import pearsonr

    coefficients: _Samples = np.asarray(pearsonr(x, y, axis=axis).statistic)
    return coefficients


def _spearman(x: _Samples, y: _Samples, axis: int = -1) -> _Samples:
    """Return the correlation of ranks; scipy's ``spearmanr`` correlates columns, not pairs of rows."""
    from scipy.stats import rankdata

    return _pearson(rankdata(x, axis=axis), rankdata(y, axis=axis), axis)


def _estimate(
    statistic: Callable[..., _Samples], grid: _Samples, physics: _Samples, seed: int
) -> Estimate:
    """Return a statistic with its percentile interval; resamples with constant scores are left out."""
    from scipy.stats import ConstantInputWarning, bootstrap

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConstantInputWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        value = float(statistic(grid, physics))
        resampled = bootstrap(
            (grid, physics),
            statistic,
            paired=True,
            vectorized=True,
            n_resamples=RESAMPLES,
            method="percentile",
            rng=np.random.default_rng(seed),
        ).bootstrap_distribution
    defined = resampled[np.isfinite(resampled)]
    if not np.isfinite(value) or not defined.size:
        return Estimate(None, None, None)
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(defined, (tail, 1 - tail))
    return Estimate(value, float(low), float(high))


POWER: Final = 0.8
"""Power of the least detectable difference: a test at 5 % finds it in four of five repetitions."""
_POWER_QUANTILE: Final = 0.8416212335729143
"""``scipy.stats.norm.ppf(POWER)``."""


def paired_difference(only_first: int, only_second: int, pairs: int) -> Estimate:
    """Return the difference of the success rates of two paired samples, second minus first.

    The interval holds at every number of pairs. The arguments are numbers of pairs: in which only the first succeeds,
    only the second, and all.
    """
    if not pairs:
        return Estimate(None, None, None)
    low, high = difference_bounds(only_first, only_second, pairs)
    return Estimate((only_second - only_first) / pairs, low, high)


def least_detectable_of_pairs(only_first: int, only_second: int, pairs: int) -> float:
    """Return the least difference that :func:`paired_difference` tells from none with probability :data:`POWER`.

    The standard error is that of Agresti and Min (2005): half a pair is added to each of the four cells.
    """
    n = pairs + 2
    gain = (only_second - only_first) / n
    error = math.sqrt(max(0.0, (only_first + only_second + 1) / n - gain**2) / n)
    low, high = difference_bounds(only_first, only_second, pairs)
    return (high - low) / 2 + _POWER_QUANTILE * error


def least_detectable(low: float, high: float) -> float:
    """Return the least difference that a test at 5 % detects with probability :data:`POWER`, given a 95 % interval."""
    return (_QUANTILE + _POWER_QUANTILE) / _QUANTILE * (high - low) / 2
