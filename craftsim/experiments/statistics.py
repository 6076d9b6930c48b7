"""Statistics of a run: shares, errors, durations, survival and ranks, from data frames of its trials and attempts.

They are computed from the records alone. Trials that ended with an exception, a timeout or a lost worker are counted
separately and enter no other metric.
"""

from __future__ import annotations

import hashlib
import json
import math
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import AGREEING, Verdict
from craftsim.checking.measurements import LABELLED, MEASUREMENTS
from craftsim.experiments.experiment import TrialRecord
from craftsim.experiments.intervals import CONFIDENCE, Proportion, RankAgreement, agreement_of
from craftsim.experiments.records import RecordView
from craftsim.storage.folders import output_directory
from craftsim.storage.writing import write_whole

if TYPE_CHECKING:
    from pandas import DataFrame

RESULTS: Final = (
    Verdict.AS_PREDICTED,
    Verdict.RETRIED,
    Verdict.FAILED,
    Verdict.SIDE_EFFECT,
    Verdict.UNSAFE,
    Verdict.NUMERICS,
)
"""Results from best to worst, the order of columns; the last is inconclusive."""
_TRIAL: Final = {"agrees": bool, "attempts": int, "grid": float, "physics": float}
_ATTEMPT: Final = {
    **dict.fromkeys(("trial", "number", "level"), int),
    **dict.fromkeys(("slope", "legal", "performed"), bool),
    **dict.fromkeys(("tick", "car", "duration_s", "peak_force_n"), float),
    **dict.fromkeys((row.name for row in LABELLED), float),
}
_TEXTS: Final = ("action", "verb", "load", "result", "finding", "group")
_PAGE_ROWS: Final = 10_000
"""Rows that are held as Python objects at a time."""


def carried_out(records: Iterable[TrialRecord]) -> Iterator[TrialRecord]:
    """Yield the records without an error."""
    return (record for record in records if record["error"] is None)


def repeated(records: Iterable[TrialRecord]) -> frozenset[str]:
    """Return the keys of trials that repeat another one and tell nothing more: they count in no interval and no test.

    Where all trials of a plan or policy in a world are equal in every figure of every attempt, nothing was drawn at
    random, and they are one trial. Where one differs, something is drawn, and equal ones are draws of their own.
    """
    digests = dict[tuple[str | None, str], set[bytes]]()
    later_keys = dict[tuple[str | None, str], list[str]]()
    for record in carried_out(records):
        place = (record["context"], record["group"])
        if not record["attempts"] or len(digests.get(place, ())) > 1:
            continue
        figures = [record["attempts"], record["agrees"], record["extra"].get("physics_success")]
        digest = hashlib.sha256(json.dumps(figures, sort_keys=True).encode()).digest()
        if place in digests:
            later_keys.setdefault(place, []).append(record["key"])
        digests.setdefault(place, set()).add(digest)
    keys = set[str]()
    for place, repeating in later_keys.items():
        if len(digests[place]) == 1:
            keys.update(repeating)
    return frozenset(keys)


def not_standing(records: Iterable[TrialRecord]) -> int:
    """Return the number of trials in worlds that cannot stand."""
    return sum("does_not_stand" in record["extra"] for record in records)


def identical_trials(records: Iterable[TrialRecord]) -> int:
    """Return the number of trials that repeat another one, run or not."""
    left_out = sum(record["extra"].get("identical", 1) - 1 for record in records)
    return left_out + len(repeated(records))


def distinct(records: Iterable[TrialRecord]) -> Iterable[TrialRecord]:
    """Return a view of the records without :func:`repeated` ones."""
    keys = repeated(records)
    if not keys:
        return records
    return without_keys(records, keys)


def without_keys(records: Iterable[TrialRecord], keys: Set[str]) -> Iterable[TrialRecord]:
    """Return a view of the records without those of these keys."""

    def view(records: Iterable[TrialRecord]) -> Iterator[TrialRecord]:
        return (record for record in records if record["key"] not in keys)

    return RecordView(records, view)


