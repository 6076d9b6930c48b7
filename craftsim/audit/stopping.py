"""When the trials of an audit's row are enough, and how many rows are wrongly judged at most."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Final

from craftsim.audit.plan import PlanRow
from craftsim.checking.attempt import AGREEING, Verdict
from craftsim.experiments.anytime import CONFIDENCE, log_evidence_below
from craftsim.experiments.experiment import Trial, TrialRecord

SOUND_SHARE: Final = 0.95
"""A rule that allows an action is sound if at least this share of trials is as predicted. A rule that forbids one is
conservative if, by the same threshold, it could have allowed it. Fixed before any audit was run."""
FAILING_ERROR: Final = 0.01
"""Probability at most with which a row that works is called failing before all its trials were run."""
PERFECT_TRIALS: Final = 8
"""A row works if so many trials, and one of each of its situations, are as predicted without exception."""
_FIRST_ROUND: Final = 2
_LATER_ROUND: Final = 4


def is_settled(as_predicted: int, trials: int) -> bool:
    """Return whether a row needs no further trials: it works, or it certainly fails."""
    if as_predicted == trials:
        return trials >= PERFECT_TRIALS
    evidence = float(log_evidence_below(as_predicted, trials, SOUND_SHARE))
    return evidence >= -math.log(FAILING_ERROR)


def is_as_predicted(record: TrialRecord) -> bool | None:
    """Return whether a trial is as predicted; None if it tells nothing of the rule: it has an error or no attempts, or
    the solver did not converge."""
    results = {attempt["result"] for attempt in record["attempts"]}
    if not results or Verdict.NUMERICS in results:
        return None
    return results <= set(AGREEING)


def order_of(trial: Trial) -> tuple[int, int]:
    """Return the place of a trial among those of its row: each situation once, in a random order, then each again."""
    if trial.job is None:
        return 0, 0
    return trial.job.number, trial.job.situation.digest


class RowRule:
    """Runs trials of each row until its verdict is settled; see :class:`StoppingRule`."""

    def __init__(self, rows: Iterable[PlanRow]) -> None:
        """Take the rows of the audit."""
        self._members = Counter[str]()
        for row in rows:
            self._members[row.name] += len(row.members)
        self._trials = Counter[str]()
        self._good = Counter[str]()

    def subject_of(self, trial: Trial) -> str:
        """Return the name of a trial's row."""
        return trial.group

    def order_of(self, trial: Trial) -> tuple[int, int]:
        """Return the place of a trial among those of its row."""
        return order_of(trial)

    def round_sizes(self) -> Iterator[int]:
        """Yield numbers of trials: two, so many that a row without a failure works, and some more."""
        yield _FIRST_ROUND
        yield PERFECT_TRIALS - _FIRST_ROUND
        yield from repeat(_LATER_ROUND)

    def is_decided(self, subject: str, records: Sequence[TrialRecord]) -> bool:
        """Count the records of a round, and return whether the row is settled."""
        for record in records:
            outcome = is_as_predicted(record)
            self._trials[subject] += outcome is not None
            self._good[subject] += outcome is True
        trials = self._trials[subject]
        good = self._good[subject]
        if good == trials and trials < self._members[subject]:
            return False
        return is_settled(good, trials)


@dataclass(frozen=True)
class ErrorBound:
    """How many rows without a failure in their first trials succeed less often than they should, at most."""

    success_rate: float
    rows: float
    """Expected number of rows of at most this success rate that pass ``PERFECT_TRIALS`` trials without a failure."""


def error_bounds(
    outcomes_by_row: Iterable[Sequence[bool]], success_rates: Sequence[float]
) -> list[ErrorBound]:
    """Return bounds of wrong calls from the outcomes of each row, in the order of :func:`order_of`.

    The trials of a row are taken to succeed independently, at one rate.

    A row of the success rate p that passed the first half of ``PERFECT_TRIALS`` passes the second half with the
    probability p^4, and fails in it with 1 - p^4. So the expected number of rows of at most the rate p that pass both
    is at most p^4 / (1 - p^4) times that of rows which fail in the second half only. Of these the run shows a
    number, and from it the upper bound of the expectation with 95 % confidence (Clopper and Pearson; by Hoeffding, "On
    the distribution of the number of successes in independent trials", 1956, it holds for unlike rows too).
    """
    from scipy.stats import beta

    half = PERFECT_TRIALS // 2
    rows = 0
    late_failures = 0
    for outcomes in outcomes_by_row:
        first = outcomes[:half]
        second = outcomes[half:PERFECT_TRIALS]
        if len(first) < half or not all(first):
            continue
        rows += 1
        late_failures += not all(second)
    if not rows:
        return []
    share = 1.0
    if late_failures < rows:
        share = float(beta.ppf(CONFIDENCE, late_failures + 1, rows - late_failures))
    bounds = []
    for success_rate in success_rates:
        ratio = success_rate**half / (1 - success_rate**half)
        bounds.append(ErrorBound(success_rate, rows * share * ratio))
    return bounds


def outcomes_of(items: Sequence[Trial], records: Iterable[TrialRecord]) -> list[list[bool]]:
    """Return the outcomes of each row's trials, in the order of :func:`order_of`."""
    by_row = dict[str, list[tuple[tuple[int, int], bool]]]()
    for record in records:
        outcome = is_as_predicted(record)
        if outcome is None:
            continue
        place = order_of(items[record["index"]])
        by_row.setdefault(record["group"], []).append((place, outcome))
    return [[outcome for _, outcome in sorted(row)] for row in by_row.values()]
