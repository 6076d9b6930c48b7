"""Bootstrap intervals of 95 % of what is computed from tosses or windows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.experiments.intervals import CONFIDENCE, Estimate

_RESAMPLES: Final = 2000
_ENDS: Final = ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2)


def draws(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return the indices, (resamples, n), of samples of n with replacement."""
    return rng.integers(n, size=(_RESAMPLES, n))


def interval_of(value: float, resampled: Floats) -> Estimate:
    """Return a value with the interval of what it was in other samples; without one where it was the same in all."""
    resampled = resampled[np.isfinite(resampled)]
    if not len(resampled) or resampled.min() == resampled.max():
        return Estimate(float(value), None, None)
    low, high = np.quantile(resampled, _ENDS)
    return Estimate(float(value), float(low), float(high))


def estimate_of(
    values: Floats, rng: np.random.Generator, statistic: Callable[..., Any] = np.mean
) -> Estimate:
    """Return a statistic, such as ``np.median``, of values (n,) with its interval."""
    if not len(values):
        return Estimate(None, None, None)
    resampled = statistic(values[draws(len(values), rng)], axis=1)
    return interval_of(float(statistic(values)), resampled)