def trials_frame(records: Iterable[TrialRecord]) -> DataFrame:
    """Return a row for each trial without error: ``group``, ``context``, ``agrees``, the number of ``attempts``, and
    its success in the grid world and in physics (``grid``, ``physics``; NaN if unknown)."""
    return _frame(_trial_rows(records), _TRIAL, ("group", "context"))


def _trial_rows(records: Iterable[TrialRecord]) -> Iterator[dict[str, Any]]:
    for record in carried_out(records):
        yield {
            "group": record["group"],
            "context": str(record["context"]),
            "agrees": record["agrees"],
            "attempts": len(record["attempts"]),
            "grid": record["extra"].get("grid_success"),
            "physics": record["extra"].get("physics_success"),
        }


def attempts_frame(records: Iterable[TrialRecord]) -> DataFrame:
    """Return a row for each attempt of the trials without error, in order.

    ``trial`` is the row in :func:`trials_frame`, ``number`` the index in the trial, ``group`` that of the trial.
    Missing values are NaN. Texts are categories in alphabetical order.
    """
    return _frame(_attempt_rows(records), _ATTEMPT, _TEXTS)


def _attempt_rows(records: Iterable[TrialRecord]) -> Iterator[dict[str, Any]]:
    for trial, record in enumerate(carried_out(records)):
        for number, attempt in enumerate(record["attempts"]):
            yield {**attempt, "trial": trial, "number": number, "group": record["group"]}


def legal_attempts(records: Iterable[TrialRecord]) -> DataFrame:
    """Return the attempts that the rules allow, see :func:`attempts_frame`."""
    frame = attempts_frame(records)
    return frame[frame.legal]


def _frame(
    rows: Iterable[Mapping[str, Any]], numbers: Mapping[str, type], texts: Sequence[str]
) -> DataFrame:
    """Return these numbers (None for NaN) and texts of rows as a data frame; there may be millions."""
    from pandas import DataFrame, concat

    types = dict.fromkeys(numbers, float) | dict.fromkeys(texts, object)
    columns = list(types)
    pages = []
    row_iterator = iter(rows)
    for page in iter(lambda: list(islice(row_iterator, _PAGE_ROWS)), []):
        pages.append(DataFrame(page, columns=columns).astype(types))
    if pages:
        frame = concat(pages, ignore_index=True)
    else:
        frame = DataFrame(columns=columns).astype(types)
    return frame.astype({**numbers, **dict.fromkeys(texts, "category")})


def capped_steps(records: Iterable[TrialRecord]) -> int:
    """Return the number of physics steps in which the solver did not converge, over all attempts."""
    total = 0
    for record in records:
        for attempt in record["attempts"]:
            total += attempt["capped_steps"]
    return total


def retried(records: Iterable[TrialRecord]) -> int:
    """Return the number of actions with more than one try."""
    total = 0
    for record in records:
        for attempt in record["attempts"]:
            total += attempt["tries"] > 1
    return total


def error_counts(records: Iterable[TrialRecord]) -> dict[str, int]:
    """Return the number of unfinished trials by error, most frequent first."""
    counts = Counter(str(record["error"]) for record in records if record["error"] is not None)
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


@dataclass(frozen=True)
class MatrixRow:
    """The number of attempts of one kind with each result."""

    trials: int
    as_predicted: int
    """With those that needed a second try."""
    retried: int
    """Those alone."""
    failed: int
    side_effect: int
    unsafe: int
    numerics: int
    success: Proportion

    @classmethod
    def of(cls, attempts: DataFrame) -> MatrixRow:
        """Count the results of some attempts."""
        counts = attempts.result.value_counts()
        numbers = {verdict: int(counts.get(verdict, 0)) for verdict in RESULTS}
        good = numbers[Verdict.AS_PREDICTED] + numbers[Verdict.RETRIED]
        n = len(attempts)
        return cls(
            trials=n,
            as_predicted=good,
            retried=numbers[Verdict.RETRIED],
            failed=numbers[Verdict.FAILED],
            side_effect=numbers[Verdict.SIDE_EFFECT],
            unsafe=numbers[Verdict.UNSAFE],
            numerics=numbers[Verdict.NUMERICS],
            success=Proportion.of(good, n),
        )


