"""Searching the margin of one scenario along one axis: what a worker does, and what its record holds."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Annotated, Any, Final

from pydantic import Field

from craftsim.checking.attempt import Attempt
from craftsim.experiments.experiment import Done, Item, TrialRecord
from craftsim.experiments.schema import STRICT
from craftsim.validation.margins.axes import Axis
from craftsim.validation.margins.search import BASE, search
from craftsim.validation.margins.trial import Rig, TrialResult

PROBES: Final = 3
"""Trials that must come out at the largest level as they do in the base, bit for bit, for no effect at all."""
_Count = Annotated[int, Field(ge=0, lt=2**53)]


class End(StrEnum):
    """How a search ended."""

    EDGE = "edge"
    """A trial fails at the level next to the margin."""
    LARGEST = "largest"
    """All trials stand the largest level."""
    NO_EFFECT = "no effect"
    """At the largest level nothing differs from the base."""
    BASE = "base"
    """Not even the base is stood."""


@dataclass(frozen=True)
class Limit:
    """A margin with its interval; values in the figure's own unit."""

    __pydantic_config__ = STRICT
    end: End
    margin: float | None
    """The largest value that all trials stood; None where they did not even stand the base."""
    upper: float | None
    """The value from which on more than 5 % fail; None where too few trials failed to say so."""
    fails_at: float | None
    """The value next to the margin, at which a trial failed; None where none did."""
    trial: int | None
    """Number of that trial, or of the one that failed in the base."""
    reason: str
    """Why it failed."""
    tried: _Count
    """How many times a trial was run."""


@dataclass(frozen=True)
class RowFound:
    """What is found of one row of a map."""

    __pydantic_config__ = STRICT
    stood: tuple[_Count, ...]
    """How many trials stand, by the level to the right."""
    of: _Count
    """Trials of each."""


def limit_of(record: TrialRecord) -> Limit:
    """Return what the record of a search says."""
    extra: dict[str, Any] = record["extra"]
    return Limit(**{**extra, "end": End(extra["end"])})


@dataclass(frozen=True, slots=True)
class MarginSearch:
    """A search, as it goes to a worker."""

    rig: Rig
    axis: Axis
    trials: int

    @property
    def item(self) -> Item:
        """It, as a campaign's item."""
        scenario = self.rig.scenario
        key = f"{scenario.name}/{self.axis.name}"
        return Item(key, scenario.action, self.rig.seed, self, context=scenario.name)


def find(one: MarginSearch) -> Done:
    """Search a margin."""
    limit, attempts = _find(one)
    extra = asdict(limit) | {"end": limit.end.value}
    return Done(agrees=limit.end is not End.BASE, attempts=attempts, extra=extra)


def _find(one: MarginSearch) -> tuple[Limit, tuple[Attempt, ...]]:
    rig, axis = one.rig, one.axis
    base = axis.value(rig.setup.randomization)
    values = [base, *(value for value in axis.levels if value > base)]
    results: dict[tuple[int, int], TrialResult] = {}

    def result(trial: int, level: int) -> TrialResult:
        if (trial, level) not in results:
            levels = () if level == BASE else ((axis, values[level]),)
            results[trial, level] = rig.attempt(trial, levels)
        return results[trial, level]

    largest, probes = len(values) - 1, range(min(PROBES, one.trials))
    if all(result(n, BASE) == result(n, largest) and not result(n, BASE).reason for n in probes):
        return Limit(End.NO_EFFECT, values[-1], None, None, None, "", len(results)), ()
    found = search(lambda trial, level: not result(trial, level).reason, largest, one.trials)
    margin = None if found.margin is None else values[found.margin]
    upper = None if found.upper is None else values[found.upper]
    if found.edge is None:
        return Limit(End.LARGEST, margin, upper, None, None, "", len(results)), ()
    trial, level = found.edge
    failed = result(trial, level)
    end, fails_at = (End.BASE, None) if level == BASE else (End.EDGE, values[level])
    return Limit(end, margin, upper, fails_at, trial, failed.reason, len(results)), failed.attempts
