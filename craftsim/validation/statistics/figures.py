"""All figures of a campaign, as a report holds them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from craftsim.checking.attempt import Verdict
from craftsim.validation.statistics.durations import Duration, duration_table
from craftsim.validation.statistics.matrix import LegalityMatrix, MatrixRow, Results, legality_matrix
from craftsim.validation.statistics.precision import Distribution, Precision, drift, precision
from craftsim.validation.statistics.proportions import Proportion
from craftsim.validation.statistics.ranking import PolicyScore, RankAgreement, policy_scores, rank_agreement
from craftsim.validation.statistics.records import (
    AttemptRecord,
    Record,
    attempts_of,
    capped_steps,
    carried_out,
    error_counts,
    retried,
)
from craftsim.validation.statistics.survival import PlanSurvival, plan_survival


@dataclass(frozen=True)
class GroupFigures:
    """Figures of the trials of one plan, policy or context."""

    runs: Proportion
    """Share of trials in which every attempt agrees; those with an error are left out."""
    actions: Proportion
    """Share of legal attempts that did what was predicted, and nothing else."""


@dataclass(frozen=True)
class Figures:
    """What the trials of a campaign say together."""

    trials: int
    errors: dict[str, int]
    """Trials that did not come to an end, by what kept them from it; they count in no other figure."""
    capped_steps: int
    """Physics steps in which the solver gave up, summed over all attempts."""
    retried: int
    """Actions that were tried more than once."""
    all: GroupFigures
    by_group: dict[str, GroupFigures]
    by_verb: dict[str, MatrixRow]
    """Legal attempts alone."""
    matrix: LegalityMatrix
    precision: Precision
    """Of legal attempts."""
    drift: dict[str, Distribution | None]
    durations: list[Duration]
    survival: PlanSurvival
    policies: list[PolicyScore]
    rank_agreement: RankAgreement | None
    """None for fewer than three policies."""


def campaign_figures(records: Iterable[Record], seed: int) -> Figures:
    """Return the figures of a campaign's records; ``seed`` is that of the bootstrap."""
    # Gone through again and again, and never held: there may be a million.
    known = list(records) if isinstance(records, Iterator) else records
    every, groups, verbs = _Tally(), defaultdict[str, _Tally](_Tally), defaultdict[str, Results](Counter)
    for record in carried_out(known):
        every.add(record)
        groups[record["group"]].add(record)
        for attempt in record["attempts"]:
            if attempt["legal"]:
                verbs[attempt["verb"]][Verdict(attempt["result"])] += 1
    scores = policy_scores(known)
    return Figures(
        trials=sum(1 for _ in known),
        errors=error_counts(known),
        capped_steps=capped_steps(carried_out(known)),
        retried=retried(carried_out(known)),
        all=every.figures(),
        by_group={name: group.figures() for name, group in sorted(groups.items())},
        by_verb={verb: MatrixRow.counted(results) for verb, results in sorted(verbs.items())},
        matrix=legality_matrix(attempts_of(carried_out(known))),
        precision=precision(_legal(known)),
        drift=drift(carried_out(known)),
        durations=duration_table(_legal(known)),
        survival=plan_survival(known),
        policies=scores,
        rank_agreement=rank_agreement(scores, seed),
    )


def _legal(records: Iterable[Record]) -> Iterator[AttemptRecord]:
    return (attempt for attempt in attempts_of(carried_out(records)) if attempt["legal"])


@dataclass
class _Tally:
    """Counts of the trials of one plan, policy or context, or of all."""

    runs: int = 0
    agree: int = 0
    legal: Results = field(default_factory=Counter)

    def add(self, record: Record) -> None:
        self.runs += 1
        self.agree += record["agrees"]
        self.legal.update(Verdict(attempt["result"]) for attempt in record["attempts"] if attempt["legal"])

    def figures(self) -> GroupFigures:
        return GroupFigures(Proportion.of(self.agree, self.runs), MatrixRow.counted(self.legal).success)
