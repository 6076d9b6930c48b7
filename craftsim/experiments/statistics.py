"""Statistics of a run: shares, errors, durations, survival and ranks, of data frames of its trials and attempts.

All are made of the records alone. Trials that an exception, a timeout or a lost worker kept from an end are counted
apart, and in nothing else.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, repeat, takewhile
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Verdict
from craftsim.experiments.durations import Duration, duration_table, kinds_of
from craftsim.experiments.experiment import TrialRecord
from craftsim.experiments.intervals import CONFIDENCE, Proportion, RankAgreement, agreement_of

if TYPE_CHECKING:
    from pandas import DataFrame

RESULTS: Final = (Verdict.AS_PREDICTED, Verdict.FAILED, Verdict.SIDE_EFFECT, Verdict.UNSAFE, Verdict.SOLVER)
"""Results from the best to the worst, the order of columns; the last proves nothing."""
ERRORS: Final = {
    "car_error_m": "car's place, mm",
    "heading_error_rad": "car's heading, mrad",
    "height_error_m": "car's height, mm",
    "placed_error_m": "place of what is set down, mm",
    "thing_heading_rad": "heading of what is handled, mrad",
    "reach_m": "its reach out of its cell, mm",
    "bystander_displacement_m": "movement of anything else, mm",
    "bystander_turn_rad": "turn of anything else, mrad",
    "drift_m": "anything else from where it was left, mm",
}
"""Fields of an attempt that say how far physics was from the prediction, in words; older records lack some."""
_TEXTS: Final = ("action", "verb", "load", "result", "finding")
_NUMBERS: Final = ("tick", "car", "level", "duration_s", "peak_force_n", *ERRORS)
_FLAGS: Final = ("slope", "legal", "performed")
_ROWS: Final = 10_000
"""That wait to become columns."""


def carried_out(records: Iterable[TrialRecord]) -> Iterator[TrialRecord]:
    """Yield the records of trials that were carried out: those without an error."""
    return (record for record in records if record["error"] is None)


def trials_frame(records: Iterable[TrialRecord]) -> DataFrame:
    """Return a row for each trial that was carried out: ``group``, ``context``, ``agrees``, how many ``attempts``, and,
    NaN where it is not known, whether it succeeded in the grid world and in physics (``grid``, ``physics``)."""
    rows = (
        (
            *(r["agrees"], len(r["attempts"])),
            *(r["extra"].get("grid_success"), r["extra"].get("physics_success")),
            *(r["group"], str(r["context"])),
        )
        for r in carried_out(records)
    )
    frame = _frame(rows, ("agrees", "attempts", "grid", "physics"), ("group", "context"))
    return frame.astype({"agrees": bool, "attempts": int})


def attempts_frame(records: Iterable[TrialRecord]) -> DataFrame:
    """Return a row for each attempt of the trials that were carried out, in their order.

    ``trial`` is the row of :func:`trials_frame`, ``number`` the place in it, ``group`` that of the trial; what was not
    measured is NaN. Texts are categories, in the order of the alphabet.
    """
    rows = (
        (
            *(trial, number),
            *(attempt.get(name) for name in (*_NUMBERS, *_FLAGS)),
            *(str(attempt[name]) for name in _TEXTS),
            record["group"],
        )
        for trial, record in enumerate(carried_out(records))
        for number, attempt in enumerate(record["attempts"])
    )
    frame = _frame(rows, ("trial", "number", *_NUMBERS, *_FLAGS), (*_TEXTS, "group"))
    return frame.astype({**dict.fromkeys(("trial", "number", "level"), int), **dict.fromkeys(_FLAGS, bool)})


def legal_attempts(records: Iterable[TrialRecord]) -> DataFrame:
    """Return the attempts that the rules allow, see :func:`attempts_frame`."""
    frame = attempts_frame(records)
    return frame[frame.legal]


def _frame(rows: Iterable[Sequence[Any]], numbers: Sequence[str], texts: Sequence[str]) -> DataFrame:
    """Return rows of numbers, None for NaN, and then texts, as a frame; there may be millions."""
    from pandas import DataFrame, concat

    kinds = dict.fromkeys(numbers, float) | dict.fromkeys(texts, object)
    parts = (list(islice(rows, _ROWS)) for rows in repeat(iter(rows)))
    frames = [DataFrame(part, columns=list(kinds)).astype(kinds) for part in takewhile(bool, parts)]
    found = concat(frames, ignore_index=True) if frames else DataFrame(columns=list(kinds)).astype(kinds)
    return found.astype(dict.fromkeys(texts, "category"))


def capped_steps(records: Iterable[TrialRecord]) -> int:
    """Return in how many physics steps the solver gave up, summed over all attempts."""
    return sum(int(attempt.get("capped_steps", 0)) for record in records for attempt in record["attempts"])


def retried(records: Iterable[TrialRecord]) -> int:
    """Return how many actions were tried more than once."""
    return sum(attempt.get("tries", 1) > 1 for record in records for attempt in record["attempts"])


def error_counts(records: Iterable[TrialRecord]) -> dict[str, int]:
    """Return how many trials did not finish, by error, most frequent first."""
    found = Counter(str(record["error"]) for record in records if record["error"] is not None)
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


@dataclass(frozen=True)
class MatrixRow:
    """How many attempts of one kind had each result."""

    trials: int
    as_predicted: int
    failed: int
    side_effect: int
    unsafe: int
    numerics: int
    success: Proportion
    """Share that did as predicted."""

    @classmethod
    def of(cls, attempts: DataFrame) -> MatrixRow:
        """Count the results of some attempts."""
        found = attempts.result.value_counts()
        good, failed, side_effect, unsafe, numerics = (int(found.get(result, 0)) for result in RESULTS)
        n = len(attempts)
        return cls(n, good, failed, side_effect, unsafe, numerics, Proportion.of(good, n))


@dataclass(frozen=True)
class LegalityMatrix:
    """Results of what the rules allow, and of what they forbid and was tried on purpose."""

    legal: MatrixRow
    forbidden: MatrixRow


def legality_matrix(attempts: DataFrame) -> LegalityMatrix:
    """Return the matrix of legality and result of some attempts."""
    forbidden = attempts[~attempts.legal & attempts.performed]
    return LegalityMatrix(MatrixRow.of(attempts[attempts.legal]), MatrixRow.of(forbidden))


@dataclass(frozen=True)
class Distribution:
    """How a figure is distributed: number of values, median, 95th and 99th percentile, and maximum."""

    n: int
    median: float
    p95: float
    p99: float
    max: float

    @classmethod
    def of(cls, values: Any) -> Distribution | None:
        """Return the distribution of some values, None of none."""
        known = np.asarray(values, float)
        if not known.size:
            return None
        return cls(known.size, *(float(q) for q in np.quantile(known, (0.5, 0.95, 0.99, 1.0))))


@dataclass(frozen=True)
class Precision:
    """Errors of the attempts that did as predicted, and the peak contact forces of all."""

    car_error_mm: Distribution | None
    """Distance of the car from where it was predicted, in the plane."""
    heading_error_mrad: Distribution | None
    height_error_mm: Distribution | None
    placed_error_mm: Distribution | None
    """Of what was set down, folded or unfolded."""
    bystander_displacement_mm: Distribution | None
    """The furthest that anything moved which the action does not concern."""
    duration_error_s: Distribution | None
    """Distance of an attempt's duration from the median of its kind (verb, load, level and slope): what a planner
    errs by that takes durations from the table."""
    peak_force_n: Distribution | None
    """Of all attempts, also those that did not do as predicted."""
    thing_heading_mrad: Distribution | None = None
    """Of what was set down, folded or unfolded, and of what is carried against its car."""
    reach_mm: Distribution | None = None
    """How much nearer the same comes to a neighbouring cell than it should."""
    bystander_turn_mrad: Distribution | None = None
    drift_mm: Distribution | None = None
    """The furthest that anything which the action does not concern was from where it was left, at any time."""


def drift(trials: DataFrame, attempts: DataFrame) -> dict[str, Distribution | None]:
    """Return how far off in mm things were set down, folded or unfolded in each third of the runs: does it grow?"""
    placed = attempts[attempts.performed & attempts.placed_error_m.notna()]
    third = 3 * placed.number // trials.attempts.reindex(placed.trial).to_numpy()
    return {
        name: Distribution.of(1e3 * placed.placed_error_m[third == place])
        for place, name in enumerate(("first", "middle", "last"))
    }


def precision(attempts: DataFrame) -> Precision:
    """Return the errors of some attempts."""
    kinds = (part.duration_s for _, part in kinds_of(as_predicted(attempts)))
    deviations = [np.abs(seconds - np.median(seconds)) for seconds in kinds]
    return Precision(
        duration_error_s=Distribution.of(np.concatenate([[], *deviations])),
        peak_force_n=Distribution.of(attempts.peak_force_n.dropna()),
        **{in_thousandths(name): Distribution.of(values) for name, values in errors(attempts).items()},
    )


def in_thousandths(name: str) -> str:
    """Return what an error is called in thousandths, such as ``drift_mm`` for ``drift_m``."""
    stem, _, unit = name.rpartition("_")
    return f"{stem}_m{unit}"


def errors(attempts: DataFrame) -> dict[str, NDArray[np.float64]]:
    """Return the errors of the attempts that did as predicted, in thousandths, by field."""
    good = as_predicted(attempts)
    return {name: 1e3 * np.abs(good[name].dropna().to_numpy()) for name in ERRORS}


def as_predicted(attempts: DataFrame) -> DataFrame:
    """Return the attempts that did what was predicted, and nothing else."""
    return attempts[attempts.result == Verdict.AS_PREDICTED]


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


def survival(actions: NDArray[np.int64], ended: NDArray[np.bool_]) -> Survival:
    """Return the Kaplan-Meier curve of some runs, from how many actions each got through, both of shape (n,).

    A run that ended with its n-th action steps at n; the others were over (censored).
    """
    from scipy.stats import CensoredData, ecdf

    n = len(actions)
    if not ended.any():
        times = np.unique(actions).tolist()
        nowhere: list[float | None] = [None] * len(times)
        return Survival(n, 0, times, [1.0] * len(times), nowhere, nowhere)
    curve = ecdf(CensoredData(actions[ended], right=actions[~ended])).sf
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The confidence interval is undefined")
        band = curve.confidence_interval(CONFIDENCE, method="log-log")
    return Survival(
        runs=n,
        ended=int(ended.sum()),
        actions=[int(n) for n in curve.quantiles],
        share=[float(p) for p in curve.probabilities],
        low=[None if math.isnan(p) else float(p) for p in band.low.probabilities],
        high=[None if math.isnan(p) else float(p) for p in band.high.probabilities],
    )


def plan_survival(trials: DataFrame, attempts: DataFrame) -> PlanSurvival:
    """Return the survival of the runs that were carried out."""
    unreadable = attempts.finding.isin(("unreadable", "numerics", "diverged"))
    return PlanSurvival(
        _survival(trials, attempts[attempts.result != Verdict.AS_PREDICTED]),
        _survival(trials, attempts[~attempts.legal | (attempts.result == Verdict.UNSAFE) | unreadable]),
    )


def _survival(trials: DataFrame, ends: DataFrame) -> Survival:
    """Return the survival of trials, each of which ends with the first of some attempts that it has."""
    last = (ends.groupby("trial").number.min() + 1).reindex(trials.index)
    return survival(last.fillna(trials.attempts).to_numpy(int), last.notna().to_numpy())


@dataclass(frozen=True)
class PolicyScore:
    """A policy's success rate in the grid world and in physics."""

    policy: str
    grid: float
    physics: float
    episodes: int


