"""Whether the grid ranks policies as physics does: correlations and the mean maximum rank violation."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from craftsim.validation.statistics.proportions import CONFIDENCE
from craftsim.validation.statistics.records import Record, carried_out

_Samples: TypeAlias = NDArray[np.float64]

RESAMPLES: Final = 9999
MIN_POLICIES: Final = 3
"""Of fewer policies a correlation says nothing."""


@dataclass(frozen=True)
class PolicyScore:
    """A policy's success rate in the grid world and in physics."""

    policy: str
    grid: float
    physics: float
    episodes: int


@dataclass(frozen=True)
class Estimate:
    """A figure with its 95 % bootstrap interval over policies; None where it is not defined."""

    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class RankAgreement:
    """How success in the grid world and success in physics go together over several policies."""

    policies: int
    pearson: Estimate
    spearman: Estimate
    mmrv: float
    """Mean maximum rank violation; 0 when physics ranks no two policies otherwise than the grid world."""


def policy_scores(records: Iterable[Record]) -> list[PolicyScore]:
    """Return the scores of the policies in some records, by name.

    Each record is an episode of the policy that its ``group`` names; ``extra`` says under ``grid_success`` and
    ``physics_success`` whether the episode reached its goal in either world. Others are left out.
    """
    known = (r for r in carried_out(records) if {"grid_success", "physics_success"} <= set(r["extra"]))
    reached: dict[str, Counter[str]] = {}
    for record in known:
        extra = record["extra"]
        counts = {"n": 1, "grid": extra["grid_success"], "physics": extra["physics_success"]}
        reached.setdefault(record["group"], Counter()).update(counts)
    return [
        PolicyScore(policy, found["grid"] / found["n"], found["physics"] / found["n"], found["n"])
        for policy, found in sorted(reached.items())
    ]


def rank_agreement(scores: Sequence[PolicyScore], seed: int) -> RankAgreement | None:
    """Return how two worlds agree on some policies, None for fewer than three; ``seed`` is the bootstrap's."""
    return agreement_of([score.grid for score in scores], [score.physics for score in scores], seed)


def agreement_of(predicted: Sequence[float], actual: Sequence[float], seed: int) -> RankAgreement | None:
    """Return the same of success rates by policy, in a world that stands for another one and in that one."""
    if len(predicted) < MIN_POLICIES:
        return None
    x, y = np.array(predicted, float), np.array(actual, float)
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

    If the worlds order two policies differently, their rank violation is the distance of their success rates in
    physics, else 0. Of each policy the largest counts, and the mean of these is returned: 0 is best, 1 worst. As
    Li et al., "Evaluating Real-World Robot Manipulation Policies in Simulation" (2024), with the grid world in the
    place of the simulation and physics in that of reality.
    """
    x, y = np.asarray(grid, float), np.asarray(physics, float)
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


def _estimate(statistic: Callable[..., _Samples], grid: _Samples, physics: _Samples, seed: int) -> Estimate:
    """Return a statistic and its percentile interval; resamples in which all policies score alike have none."""
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
    known = resampled[np.isfinite(resampled)]
    if not np.isfinite(value) or not known.size:
        return Estimate(None, None, None)
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(known, (tail, 1 - tail))
    return Estimate(value, float(low), float(high))
