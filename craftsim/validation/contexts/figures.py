"""Figures of many trials: success with its interval, quantiles of errors and durations, failures by reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from craftsim.validation.contexts.context import Context
from craftsim.validation.contexts.survey import Survey
from craftsim.validation.statistics.proportions import wilson
from craftsim.validation.statistics.records import Record, carried_out, error_counts, grouped


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


def summarise(records: Iterable[Record]) -> Summary:
    """Return the figures of some trials; one that came to no end counts as failed."""
    trials = list(records)
    results = [record["extra"] for record in carried_out(trials)]
    successes = sum(record["agrees"] for record in trials)
    low, high = wilson(successes, len(trials))

    def quantiles(name: str, scale: float = 1.0) -> Quantiles | None:
        return Quantiles.of([scale * result[name] for result in results if result[name] is not None])

    return Summary(
        trials=len(trials),
        successes=successes,
        wilson_low=low,
        wilson_high=high,
        car_error_mm=quantiles("car_error_m", 1e3),
        heading_error_mrad=quantiles("heading_error_rad", 1e3),
        placed_error_mm=quantiles("placed_error_m", 1e3),
        others_moved_mm=quantiles("others_moved_m", 1e3),
        duration_s=quantiles("duration_s"),
    )


def summaries(
    records: Iterable[Record], contexts: Mapping[str, Context], key: Callable[[Context], str]
) -> dict[str, Summary]:
    """Return the figures of each group of trials; ``contexts`` gives the context of each id."""
    groups = grouped(records, lambda record: key(contexts[str(record["context"])]))
    return {name: summarise(group) for name, group in groups.items()}


def reason(record: Record) -> str:
    """Return why a trial failed, or what kept it from an end."""
    return record["error"] or "; ".join(record["extra"]["reasons"])


def reasons(records: Iterable[Record]) -> dict[str, int]:
    """Return how many trials failed for which reasons, commonest first."""
    return dict(Counter(reason(record) for record in records if not record["agrees"]).most_common())


def campaign_figures(
    records: Sequence[Record], contexts: Mapping[str, Context], survey: Survey
) -> dict[str, Any]:
    """Return what a report says of a campaign."""
    return {
        "contexts": len(survey.contexts),
        "contexts_tried": len({record["context"] for record in records}),
        "combinations": survey.n_combinations,
        "impossible": dict(survey.impossible),
        "forbidden": dict(survey.forbidden),
        "all": summarise(records),
        "success_rate": summarise(records).rate,
        "by": {name: summaries(records, contexts, key) for name, key in GROUPS.items()},
        "failures": reasons(records),
        "errors": error_counts(records),
    }
