"""The report of a comparison of two runs, such as a simulation and a laboratory."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from craftsim.experiments.compare import RealityGap
from craftsim.experiments.intervals import Estimate, Proportion
from craftsim.experiments.sections import bounds_text, changes_table, difference_text
from craftsim.experiments.statistics import ERRORS
from craftsim.reports import report as parts
from craftsim.reports.json_file import document
from craftsim.reports.report import Block, DataTable, Section, Tone, numbers

_KS_AT_5_PERCENT: Final = 1.358
"""Kolmogorov's constant: times the root of (n + m) / (n m) it is the least distance that the test finds at 5 %."""


def gap_report(gap: RealityGap, sim: Path, real: Path, seed: int) -> parts.Report:
    """Return the report of how a simulation and reality agree; ``seed`` is the bootstrap's."""
    badge, tone = ("No significant difference", Tone.CAUTION) if gap.agrees else ("Differs", Tone.BAD)
    return parts.Report(
        "Simulation and reality",
        f"{sim} and {real}",
        parts.Headline(badge, tone, difference_text(gap.trials, "the simulation", "reality")),
        [
            parts.KeyFigure(
                parts.percent(p.rate), f"agree in {where}", parts.interval(p.wilson_low, p.wilson_high)
            )
            for where, p in (("the simulation", gap.trials.first), ("reality", gap.trials.second))
        ],
        [_outcomes(gap), _verbs(gap), _errors(gap.error_shifts), _plans(gap)],
        document=document({"compare": gap}, command="compare", seed=seed, config={"sim": sim, "real": real}),
        exit_code=0 if gap.agrees else 1,
    )


def _outcomes(gap: RealityGap) -> Section:
    text = f"Of {gap.trials.words('in the simulation', 'in reality')}"
    table = changes_table(gap.changed, "simulation", "reality")
    lead = "The same trials in both, paired by their names."
    return Section("outcomes", "Outcomes", lead, [text, table], True)


def _verbs(gap: RealityGap) -> Section:
    table = DataTable(
        numbers("action", "pairs", "alike (95 %)", "good: sim", "real", "durations (95 %)"),
        [
            (
                *(verb, one["agreement"].trials, _share(one["agreement"])),
                *(f"{p.successes}/{p.trials}" for p in (one["sim"], one["real"])),
                _estimate(one["duration_ratio"]),
            )
            for verb, one in gap.by_verb.items()
        ],
        "By action",
        "Alike: as predicted in both or in neither; durations: of reality by the simulation, median.",
    )
    return Section("verbs", "By action", "Of what the rules allow.", [table], True)


def _errors(shifts: Mapping[str, Mapping[str, Any]]) -> Section:
    table = DataTable(
        numbers("error", "sim median", "95th", "real median", "95th", "KS distance", "detectable", "p"),
        [
            (
                ERRORS[name],
                *(f"{value:.3f}" for d in (one["sim"], one["real"]) for value in (d.median, d.p95)),
                *(f"{one['distance']:.3f}", f"{_least_distance(one['sim'].n, one['real'].n):.3f}"),
                f"{one['p_value']:.2g}",
            )
            for name, one in shifts.items()
        ],
        "Errors",
        "Of actions as predicted. Detectable: the least distance of Kolmogorov and Smirnov that their test finds at 5 "
        "% among so many.",
    )
    return Section("errors", "Errors", "How errors are distributed in both.", [table], True)


def _least_distance(n: int, m: int) -> float:
    return min(1.0, _KS_AT_5_PERCENT * math.sqrt((n + m) / (n * m)))


def _plans(gap: RealityGap) -> Section:
    table = DataTable(
        numbers("world: plan or policy", "runs", "success: sim", "real"),
        [
            (
                *(one["plan"], runs := one["runs"]),
                *(_share(Proportion.of(round(rate * runs), runs)) for rate in (one["sim"], one["real"])),
            )
            for one in gap.plans
        ],
        "Plans and policies",
    )
    ranks = "Ranks: at least three plans are needed."
    if gap.ranks is not None:
        ranks = (
            f"Ranks of {gap.ranks.policies} plans: Pearson {_estimate(gap.ranks.pearson)}, Spearman "
            f"{_estimate(gap.ranks.spearman)}, mean maximum rank violation {gap.ranks.mmrv:.3f}"
        )
    blocks: list[Block] = [*([table] if gap.plans else []), ranks]
    return Section("plans", "Plans and policies", "Success, and whether both rank alike.", blocks, True)


def _share(p: Proportion) -> str:
    return "-" if p.rate is None else f"{p.rate:.2f} ({p.wilson_low:.2f} to {p.wilson_high:.2f})"


def _estimate(one: Estimate) -> str:
    return "not defined" if one.value is None else f"{one.value:.2f} ({bounds_text(one)})"
