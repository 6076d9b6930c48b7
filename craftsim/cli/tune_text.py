"""What ``craftsim tune`` prints."""

from __future__ import annotations

from rich.table import Table

from craftsim.tuning.gains.objectives import OBJECTIVES
from craftsim.tuning.gains.page import change
from craftsim.tuning.gains.tune import Tuned


def gains_table(tuned: Tuned) -> Table:
    """Return a table of the gains, before and after, with what turning each of them does to the goal."""
    table = _table("gain", "before", "after", "down", "up")
    table.caption = "down, up: change of the goal's product where a gain of the result is turned"
    for knob in tuned.knobs:
        value, effect = knob.of(tuned.gains), tuned.sensitivity[knob.name]
        turned = (f"{100 * (factor - 1):+.1f} %" for factor in (effect.down, effect.up))
        table.add_row(knob.name, f"{knob.start:.4g}", f"{value:.4g}", *turned)
    return table


def verdict_table(tuned: Tuned) -> Table:
    """Return a table of the objectives on the seeds held out."""
    verdict = tuned.verdict
    scores = (verdict.before, verdict.after, verdict.shipped)
    table = _table("objective, on seeds held out", "before", "after", "shipped")
    table.caption = (
        f"product: {change(verdict.against_start)} from the start, "
        f"{change(verdict.against_shipped)} from the shipped gains"
    )
    for name, what in OBJECTIVES.items():
        table.add_row(f"{name}: {what}", *(f"{score.values[name]:.3g}" for score in scores))
    table.add_row(
        f"failed, of {verdict.before.trials} actions each", *(str(score.failed) for score in scores)
    )
    return table


def _table(first: str, *numbers: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column(first, overflow="fold")
    for heading in numbers:
        table.add_column(heading, justify="right", no_wrap=True)
    return table
