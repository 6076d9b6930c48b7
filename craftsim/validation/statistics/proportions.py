"""Shares of successes with their confidence intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

CONFIDENCE: Final = 0.95
"""Confidence of all intervals."""


@dataclass(frozen=True)
class Proportion:
    """Successes among trials, with Wilson's score interval at 95 % confidence."""

    successes: int
    trials: int
    rate: float | None
    """None when nothing was tried."""
    wilson_low: float
    wilson_high: float

    @classmethod
    def of(cls, successes: int, trials: int) -> Proportion:
        """Return the proportion of so many successes among so many trials."""
        low, high = wilson(successes, trials)
        return cls(successes, trials, successes / trials if trials else None, low, high)


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return Wilson's score interval of a success rate at 95 % confidence; (0, 1) when nothing was tried."""
    from scipy.stats import binomtest

    if trials == 0:
        return 0.0, 1.0
    interval = binomtest(successes, trials).proportion_ci(CONFIDENCE, method="wilson")
    return float(interval.low), float(interval.high)