def policy_scores(trials: DataFrame) -> list[PolicyScore]:
    """Return the scores of the policies, the groups of trials that succeed or not in either world, by name."""
    known = trials[trials.grid.notna() & trials.physics.notna()].groupby("group", observed=True)
    return [
        PolicyScore(str(policy), float(found.grid.mean()), float(found.physics.mean()), len(found))
        for policy, found in known
    ]


@dataclass(frozen=True)
class GroupFigures:
    """Figures of the trials of one plan, policy or context."""

    runs: Proportion
    """Share of trials in which every attempt agrees; those with an error are left out."""
    actions: Proportion
    """Share of legal attempts that did what was predicted, and nothing else."""


@dataclass(frozen=True)
class Figures:
    """What the trials of a campaign say together."""

    trials: int
    errors: dict[str, int]
    """Unfinished trials, by error; they count in no other metric."""
    capped_steps: int
    """Physics steps in which the solver gave up, summed over all attempts."""
    retried: int
    """Actions that were tried more than once."""
    all: GroupFigures
    by_group: dict[str, GroupFigures]
    by_verb: dict[str, MatrixRow]
    """Legal attempts alone."""
    matrix: LegalityMatrix
    precision: Precision
    """Of legal attempts."""
    drift: dict[str, Distribution | None]
    durations: list[Duration]
    survival: PlanSurvival
    policies: list[PolicyScore]
    rank_agreement: RankAgreement | None
    """None for fewer than three policies."""


