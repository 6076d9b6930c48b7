"""How long plans survive: the share of runs that are still good after so many actions (Kaplan and Meier, 1958)."""

from __future__ import annotations

import math
import warnings
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from craftsim.checking.attempt import Verdict
from craftsim.validation.statistics.proportions import CONFIDENCE
from craftsim.validation.statistics.records import AttemptRecord, Record, as_predicted, carried_out


@dataclass(frozen=True)
class Life:
    """How many actions a run got through, and whether the next one ended it; otherwise the run was over (censored)."""

    actions: int
    ended: bool


@dataclass(frozen=True)
class Survival:
    """A Kaplan-Meier curve with its pointwise 95 % band (exponential Greenwood); all lists are of one length."""

    runs: int
    ended: int
    actions: list[int]
    """Number of actions at which the curve steps, and at which runs leave it."""
    share: list[float]
    """Share of runs that are still good after so many actions."""
    low: list[float | None]
    """None where the formula has no band: at shares of 0 and 1."""
    high: list[float | None]


@dataclass(frozen=True)
class PlanSurvival:
    """Survival of plans with and without re-synchronising."""

    without_resync: Survival
    """A run ends with the first action that does not do as predicted: from there on a planner that does not look again
    believes in a world that is not there."""
    with_resync: Survival
    """A run goes on from what was read. It ends with the first action that the rules forbid there, that is unsafe, or
    that leaves a world that cannot be read."""


def life_without_resync(record: Record) -> Life:
    """Return how many actions of a run did as predicted before the first that did not."""
    return _life(record, [not as_predicted(attempt) for attempt in record["attempts"]])


def life_with_resync(record: Record) -> Life:
    """Return how many actions of a run could be carried on from what was read, and safely."""
    return _life(record, [_ends_all(attempt) for attempt in record["attempts"]])


def _ends_all(attempt: AttemptRecord) -> bool:
    unreadable = attempt["finding"] in ("unreadable", "numerics", "diverged")
    return not attempt["legal"] or attempt["result"] == Verdict.UNSAFE or unreadable


def _life(record: Record, ends: Sequence[bool]) -> Life:
    return Life(ends.index(True) + 1, True) if True in ends else Life(len(ends), False)


def survival(lives: Iterable[Life]) -> Survival:
    """Return the Kaplan-Meier curve of some runs; a run that ended with its n-th action steps at n."""
    from scipy.stats import CensoredData, ecdf

    ended, censored = array("q"), array("q")
    for life in lives:
        (ended if life.ended else censored).append(life.actions)
    n = len(ended) + len(censored)
    if not ended:
        times = sorted(set(censored))
        nowhere: list[float | None] = [None] * len(times)
        return Survival(n, 0, times, [1.0] * len(times), nowhere, nowhere)
    curve = ecdf(CensoredData(ended, right=censored)).sf
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The confidence interval is undefined")
        band = curve.confidence_interval(CONFIDENCE, method="log-log")
    return Survival(
        runs=n,
        ended=len(ended),
        actions=[int(n) for n in curve.quantiles],
        share=[float(p) for p in curve.probabilities],
        low=[None if math.isnan(p) else float(p) for p in band.low.probabilities],
        high=[None if math.isnan(p) else float(p) for p in band.high.probabilities],
    )


def plan_survival(records: Iterable[Record]) -> PlanSurvival:
    """Return the survival of the runs that were carried out."""
    return PlanSurvival(
        survival(map(life_without_resync, carried_out(records))),
        survival(map(life_with_resync, carried_out(records))),
    )
