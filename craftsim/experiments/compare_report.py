"""The report of how two runs of the same trials agree, such as a simulation and reality."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from craftsim.checking.measurements import MEASUREMENTS
from craftsim.experiments.compare import RealityGap
from craftsim.experiments.intervals import Estimate, Proportion
from craftsim.experiments.report_parts import (
    arms_table,
    bounds_text,
    changes_table,
    difference_text,
)
from craftsim.reports.json_file import document
from craftsim.reports.report import (
    Block,
    DataTable,
    Headline,
    KeyFigure,
    Report,
    Section,
    Tone,
    Value,
    interval,
    numbers,
    percent,
)

_KS_AT_5_PERCENT: Final = 1.358
"""Kolmogorov's constant: times the root of (n + m) / (n m) it is the least distance that the test finds at 5 %."""


def gap_report(gap: RealityGap, sim: Path, real: Path, seed: int) -> Report:
    """Return the report of how two runs, such as a simulation and reality, agree; ``seed`` is the bootstrap's."""
    if not gap.trials.pairs:
        badge = "Nothing to compare"
        tone = Tone.CAUTION
    elif gap.agrees:
        badge = "No significant difference"
        tone = Tone.CAUTION
    else:
        badge = "Differs"
        tone = Tone.BAD
    text = difference_text(gap.trials, "the first run", "the second")
    if gap.other_durations:
        text += f" Other durations: {', '.join(gap.other_durations)}."
    return Report(
        "Two runs",
        f"{sim} and {real}",
        Headline(badge, tone, text),
        [_share("the first run", gap.trials.first), _share("the second", gap.trials.second)],
        [_outcomes(gap), _verb_section(gap), _error_section(gap.error_shifts), _plan_section(gap)],
        document=document(
            {"compare": gap}, command="compare", seed=seed, config={"sim": sim, "real": real}
        ),
        exit_code=int(not gap.agrees),
    )


def _share(run: str, agreeing: Proportion) -> KeyFigure:
    bounds = interval(agreeing.low, agreeing.high)
    return KeyFigure(percent(agreeing.rate), f"agree in {run}", bounds)


def _outcomes(gap: RealityGap) -> Section:
    text = f"Of {gap.trials.words('in the first run', 'in the second')}"
    arms = arms_table(gap.trials, gap.actions, gap.control)
    settings = changes_table(gap.changed, "first", "second")
    lead = "The same trials in both, paired by their names."
    return Section("outcomes", "Outcomes", lead, [text, arms, settings], True)


def _verb_section(gap: RealityGap) -> Section:
    rows: list[tuple[Value, ...]] = []
    for verb, shares in gap.by_verb.items():
        rows.append(
            (
                verb,
                shares["agreement"].trials,
                _share_text(shares["agreement"]),
                _count_text(shares["sim"]),
                _count_text(shares["real"]),
                _estimate_text(shares["duration_ratio"]),
                f"{shares['duration_p']:.2g}",
            )
        )
    table = DataTable(
        numbers(
            "action", "pairs", "alike (95 %)", "good: first", "second", "duration ratio (95 %)", "p"
        ),
        rows,
        "By action",
        "Alike: as predicted in both or in neither; duration ratio: the second run by the first, median; p: of the "
        "sign test of whether trials take as long in both.",
    )
    return Section("verbs", "By action", "Of what the rules allow.", [table], True)


def _error_section(shifts: Mapping[str, Mapping[str, Any]]) -> Section:
    rows = []
    for name, shift in shifts.items():
        first = shift["sim"]
        second = shift["real"]
        rows.append(
            (
                MEASUREMENTS[name].shown_label,
                f"{first.median:.3f}",
                f"{first.p95:.3f}",
                f"{second.median:.3f}",
                f"{second.p95:.3f}",
                f"{shift['distance']:.3f}",
                f"{_detectable_distance(first.n, second.n):.3f}",
                f"{shift['p_value']:.2g}",
            )
        )
    table = DataTable(
        numbers(
            "error",
            "first median",
            "95th",
            "second median",
            "95th",
            "KS distance",
            "detectable",
            "p",
        ),
        rows,
        "Errors",
        "Of actions as predicted. Detectable: the least distance of Kolmogorov and Smirnov that their test finds at 5 "
        "% among so many.",
    )
    return Section("errors", "Errors", "How errors are distributed in both.", [table], True)


def _detectable_distance(n: int, m: int) -> float:
    return min(1.0, _KS_AT_5_PERCENT * math.sqrt((n + m) / (n * m)))


def _plan_section(gap: RealityGap) -> Section:
    blocks: list[Block] = []
    if gap.plans:
        blocks.append(_plan_table(gap))
    if gap.ranks is None:
        blocks.append("Ranks: at least three plans are needed.")
    else:
        blocks.append(
            f"Ranks of {gap.ranks.policies} plans: Pearson {_estimate_text(gap.ranks.pearson)}, Spearman "
            f"{_estimate_text(gap.ranks.spearman)}, mean maximum rank violation {gap.ranks.mmrv:.3f}"
        )
    return Section(
        "plans", "Plans and policies", "Success, and whether both rank alike.", blocks, True
    )


def _plan_table(gap: RealityGap) -> DataTable:
    rows = []
    for plan in gap.plans:
        runs = plan["runs"]
        first = Proportion.of(round(plan["sim"] * runs), runs)
        second = Proportion.of(round(plan["real"] * runs), runs)
        rows.append((plan["plan"], runs, _share_text(first), _share_text(second)))
    columns = numbers("world: plan or policy", "runs", "success: first", "second")
    return DataTable(columns, rows, "Plans and policies")


def _count_text(p: Proportion) -> str:
    return f"{p.successes}/{p.trials}"


def _share_text(p: Proportion) -> str:
    if p.rate is None:
        return "-"
    return f"{p.rate:.2f} ({p.low:.2f} to {p.high:.2f})"


def _estimate_text(estimate: Estimate) -> str:
    if estimate.value is None:
        return "not defined"
    return f"{estimate.value:.2f} ({bounds_text(estimate)})"
