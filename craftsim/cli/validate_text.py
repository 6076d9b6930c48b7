"""What ``craftsim validate`` prints."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Final

from rich.table import Table

from craftsim.checking.attempt import Verdict
from craftsim.cli.terminal import cell
from craftsim.cli.text import say
from craftsim.experiments.experiment import TrialRecord
from craftsim.validation.play.play import ALL, NEIGHBOURS, Coverage
from craftsim.validation.validation import Validation

_SHOWN: Final = 20
"""Disagreements that are printed; the report has all."""
_GOALS: Final = ("physics_success", "grid_success")


def runs_table(records: Iterable[TrialRecord]) -> Table:
    """Return a table with a row for each world and each plan or policy."""
    caption = "goal: runs that reach it, in physics and by the rules; makespan: median, s simulated"
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), caption=caption)
    table.add_column("world", overflow="fold")
    table.add_column("plan or policy", overflow="fold")
    for heading in ("runs", "agree", "actions", "good", "goal", "rules", "makespan", "errors"):
        table.add_column(heading, justify="right", no_wrap=True)
    rows: dict[tuple[str | None, str], _Row] = {}
    for record in records:
        rows.setdefault((record["context"], record["group"]), _Row()).add(record)
    for (name, by), row in rows.items():
        table.add_row(cell(name), cell(by), *row.cells())
    return table


@dataclass
class _Row:
    """What is counted of the runs of one plan or policy in one world."""

    counts: Counter[str] = field(default_factory=Counter)
    makespans: array[float] = field(default_factory=lambda: array("d"))

    def add(self, record: TrialRecord) -> None:
        self.counts["runs"] += 1
        if record["error"] is not None:
            return
        self.makespans.append(record["extra"]["makespan_s"])
        self.counts["agree"] += record["agrees"]
        self.counts["actions"] += len(record["attempts"])
        self.counts["good"] += sum(a["result"] == Verdict.AS_PREDICTED for a in record["attempts"])
        for key in _GOALS:
            self.counts[f"with {key}"] += key in record["extra"]
            self.counts[key] += record["extra"].get(key, False)

    def cells(self) -> list[str]:
        done, n = len(self.makespans), self.counts
        known = done and all(n[f"with {key}"] == done for key in _GOALS)
        goals = [f"{n[key]}/{done}" if known else "-" for key in _GOALS]
        makespan = f"{median(self.makespans):.1f}" if done else "-"
        counted = [str(n[key]) for key in ("runs", "agree", "actions", "good")]
        return [*counted, *goals, makespan, str(n["runs"] - done)]


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


def print_disagreements(out: Path, records: Iterable[TrialRecord]) -> None:
    """Print the first disagreement of each run, and how to see it again."""
    wrong = (record for record in records if not record["agrees"])
    for record in islice(wrong, _SHOWN):
        text = record["error"] or ""
        if bad := next((a for a in record["attempts"] if a["result"] != Verdict.AS_PREDICTED), None):
            text = f"tick {bad['tick']} car {bad['car']} {bad['action']}: "
            text += f"{bad['result']}: {bad['reason']}" if bad["legal"] else f"not tried: {bad['reason']}"
        say(f"{record['key']}: {text}")
        if record["bundle"]:
            say(f"  craftsim replay {out / record['bundle']}")
    if more := sum(1 for _ in wrong):
        say(f"and {more} more in the report")


def conclusion(result: Validation) -> str:
    """Print whether anything drifts; return how many runs agree, and how many asked for what the rules forbid."""
    asked = sum(any(not a["legal"] for a in record["attempts"]) for record in result.records)
    if all(thirds := result.figures.drift.values()):
        found = ", ".join(f"{d.median:.2f} (at most {d.max:.2f}, {d.n} things)" for d in thirds if d)
        say(f"Set down in the first, middle and last third of the runs: median {found} mm off.")
    text = f"{result.n_agree} of {len(result.records)} runs did in physics what the rules predict"
    return f"{text}; {asked} asked for actions that the rules forbid." if asked else f"{text}."
