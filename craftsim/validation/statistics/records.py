"""Reading the records of a campaign; all figures are made of nothing else."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Final, TypeAlias, TypeVar

from craftsim.checking.attempt import Verdict
from craftsim.experiments.experiment import TrialRecord

Record: TypeAlias = TrialRecord
"""One trial, a line of ``trials.jsonl``."""
AttemptRecord: TypeAlias = Mapping[str, Any]
"""One attempt of a trial, an :class:`~craftsim.checking.attempt.Attempt` as a mapping."""

RESULTS: Final = (Verdict.AS_PREDICTED, Verdict.FAILED, Verdict.SIDE_EFFECT, Verdict.UNSAFE, Verdict.SOLVER)
"""Results from the best to the worst, the order of columns and of :func:`worst`; the last proves nothing."""


_T = TypeVar("_T")


def carried_out(records: Iterable[Record]) -> Iterator[Record]:
    """Yield the records of trials that were carried out: those without an error."""
    return (record for record in records if record["error"] is None)


def attempts_of(records: Iterable[Record]) -> Iterator[AttemptRecord]:
    """Yield the attempts of all trials, in their order."""
    return (attempt for record in records for attempt in record["attempts"])


def as_predicted(attempt: AttemptRecord) -> bool:
    """Return whether an attempt did what was predicted, and nothing else."""
    return bool(attempt["result"] == Verdict.AS_PREDICTED)


def worst(record: Record) -> Verdict | None:
    """Return the worst result among a trial's attempts, None when there is none."""
    results = [Verdict(attempt["result"]) for attempt in record["attempts"]]
    return max(results, key=RESULTS.index, default=None)


def capped_steps(records: Iterable[Record]) -> int:
    """Return in how many physics steps the solver gave up, summed over all attempts."""
    return sum(int(attempt.get("capped_steps", 0)) for attempt in attempts_of(records))


def retried(records: Iterable[Record]) -> int:
    """Return how many actions were tried more than once."""
    return sum(attempt.get("tries", 1) > 1 for attempt in attempts_of(records))


def error_counts(records: Iterable[Record]) -> dict[str, int]:
    """Return how many trials did not come to an end, by what kept them from it, commonest first."""
    found = Counter(str(record["error"]) for record in records if record["error"] is not None)
    return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))


def grouped(items: Iterable[_T], key: Callable[[_T], str]) -> dict[str, list[_T]]:
    """Return items by their group, groups in the order of their names."""
    groups: dict[str, list[_T]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return dict(sorted(groups.items()))
