"""The rows of a rule audit: what physics says of each rule in each context."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from craftsim.checking.attempt import Result
from craftsim.validation.statistics.proportions import wilson
from craftsim.validation.statistics.records import RESULTS, Record, carried_out, grouped, worst

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


def audit_rows(records: Iterable[Record]) -> list[AuditRow]:
    """Return one row for each ``group`` of records, sorted by group.

    A group's name is the action, a slash and the context. A row is legal when all its attempts are; one whose trials
    have neither attempts nor errors has no prediction.
    """
    return [_row(group, trials) for group, trials in grouped(records, lambda r: str(r["group"])).items()]


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


def _row(group: str, records: Sequence[Record]) -> AuditRow:
    action, _, context = group.partition("/")
    known = [result for record in carried_out(records) if (result := worst(record)) is not None]
    results = [result for result in known if result is not Result.NUMERICS]
    errors = sum(record["error"] is not None for record in records)
    good, failed, side_effect, unsafe, numerics = (known.count(result) for result in RESULTS)
    legal = all(attempt["legal"] for record in records for attempt in record["attempts"])
    has_prediction = bool(known) or bool(errors)
    low, high = wilson(good, len(results))
    return AuditRow(
        action=action,
        context=context,
        legal=legal and has_prediction,
        has_prediction=has_prediction,
        trials=len(results),
        as_predicted=good,
        failed=failed,
        side_effect=side_effect,
        unsafe=unsafe,
        wilson_low=low,
        wilson_high=high,
        verdict=judge(legal, has_prediction, len(results), good).value,
        reason=_reason(records),
        bundles=tuple(record["bundle"] for record in records if record["bundle"]),
        numerics=numerics,
        errors=errors,
    )


def _reason(records: Iterable[Record]) -> str:
    """Return a reason of the commonest kind why trials did not do as predicted.

    Reasons that differ in their numbers alone are of one kind, named by the first of them.
    """
    kinds: dict[str, list[str]] = {}
    for record in carried_out(records):
        if (result := worst(record)) not in (None, Result.AS_PREDICTED):
            reason = next(a["reason"] for a in record["attempts"] if a["result"] == result)
            kinds.setdefault(kind_of(reason), []).append(reason)
    if not kinds:
        return ""
    commonest = max(kinds.values(), key=len)
    total = sum(map(len, kinds.values()))
    return commonest[0] if len(kinds) == 1 else f"{commonest[0]} ({len(commonest)} of {total})"
