"""A simulation against reality, or two runs of any kind: outcomes, durations, errors and ranks with intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from craftsim.errors import InputError
from craftsim.experiments.records import Finished, described, read_finished
from craftsim.validation.forms import RUNS, TRIALS
from craftsim.validation.statistics.alike import Alike, Tried, alike, paired_actions
from craftsim.validation.statistics.paired import Paired, changes, compare_paired
from craftsim.validation.statistics.precision import Distribution, errors
from craftsim.validation.statistics.proportions import CONFIDENCE, Proportion
from craftsim.validation.statistics.ranking import Estimate, RankAgreement, agreement_of
from craftsim.validation.statistics.records import Record, attempts_of, carried_out, grouped

FORMS: Final = {"validate": RUNS, "audit": TRIALS}
"""What the records of the commands hold that make runs to compare."""


@dataclass(frozen=True)
class VerbAgreement:
    """One kind of action in both worlds, of what the rules allow."""

    agreement: Proportion
    """Share of the paired actions that went as predicted in both or in neither."""
    sim: Proportion
    """Share that went as predicted in the simulation."""
    real: Proportion
    duration_ratio: Estimate
    """Of reality by the simulation: the median over actions as predicted in both, and its exact 95 % interval."""


@dataclass(frozen=True)
class ErrorShift:
    """How one error is distributed in both worlds, over actions as predicted."""

    sim: Distribution
    real: Distribution
    distance: float
    """Kolmogorov and Smirnov's: the largest difference between the two shares of errors up to a size."""
    p_value: float
    """How likely a distance at least as large is if both are distributed alike."""


@dataclass(frozen=True)
class PlanScore:
    """How many of the paired runs of a plan or policy in a world succeed: reach the goal, or without one agree."""

    plan: str
    runs: int
    sim: float
    """Share of them in the simulation."""
    real: float


@dataclass(frozen=True)
class RealityGap:
    """How a simulation and reality, or two runs of any kind, agree on the same trials."""

    changed: Mapping[str, tuple[Any, Any]]
    """Settings and versions that differ, by their dotted names, as far as both declare them."""
    trials: Paired
    """The simulation is the first."""
    actions: Alike
    """The simulation is the first here, too."""
    by_verb: Mapping[str, VerbAgreement]
    error_shifts: Mapping[str, ErrorShift]
    """By the field of an attempt, in thousandths of its unit: millimetres or milliradians."""
    plans: Sequence[PlanScore]
    ranks: RankAgreement | None
    """Over these plans; None for fewer than three."""

    @property
    def agrees(self) -> bool:
        """Whether no difference in how many trials agree with the rules shows, by McNemar's test at 5 %."""
        return self.trials.p_value >= 1 - CONFIDENCE


def read_run(folder: Path) -> Finished:
    """Return the finished run in a folder; raise InputError for a folder that holds none of validate or audit."""
    with described(folder, "give the --out of 'craftsim validate' or 'craftsim audit'") as (_, manifest):
        command = manifest["command"]
    if command not in FORMS:
        raise InputError(f"{folder} holds a run of another command; allowed: {', '.join(FORMS)}")
    return read_finished(folder, command, FORMS[command])


def compare_with_reality(sim: Finished, real: Finished, seed: int = 0) -> RealityGap:
    """Return how two runs agree on the trials that they share, paired by their keys; ``seed`` is the bootstrap's.

    Raises InputError for runs that share no trial.
    """
    shared = {r["key"] for r in carried_out(sim.records)} & {r["key"] for r in carried_out(real.records)}
    if not shared:
        raise InputError(
            f"{sim.folder} and {real.folder} have no trial in common that both carried out, so that nothing is paired; "
            "both need the same worlds, plans or policies, and trials of the same numbers"
        )
    one, other = ([r for r in run.records if r["key"] in shared] for run in (sim, real))
    plans = _plans(one, other)
    return RealityGap(
        changed=changes(sim.manifest, real.manifest),
        trials=compare_paired(one, other),
        actions=alike(one, other),
        by_verb=_by_verb(paired_actions(one, other)),
        error_shifts=_shifts(one, other),
        plans=plans,
        ranks=agreement_of([plan.sim for plan in plans], [plan.real for plan in plans], seed),
    )


def _by_verb(pairs: Iterable[tuple[str, Tried, Tried]]) -> dict[str, VerbAgreement]:
    legal = [(a, b) for _, a, b in pairs if a.legal and b.legal]
    return {
        verb: VerbAgreement(
            Proportion.of(sum(a.good == b.good for a, b in some), len(some)),
            Proportion.of(sum(a.good for a, _ in some), len(some)),
            Proportion.of(sum(b.good for _, b in some), len(some)),
            _median([b.duration_s / a.duration_s for a, b in some if a.good and b.good and a.duration_s > 0]),
        )
        for verb, some in grouped(legal, lambda pair: pair[0].verb).items()
    }


def _median(values: Sequence[float]) -> Estimate:
    """Return a median with the interval that the sign test gives, whatever the distribution."""
    from scipy.stats import quantile_test

    if not values:
        return Estimate(None, None, None)
    interval = quantile_test(values, p=0.5).confidence_interval(CONFIDENCE)
    low, high = (float(bound) if np.isfinite(bound) else None for bound in interval)
    return Estimate(float(np.median(values)), low, high)


def _shifts(sim: Iterable[Record], real: Iterable[Record]) -> dict[str, ErrorShift]:
    from scipy.stats import ks_2samp

    found = {}
    first, second = (errors(a for a in attempts_of(run) if a["legal"]) for run in (sim, real))
    for name, values in first.items():
        one, other = Distribution.of(values), Distribution.of(second[name])
        if one is not None and other is not None:
            test = ks_2samp(values, second[name])
            found[name] = ErrorShift(one, other, float(test.statistic), float(test.pvalue))
    return found


def _plans(sim: Iterable[Record], real: Iterable[Record]) -> list[PlanScore]:
    one, other = (_successes(run) for run in (sim, real))
    return [
        PlanScore(name, n["runs"], n["succeeded"] / n["runs"], other[name]["succeeded"] / n["runs"])
        for name, n in sorted(one.items())
    ]


def _successes(run: Iterable[Record]) -> dict[str, Counter[str]]:
    """Return for each plan in each world its number of runs, and of those that succeed."""
    found: dict[str, Counter[str]] = {}
    for record in run:
        counts = found.setdefault(f"{record['context']}: {record['group']}", Counter())
        counts["runs"] += 1
        counts["succeeded"] += record["extra"].get("physics_success", record["agrees"])
    return found