def legality_matrix(attempts: DataFrame) -> dict[str, MatrixRow]:
    """Return the results of ``legal`` attempts, and of ``forbidden`` ones that were tried on purpose."""
    forbidden = attempts[~attempts.legal & attempts.performed]
    return {"legal": MatrixRow.of(attempts[attempts.legal]), "forbidden": MatrixRow.of(forbidden)}


@dataclass(frozen=True)
class Distribution:
    """Summary of a distribution: number of values, median, 95th and 99th percentile, and maximum."""

    n: int
    median: float
    p95: float
    p99: float
    max: float

    @classmethod
    def of(cls, values: Any) -> Distribution | None:
        """Return the summary of some values; None without any."""
        sample = np.asarray(values, float)
        if not sample.size:
            return None
        return cls(sample.size, *np.quantile(sample, (0.5, 0.95, 0.99, 1.0)).tolist())


def drift(trials: DataFrame, attempts: DataFrame) -> dict[str, Distribution | None]:
    """Return the placement errors in mm in each third of the runs, to show a drift."""
    placed = attempts[attempts.performed & attempts.placed_error_m.notna()]
    third = 3 * placed.number // trials.attempts.reindex(placed.trial).to_numpy()
    distributions = {}
    for place, name in enumerate(("first", "middle", "last")):
        distributions[name] = Distribution.of(1e3 * placed.placed_error_m[third == place])
    return distributions


def precision(attempts: DataFrame) -> dict[str, Distribution | None]:
    """Return the errors of the attempts as predicted, by name and unit (those of LABELLED).

    ``duration_error_s`` is the deviation of a duration from the median of its kind (verb, load, level and slope),
    ``peak_force_n`` the peak contact force of all attempts.
    """
    deviations: list[Any] = [[]]
    for _, good_of_kind in as_predicted(attempts).groupby(_KIND, observed=True):
        seconds = good_of_kind.duration_s
        deviations.append(np.abs(seconds - np.median(seconds)))
    distributions = {
        "duration_error_s": Distribution.of(np.concatenate(deviations)),
        "peak_force_n": Distribution.of(attempts.peak_force_n.dropna()),
    }
    for name, values in errors(attempts).items():
        distributions[MEASUREMENTS[name].shown_name] = Distribution.of(values)
    return distributions


def errors(attempts: DataFrame) -> dict[str, NDArray[np.float64]]:
    """Return the errors of the attempts as predicted (those of LABELLED), in the unit of reports, by field."""
    good = as_predicted(attempts)
    values = {}
    for row in LABELLED:
        values[row.name] = row.unit.factor * np.abs(good[row.name].dropna().to_numpy())
    return values


def as_predicted(attempts: DataFrame) -> DataFrame:
    """Return the attempts as predicted."""
    return attempts[attempts.result.isin(AGREEING)]


_KIND: Final = ["verb", "load", "level", "slope"]
_DURATIONS: Final = [*_KIND, "n", "mean_s", "p05_s", "median_s", "p95_s", "max_s"]


def duration_table(good: DataFrame) -> list[dict[str, Any]]:
    """Return the durations of the attempts as predicted in seconds, a row for each kind of action, sorted.

    A kind has a ``verb``, the ``load`` and the ``level`` of the car before, and whether the action starts or ends on a
    ``slope``; the other columns are ``n``, ``mean_s``, ``p05_s``, ``median_s``, ``p95_s`` and ``max_s``.
    """
    rows = []
    for kind, good_of_kind in good.groupby(_KIND, observed=True):
        seconds = good_of_kind.duration_s.to_numpy()
        quantiles = np.quantile(seconds, (0.05, 0.5, 0.95, 1.0)).tolist()
        rows.append((*kind, len(seconds), float(np.mean(seconds)), *quantiles))
    return [dict(zip(_DURATIONS, row, strict=True)) for row in rows]


