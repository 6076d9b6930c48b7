"""What ``craftsim compare`` prints."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from craftsim.cli.terminal import cell
from craftsim.cli.text import say
from craftsim.experiments.compare import RealityGap
from craftsim.experiments.intervals import Estimate, Proportion

_ERRORS = {
    "car_error_m": "car's place, mm",
    "heading_error_rad": "car's heading, mrad",
    "height_error_m": "car's height, mm",
    "placed_error_m": "place set down, mm",
    "bystander_displacement_m": "others moved, mm",
    "thing_heading_rad": "heading of what is handled, mrad",
    "reach_m": "its reach out of its cell, mm",
    "bystander_turn_rad": "others turned, mrad",
    "drift_m": "others from where they were left, mm",
}


def print_gap(console: Console, gap: RealityGap) -> None:
    """Print how a simulation and reality agree."""
    trials = gap.trials
    say(
        f"Of {trials.pairs} paired trials {trials.both} agree with the rules in both, {trials.only_first} only in the "
        f"simulation, {trials.only_second} only in reality, {trials.neither} in neither; McNemar's exact test: "
        f"p = {trials.p_value:.3g}."
    )
    table = _table("action", "pairs", "alike (95 %)", "good: sim", "real", "durations (95 %)")
    for verb, one in gap.by_verb.items():
        shares = [_share(one.agreement), *(f"{p.successes}/{p.trials}" for p in (one.sim, one.real))]
        table.add_row(verb, str(one.agreement.trials), *shares, _estimate(one.duration_ratio))
    console.print(table)
    say("(alike: as predicted in both or in neither; durations: of reality by the simulation, median)")
    table = _table("error", "sim median", "95th", "real median", "95th", "KS distance", "p")
    for name, shift in gap.error_shifts.items():
        numbers = (shift.sim.median, shift.sim.p95, shift.real.median, shift.real.p95, shift.distance)
        table.add_row(_ERRORS[name], *(f"{number:.3f}" for number in numbers), f"{shift.p_value:.2g}")
    console.print(table)
    if gap.plans:
        table = _table("world: plan or policy", "runs", "success: sim", "real")
        for plan in gap.plans:
            table.add_row(cell(plan.plan), str(plan.runs), f"{plan.sim:.2f}", f"{plan.real:.2f}")
        console.print(table)
    if gap.ranks is None:
        say("Ranks: at least three plans are needed.")
    else:
        say(
            f"Ranks of {gap.ranks.policies} plans: Pearson {_estimate(gap.ranks.pearson)}, Spearman "
            f"{_estimate(gap.ranks.spearman)}, mean maximum rank violation {gap.ranks.mmrv:.3f}"
        )


def _table(first: str, *others: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column(first, overflow="fold")
    for name in others:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _share(p: Proportion) -> str:
    return "-" if p.rate is None else f"{p.rate:.2f} ({p.wilson_low:.2f} to {p.wilson_high:.2f})"


def _estimate(one: Estimate) -> str:
    if one.value is None:
        return "not defined"
    low, high = ("?" if bound is None else f"{bound:.2f}" for bound in (one.low, one.high))
    return f"{one.value:.2f} ({low} to {high})"
