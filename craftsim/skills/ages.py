"""How late one signal comes behind another that is prompt: a localisation behind odometry, a wheel behind its command.

For each candidate age, in whole control periods, the ways that both signals went over a short window are compared: the
squared mismatch is least at the true age, and near it a parabola in the age, whose vertex and width give the age and
its variance. Ways do not depend on where the signals started, and hardly on a scale between them. What is assumed
before anything has moved is one more parabola.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from craftsim.discrete.kernel.jit import compiled
from craftsim.models.measuring import Floats

WINDOW: Final = 5
"""Control periods over which ways are compared; a period's mismatch counts in so many windows."""
_SUREST: Final = 0.1
"""Periods: an age is known no better than this, for it is not quite constant."""


def assume_age(mismatches: Floats, age: float, std: float) -> None:
    """Begin with what is assumed of the age, in periods; ``mismatches`` has one for each candidate 0, 1, ..."""
    mismatches[:] = WINDOW * ((np.arange(len(mismatches)) - age) / std) ** 2


@compiled
def likeliest_age(mismatches: Floats) -> tuple[float, float]:
    """Return the age in periods, and its standard deviation."""
    best, last = 0, len(mismatches) - 1
    for k in range(1, last + 1):
        if mismatches[k] < mismatches[best]:
            best = k
    middle = min(max(best, 1), last - 1)
    before, at, after = mismatches[middle - 1], mismatches[middle], mismatches[middle + 1]
    bend = (before - 2 * at + after) / 2
    if bend <= 0.0:
        return float(best), 1.0
    age = middle + (before - after) / (4 * bend)
    return max(0.0, min(float(last), age)), max(_SUREST, math.sqrt(WINDOW / bend))