def write_durations(out: Path, table: Sequence[Mapping[str, Any]]) -> Path:
    """Write a table as ``durations.csv`` into the directory ``out``, made when missing, and return its path."""
    from pandas import DataFrame

    text = DataFrame(table, columns=_DURATIONS).round(4).to_csv(index=False)
    return write_whole(output_directory(out) / "durations.csv", text)


def survival(actions: NDArray[np.int64], ended: NDArray[np.bool_]) -> dict[str, Any]:
    """Return the Kaplan-Meier curve of some runs with its pointwise 95 % band (exponential Greenwood).

    ``actions`` (n,) counts those of each run, and ``ended`` (n,) says whether it ended with its last one; otherwise it
    is censored. The curve has the numbers of ``runs`` and of those that ``ended``, the numbers of ``actions`` at which
    it steps or runs are censored, and for each the ``share`` of runs that survive so many, with its bounds ``low`` and
    ``high``: None at shares of 0 and 1, where the formula has no band.
    """
    counts = {"runs": len(actions), "ended": int(ended.sum())}
    if not ended.any():
        times = np.unique(actions).tolist()
        no_bounds = [None] * len(times)
        return {
            **counts,
            "actions": times,
            "share": [1.0] * len(times),
            "low": no_bounds,
            "high": no_bounds,
        }
    from scipy.stats import (
        CensoredData,
        ecdf,
    )  # takes a second, which runs without a failure do not need

    curve = ecdf(CensoredData(actions[ended], right=actions[~ended])).sf
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The confidence interval is undefined")
        band = curve.confidence_interval(CONFIDENCE, method="log-log")
    return {
        **counts,
        "actions": [int(n) for n in curve.quantiles],
        "share": [float(share) for share in curve.probabilities],
        "low": _bounds(band.low.probabilities),
        "high": _bounds(band.high.probabilities),
    }


def _bounds(shares: NDArray[np.float64]) -> list[float | None]:
    """Return the bounds of a band as JSON values, None where they are NaN."""
    bounds: list[float | None] = []
    for share in shares:
        if math.isnan(share):
            bounds.append(None)
        else:
            bounds.append(float(share))
    return bounds


def plan_survival(trials: DataFrame, attempts: DataFrame) -> dict[str, dict[str, Any]]:
    """Return the survival of the runs without error.

    ``without_resync``, open loop: a run ends with the first action that is not as predicted. ``with_resync``, closed
    loop: a run continues from the world that was read. It ends with the first action that is forbidden there, is
    unsafe, or leaves an unreadable world.
    """
    unreadable = attempts.finding.isin(("unreadable", "numerics", "diverged"))
    closed_loop = attempts[~attempts.legal | (attempts.result == Verdict.UNSAFE) | unreadable]
    return {
        "without_resync": _survival(trials, attempts[~attempts.result.isin(AGREEING)]),
        "with_resync": _survival(trials, closed_loop),
    }


def _survival(trials: DataFrame, ends: DataFrame) -> dict[str, Any]:
    """Return the survival of trials that end with their first attempt in ``ends``."""
    last = (ends.groupby("trial").number.min() + 1).reindex(trials.index)
    return survival(last.fillna(trials.attempts).to_numpy(int), last.notna().to_numpy())


def policy_scores(trials: DataFrame) -> list[dict[str, Any]]:
    """Return for each ``policy`` the success rates in the two worlds, ``grid`` and ``physics``, and its ``episodes``.

    They are groups of trials with a known success in both worlds, by name.
    """
    known = trials.grid.notna() & trials.physics.notna()
    scores = []
    for name, group in trials[known].groupby("group", observed=True):
        scores.append(
            {
                "policy": str(name),
                "grid": float(group.grid.mean()),
                "physics": float(group.physics.mean()),
                "episodes": len(group),
            }
        )
    return scores


