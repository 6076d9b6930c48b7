"""A Kalman filter of nine figures that takes in one scalar measurement after the other."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from craftsim.discrete.kernel.jit import Record, compiled

_OUTLIER: Final = 4.0
"""A measurement that is further off than so many standard deviations pulls no more than one that is so far off."""
_N: Final = 9

FILTER: Final = np.dtype(
    [
        ("state", "f8", (_N,)),
        ("covariance", "f8", (_N, _N)),
        ("slopes", "f8", (_N,)),
        ("shares", "f8", (_N,)),
    ],
    align=True,
)
"""An estimate and the covariance of its errors. ``slopes`` is by how much the next measurement grows with each figure;
``shares`` is room to calculate in."""


@compiled
def correct(known: Record, off: float, variance: float, first_held: int, n_held: int) -> bool:
    """Take a measurement into a FILTER; return False for an outlier.

    Args:
        known: the filter, with the slopes of the measurement; they are zero afterwards.
        off: by how much the measurement is above what was expected.
        variance: of the measurement.
        first_held: the first of ``n_held`` figures that the measurement leaves as they are, however unsure they are: it
            says nothing of them by itself (a Schmidt-Kalman filter).
    """
    state, covariance, slopes, shares = known.state, known.covariance, known.slopes, known.shares
    expected = variance
    for i in range(_N):
        shares[i] = 0.0
        for j in range(_N):
            shares[i] += covariance[i, j] * slopes[j]
        expected += slopes[i] * shares[i]
    most = _OUTLIER * math.sqrt(expected)
    pull = max(-most, min(most, off)) / expected
    last_held = first_held + n_held
    for i in range(_N):
        slopes[i] = 0.0
        held = first_held <= i < last_held
        if not held:
            state[i] += shares[i] * pull
        for j in range(_N):
            if not (held and first_held <= j < last_held):
                covariance[i, j] -= shares[i] * shares[j] / expected
    return abs(off) <= most
