"""The verdict on tuned gains, on seeds that had no part in finding or choosing them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from craftsim.experiments.experiment import TrialRecord
from craftsim.tuning.goal import Goal
from craftsim.tuning.gains.objectives import Objective, Score


@dataclass(frozen=True)
class Ratio:
    """Gains against others on the same seeds: a factor of the goal's product, below 1 where they are better."""

    factor: float
    low: float
    """Of the 95 % interval of the mean over blocks of trials, by Student's t of the paired differences."""
    high: float


@dataclass(frozen=True)
class HeldOut:
    """Scores on the seeds held out."""

    before: Score
    """Of the gains that the tuning started from."""
    after: Score
    """Of what was chosen."""
    shipped: Score
    """Of craftsim's own gains, in place of those that were tuned."""
    against_start: Ratio
    """Of what was chosen."""
    against_shipped: Ratio
    improved: bool
    """Whether what was chosen takes the place of the start: it fails no more often and costs less; of a front, it fails
    no more often, and the start is not as good in all objectives."""


def joined(records: Sequence[TrialRecord]) -> list[dict[str, object]]:
    """Return the trials of several records."""
    return [trial for record in records for trial in record["attempts"]]


def verdict_on(
    start: Sequence[TrialRecord],
    best: Sequence[TrialRecord],
    shipped: Sequence[TrialRecord],
    goal: Goal,
) -> HeldOut:
    """Return the verdict from the records of the three, one of each for each block of trials."""
    before, after = Score.of(joined(start)), Score.of(joined(best))
    against_start = _compare(best, start, goal.weights)
    names = goal.objectives
    dominated = bool((before.log_costs(names) <= after.log_costs(names)).all())
    better = not dominated if goal.front else against_start.factor < 1
    return HeldOut(
        before,
        after,
        Score.of(joined(shipped)),
        against_start,
        _compare(best, shipped, goal.weights),
        better and after.failed <= before.failed,
    )


def _compare(
    ours: Sequence[TrialRecord], others: Sequence[TrialRecord], weights: Mapping[Objective, float]
) -> Ratio:
    from scipy.stats import t

    whole = Score.of(joined(ours)).log_cost(weights) - Score.of(joined(others)).log_cost(weights)
    each = np.array(
        [
            Score.of(mine["attempts"]).log_cost(weights) - Score.of(other["attempts"]).log_cost(weights)
            for mine, other in zip(ours, others, strict=True)
        ]
    )
    half = float(t.ppf(0.975, len(each) - 1) * each.std(ddof=1) / math.sqrt(len(each)))
    middle = float(each.mean())
    return Ratio(math.exp(whole), math.exp(middle - half), math.exp(middle + half))
