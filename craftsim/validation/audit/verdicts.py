"""The rows of a rule audit: what physics says of each rule in each context."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from craftsim.checking.attempt import Verdict
from craftsim.experiments.experiment import TrialRecord
from craftsim.experiments.intervals import wilson
from craftsim.experiments.statistics import RESULTS

SOUND_SHARE: Final = 0.95
"""A rule that allows an action is sound where at least this share of trials does what it predicts. One that forbids an
action is conservative where, by the same bar, it could have allowed it. Set before any audit was run."""

MIN_TRIALS: Final = 20
"""Trials of a row from which its verdict counts as found, and is provisional with fewer: 20 of 20 put the success rate
above 0.83 with 95 % confidence."""

_NUMBER: Final = re.compile(r"\d+(\.\d+)?")


class Judgement(StrEnum):
    """The verdict on a rule in a context."""

    UNSOUND = "unsound"
    """It allows what physics refuses."""
    CONSERVATIVE = "conservative"
    """It forbids what would have worked."""
    SOUND = "sound"
    """It allows what works."""
    RIGHTLY_FORBIDDEN = "rightly forbidden"
    """It forbids what does not work."""
    NO_PREDICTION = "no prediction"
    """It forbids what has no intended effect: there is nothing to try."""
    NOT_TRIED = "not tried"
    """Errors kept all trials from an end, or the solver gave up in all."""


@dataclass(frozen=True)
class AuditRow:
    """All trials of one action in one context."""

    action: str
    context: str
    legal: bool
    has_prediction: bool
    trials: int
    """Those that were carried out and solved; of each, the worst result of its attempts counts."""
    as_predicted: int
    failed: int
    side_effect: int
    unsafe: int
    wilson_low: float
    wilson_high: float
    """Of the share that did as predicted, at 95 % confidence."""
    verdict: str
    """A :class:`Judgement`."""
    reason: str
    """A reason of the commonest kind why trials did not do as predicted, counted where there are other kinds."""
    bundles: tuple[str, ...]
    """Folders that replay disagreements."""
    numerics: int = 0
    """Trials that were not solved: they say nothing of the rule."""
    errors: int = 0
    """Trials that an exception, a timeout or a lost worker kept from an end."""

    @property
    def provisional(self) -> bool:
        """Whether the verdict is one of fewer than :data:`MIN_TRIALS` trials."""
        return 0 < self.trials < MIN_TRIALS


def provisional_note(rows: Iterable[AuditRow]) -> str:
    """Return a sentence on the rows whose verdicts are provisional; empty when there are none."""
    few = sum(row.provisional for row in rows)
    are = "row is" if few == 1 else "rows are"
    return f"{few:,} {are} judged by fewer than {MIN_TRIALS} trials: provisional." if few else ""


def audit_rows(records: Iterable[TrialRecord]) -> list[AuditRow]:
    """Return one row for each ``group`` of records, sorted by group.

    A group's name is the action, a slash and the context. A row is legal when all its attempts are; one whose trials
    have neither attempts nor errors has no prediction.
    """
    groups: dict[str, _Group] = {}
    for record in records:
        groups.setdefault(record["group"], _Group()).add(record)
    return [group.row(name) for name, group in sorted(groups.items())]


def kind_of(reason: str) -> str:
    """Return a reason with its numbers masked: reasons that differ only in these are of one kind."""
    return _NUMBER.sub("#", reason)


def verdict_counts(rows: Iterable[AuditRow]) -> dict[str, int]:
    """Return how many rows have each verdict, in the order of :class:`Judgement`, zeros included."""
    found = Counter(row.verdict for row in rows)
    return {str(judgement): found[judgement] for judgement in Judgement}


def judge(legal: bool, has_prediction: bool, trials: int, as_predicted: int) -> Judgement:
    """Return the verdict on a rule from its trials, by :data:`SOUND_SHARE`."""
    if not has_prediction:
        return Judgement.NO_PREDICTION
    if not trials:
        return Judgement.NOT_TRIED
    works = as_predicted >= SOUND_SHARE * trials
    if legal:
        return Judgement.SOUND if works else Judgement.UNSOUND
    return Judgement.CONSERVATIVE if works else Judgement.RIGHTLY_FORBIDDEN


def worst(record: TrialRecord) -> Verdict | None:
    """Return the worst result among a trial's attempts, None when there is none."""
    results = [Verdict(attempt["result"]) for attempt in record["attempts"]]
    return max(results, key=RESULTS.index, default=None)


@dataclass
class _Group:
    """What is counted of the trials of one row."""

    results: Counter[Verdict] = field(default_factory=Counter)
    errors: int = 0
    legal: bool = True
    bundles: list[str] = field(default_factory=list)
    reasons: dict[str, str] = field(default_factory=dict)
    """Why trials did not do as predicted, the first reason of each kind: those that differ in numbers alone are one."""
    kinds: Counter[str] = field(default_factory=Counter)

    def add(self, record: TrialRecord) -> None:
        self.legal &= all(attempt["legal"] for attempt in record["attempts"])
        if record["bundle"]:
            self.bundles.append(record["bundle"])
        if record["error"] is not None:
            self.errors += 1
        elif (result := worst(record)) is not None:
            self.results[result] += 1
            if result is not Verdict.AS_PREDICTED:
                reason = next(a["reason"] for a in record["attempts"] if a["result"] == result)
                self.reasons.setdefault(kind_of(reason), reason)
                self.kinds[kind_of(reason)] += 1

    def row(self, name: str) -> AuditRow:
        action, _, context = name.partition("/")
        good, failed, side_effect, unsafe, numerics = (self.results[result] for result in RESULTS)
        trials = self.results.total() - numerics
        has_prediction = bool(self.results) or bool(self.errors)
        low, high = wilson(good, trials)
        return AuditRow(
            action=action,
            context=context,
            legal=self.legal and has_prediction,
            has_prediction=has_prediction,
            trials=trials,
            as_predicted=good,
            failed=failed,
            side_effect=side_effect,
            unsafe=unsafe,
            wilson_low=low,
            wilson_high=high,
            verdict=judge(self.legal, has_prediction, trials, good).value,
            reason=self._reason(),
            bundles=tuple(self.bundles),
            numerics=numerics,
            errors=self.errors,
        )

    def _reason(self) -> str:
        """Return a reason of the commonest kind why trials did not do as predicted; the first of equals."""
        if not self.kinds:
            return ""
        (commonest, n), *others = self.kinds.most_common()
        reason = self.reasons[commonest]
        return f"{reason} ({n} of {self.kinds.total()})" if others else reason
