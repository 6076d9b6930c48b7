"""Figures of many trials: success with its interval, quantiles of errors and durations, failures by reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from craftsim.validation.contexts.survey import Context, Survey
from craftsim.validation.contexts.trials import TrialRecord
from craftsim.validation.statistics.proportions import wilson


def _action(context: Context) -> str:
    return context.id.split("/", 1)[0]


GROUPS: Final[dict[str, Callable[[Context], str]]] = {
    "action": _action,
    "load": lambda context: "none" if not context.load else context.load.name.lower(),
    "level": lambda context: str(context.level),
    "ground": lambda context: context.ground.label,
    "own": lambda context: context.own.kind.name.lower(),
    "room": lambda context: "tight" if context.tight else "free",
}
"""By what trials are grouped, and the name of a context's group."""


@dataclass(frozen=True)
class Quantiles:
    """Median and 99th percentile."""

    p50: float
    p99: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Quantiles | None:
        """Return the quantiles of some values, None of none."""
        return cls(*(float(q) for q in np.quantile(values, (0.5, 0.99)))) if values else None


@dataclass(frozen=True)
class Summary:
    """Figures of a group of trials."""

    trials: int
    successes: int
    wilson_low: float
    """Lower bound of the 95 % interval of the success rate."""
    wilson_high: float
    car_error_mm: Quantiles | None
    heading_error_mrad: Quantiles | None
    placed_error_mm: Quantiles | None
    others_moved_mm: Quantiles | None
    duration_s: Quantiles | None

    @property
    def rate(self) -> float:
        """Share of trials that succeeded; 0 of none."""
        return self.successes / self.trials if self.trials else 0.0


def summarise(records: Iterable[TrialRecord]) -> Summary:
    """Return the figures of some trials."""
    trials = list(records)
    successes = sum(record.succeeded for record in trials)
    low, high = wilson(successes, len(trials))
    return Summary(
        trials=len(trials),
        successes=successes,
        wilson_low=low,
        wilson_high=high,
        car_error_mm=Quantiles.of([1e3 * r.car_error_m for r in trials]),
        heading_error_mrad=Quantiles.of([1e3 * r.heading_error_rad for r in trials]),
        placed_error_mm=Quantiles.of(
            [1e3 * r.placed_error_m for r in trials if r.placed_error_m is not None]
        ),
        others_moved_mm=Quantiles.of([1e3 * r.others_moved_m for r in trials]),
        duration_s=Quantiles.of([r.duration_s for r in trials]),
    )


def grouped(
    records: Iterable[TrialRecord], contexts: Mapping[str, Context], key: Callable[[Context], str]
) -> dict[str, Summary]:
    """Return the figures of each group of trials; ``contexts`` gives the context of each id."""
    groups: dict[str, list[TrialRecord]] = {}
    for record in records:
        groups.setdefault(key(contexts[record.context]), []).append(record)
    return {name: summarise(groups[name]) for name in sorted(groups)}


def reasons(records: Iterable[TrialRecord]) -> dict[str, int]:
    """Return how many trials failed for which reasons, commonest first."""
    return dict(Counter("; ".join(r.reasons) for r in records if not r.succeeded).most_common())


def campaign_figures(
    records: Sequence[TrialRecord], contexts: Mapping[str, Context], survey: Survey
) -> dict[str, Any]:
    """Return what a report says of a campaign."""
    return {
        "contexts": len(survey.contexts),
        "contexts_tried": len({record.context for record in records}),
        "combinations": survey.n_combinations,
        "impossible": dict(survey.impossible),
        "forbidden": dict(survey.forbidden),
        "all": summarise(records),
        "success_rate": summarise(records).rate,
        "by": {name: grouped(records, contexts, key) for name, key in GROUPS.items()},
        "failures": reasons(records),
    }
