"""What ``craftsim validate`` prints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Final

from rich.table import Table

from craftsim.checking.attempt import Result
from craftsim.commands.terminal import cell
from craftsim.commands.text import say
from craftsim.validation.campaign import TrialRecord
from craftsim.validation.play.coverage import ALL, Coverage
from craftsim.validation.play.neighbourhood import NEIGHBOURS
from craftsim.validation.validation import Validation

_SHOWN: Final = 20
"""Disagreements that are printed; the report has all."""


def runs_table(records: Sequence[TrialRecord]) -> Table:
    """Return a table with a row for each world and each plan or policy."""
    caption = "goal: runs that reach it, in physics and by the rules; makespan: median, s simulated"
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), caption=caption)
    table.add_column("world", overflow="fold")
    table.add_column("plan or policy", overflow="fold")
    for heading in ("runs", "agree", "actions", "good", "goal", "rules", "makespan", "errors"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, by in dict.fromkeys((record["context"], record["group"]) for record in records):
        own = [record for record in records if (record["context"], record["group"]) == (name, by)]
        done = [record for record in own if record["error"] is None]
        results = [attempt["result"] for record in done for attempt in record["attempts"]]
        goal, by_rules = (
            f"{sum(record['extra'][key] for record in done)}/{len(done)}"
            if done and all(key in record["extra"] for record in done)
            else "-"
            for key in ("physics_success", "grid_success")
        )
        table.add_row(
            cell(name),
            cell(by),
            str(len(own)),
            str(sum(record["agrees"] for record in done)),
            str(len(results)),
            str(results.count(Result.AS_PREDICTED)),
            goal,
            by_rules,
            f"{median(r['extra']['makespan_s'] for r in done):.1f}" if done else "-",
            str(len(own) - len(done)),
        )
    return table


def coverage_table(coverage: Coverage) -> Table:
    """Return a table of what random play did, and how often beside what."""
    totals = ", ".join(f"{n:,} {name}" for name, n in coverage.totals.items())
    caption = f"{coverage.actions:,} actions in {coverage.worlds:,} worlds: {totals}"
    if coverage.do_not_stand:
        caption += f"; {coverage.do_not_stand:,} more worlds cannot be, and nothing was tried there"
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), title="coverage", caption=caption)
    table.add_column("action, level, load", no_wrap=True)
    for heading in (ALL, *NEIGHBOURS):
        table.add_column(heading, justify="right", overflow="fold")
    for name, counts in coverage.rows.items():
        table.add_row(name, *(str(n) if n else "-" for n in counts.values()))
    return table


def print_disagreements(out: Path, records: Sequence[TrialRecord]) -> None:
    """Print the first disagreement of each run, and how to see it again."""
    wrong = [record for record in records if not record["agrees"]]
    for record in wrong[:_SHOWN]:
        text = record["error"] or ""
        if bad := next((a for a in record["attempts"] if a["result"] != Result.AS_PREDICTED), None):
            text = f"tick {bad['tick']} car {bad['car']} {bad['action']}: "
            text += f"{bad['result']}: {bad['reason']}" if bad["legal"] else f"not tried: {bad['reason']}"
        say(f"{record['key']}: {text}")
        if record["bundle"]:
            say(f"  craftsim replay {out / record['bundle']}")
    if len(wrong) > _SHOWN:
        say(f"and {len(wrong) - _SHOWN} more in the report")


def conclusion(result: Validation) -> str:
    """Print whether anything drifts; return how many runs agree, and how many asked for what the rules forbid."""
    asked = sum(any(not a["legal"] for a in record["attempts"]) for record in result.records)
    if all(thirds := result.figures.drift.values()):
        found = ", ".join(f"{d.median:.2f} (at most {d.max:.2f}, {d.n} things)" for d in thirds if d)
        say(f"Set down in the first, middle and last third of the runs: median {found} mm off.")
    text = f"{result.n_agree} of {len(result.records)} runs did in physics what the rules predict"
    return f"{text}; {asked} asked for actions that the rules forbid." if asked else f"{text}."