def rank_agreement(scores: Sequence[PolicyScore], seed: int) -> RankAgreement | None:
    """Return how two worlds agree on some policies, None for fewer than three; ``seed`` is the bootstrap's."""
    return agreement_of([score.grid for score in scores], [score.physics for score in scores], seed)


def campaign_figures(records: Iterable[TrialRecord], seed: int) -> Figures:
    """Return the figures of a run's records; ``seed`` is that of the bootstrap."""
    # Gone through again and again, and never held: there may be a million.
    known = list(records) if isinstance(records, Iterator) else records
    trials, attempts = trials_frame(known), attempts_frame(known)
    legal = attempts[attempts.legal]
    scores = policy_scores(trials)
    # A group without attempts has zeros.
    good = (legal.result == Verdict.AS_PREDICTED).groupby(legal.group, observed=True).agg(["sum", "size"])
    by_group = good.reindex(trials.group.cat.categories, fill_value=0)
    return Figures(
        trials=sum(1 for _ in known),
        errors=error_counts(known),
        capped_steps=capped_steps(carried_out(known)),
        retried=retried(carried_out(known)),
        all=GroupFigures(_agree(trials), MatrixRow.of(legal).success),
        by_group={
            str(name): GroupFigures(_agree(found), Proportion.of(*map(int, by_group.loc[name])))
            for name, found in trials.groupby("group", observed=True)
        },
        by_verb={str(verb): MatrixRow.of(found) for verb, found in legal.groupby("verb", observed=True)},
        matrix=legality_matrix(attempts),
        precision=precision(legal),
        drift=drift(trials, attempts),
        durations=duration_table(as_predicted(legal)),
        survival=plan_survival(trials, attempts),
        policies=scores,
        rank_agreement=rank_agreement(scores, seed),
    )


def _agree(trials: DataFrame) -> Proportion:
    return Proportion.of(int(trials.agrees.sum()), len(trials))