@dataclass(frozen=True)
class Figures:
    """Metrics of all trials of a run; all but ``trials`` and ``errors`` count trials that repeat another one once."""

    trials: int
    errors: dict[str, int]
    """Unfinished trials, by error; they count in no other metric."""
    not_standing: int
    """Trials in worlds that cannot stand, where nothing was tried; they count in no share, no interval and no test."""
    without_actions: int
    """Other trials without an action to judge; they count nowhere, either."""
    identical: int
    """Trials that would repeat, or repeat, another one in every figure."""
    capped_steps: int
    """Physics steps in which the solver did not converge, over all attempts."""
    retried: int
    all: dict[str, Proportion]
    """``runs``: share of the trials with an attempt in which every one agrees; ``actions``: share of the legal
    attempts that are as predicted."""
    by_group: dict[str, dict[str, Proportion]]
    """The same for the trials of each plan, policy or context."""
    by_verb: dict[str, MatrixRow]
    matrix: dict[str, MatrixRow]
    precision: dict[str, Distribution | None]
    drift: dict[str, Distribution | None]
    durations: list[dict[str, Any]]
    survival: dict[str, dict[str, Any]]
    policies: list[dict[str, Any]]
    rank_agreement: RankAgreement | None
    """None for fewer than three policies."""


def campaign_figures(records: Iterable[TrialRecord], seed: int) -> Figures:
    """Return the metrics of a run's records; ``seed`` is that of the bootstrap."""
    # Iterated several times and never kept in memory: there may be a million.
    if isinstance(records, Iterator):
        records = list(records)
    distinct_records = distinct(records)
    trials = trials_frame(distinct_records)
    attempts = attempts_frame(distinct_records)
    legal = attempts[attempts.legal]
    scores = policy_scores(trials)
    return Figures(
        trials=sum(1 for _ in records),
        errors=error_counts(records),
        not_standing=not_standing(records),
        without_actions=_without_actions(records),
        identical=identical_trials(records),
        capped_steps=capped_steps(carried_out(distinct_records)),
        retried=retried(carried_out(distinct_records)),
        all={"runs": _share_of_runs(trials), "actions": MatrixRow.of(legal).success},
        by_group=_by_group(trials, legal),
        by_verb=_by_verb(legal),
        matrix=legality_matrix(attempts),
        precision=precision(legal),
        drift=drift(trials, attempts),
        durations=duration_table(as_predicted(legal)),
        survival=plan_survival(trials, attempts),
        policies=scores,
        rank_agreement=_rank_agreement(scores, seed),
    )


def _share_of_runs(trials: DataFrame) -> Proportion:
    judged = trials[trials.attempts > 0]
    return Proportion.of(int(judged.agrees.sum()), len(judged))


def _without_actions(records: Iterable[TrialRecord]) -> int:
    """Return the number of trials without an action to judge in worlds that stand."""
    without = sum(not record["attempts"] for record in carried_out(records))
    return without - not_standing(records)


def _by_group(trials: DataFrame, legal: DataFrame) -> dict[str, dict[str, Proportion]]:
    """Return the shares of runs that agree and of legal actions as predicted, by plan, policy or context."""
    good = legal.result.isin(AGREEING)
    counts = good.groupby(legal.group, observed=True).agg(["sum", "size"])
    # A group without attempts has zeros.
    counts = counts.reindex(trials.group.cat.categories, fill_value=0)
    shares = {}
    for name, group in trials.groupby("group", observed=True):
        n_good, n_actions = counts.loc[name]
        shares[str(name)] = {
            "runs": _share_of_runs(group),
            "actions": Proportion.of(int(n_good), int(n_actions)),
        }
    return shares


def _by_verb(legal: DataFrame) -> dict[str, MatrixRow]:
    """Return the results of the legal attempts by verb."""
    return {str(verb): MatrixRow.of(group) for verb, group in legal.groupby("verb", observed=True)}


def _rank_agreement(scores: Sequence[Mapping[str, Any]], seed: int) -> RankAgreement | None:
    """Return the agreement of both worlds on the ranks of policies; ``seed`` is that of the bootstrap."""
    grid = [score["grid"] for score in scores]
    physics = [score["physics"] for score in scores]
    return agreement_of(grid, physics, seed)
