"""All figures of a campaign, as a report holds them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from craftsim.validation.statistics.durations import Duration, duration_table
from craftsim.validation.statistics.matrix import LegalityMatrix, MatrixRow, legality_matrix
from craftsim.validation.statistics.precision import Distribution, Precision, drift, precision
from craftsim.validation.statistics.proportions import Proportion
from craftsim.validation.statistics.ranking import PolicyScore, RankAgreement, policy_scores, rank_agreement
from craftsim.validation.statistics.records import (
    Record,
    attempts_of,
    capped_steps,
    carried_out,
    error_counts,
    grouped,
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
    known = list(records)
    done = list(carried_out(known))
    attempts = list(attempts_of(done))
    legal = [attempt for attempt in attempts if attempt["legal"]]
    scores = policy_scores(done)
    return Figures(
        trials=len(known),
        errors=error_counts(known),
        capped_steps=capped_steps(done),
        all=_group(done),
        by_group={name: _group(group) for name, group in grouped(done, lambda r: str(r["group"])).items()},
        by_verb={
            verb: MatrixRow.of(group) for verb, group in grouped(legal, lambda a: str(a["verb"])).items()
        },
        matrix=legality_matrix(attempts),
        precision=precision(legal),
        drift=drift(done),
        durations=duration_table(legal),
        survival=plan_survival(done),
        policies=scores,
        rank_agreement=rank_agreement(scores, seed),
    )


def _group(records: list[Record]) -> GroupFigures:
    legal = [attempt for attempt in attempts_of(records) if attempt["legal"]]
    return GroupFigures(
        Proportion.of(sum(bool(record["agrees"]) for record in records), len(records)),
        MatrixRow.of(legal).success,
    )
