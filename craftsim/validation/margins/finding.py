"""Searching the margin of one scenario along one axis: what a worker does."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Final

from craftsim.checking.attempt import Attempt
from craftsim.experiments.experiment import Done, Item
from craftsim.validation.margins.axes import Axis
from craftsim.validation.margins.limit import End, Limit
from craftsim.validation.margins.search import BASE, search
from craftsim.validation.margins.trial import Rig, TrialResult

PROBES: Final = 3
"""Trials that must come out at the largest level as they do in the base, bit for bit, for no effect at all."""


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
