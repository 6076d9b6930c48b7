"""What an audit found: rows, the trials that show the disagreements, and figures for its reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

from craftsim.validation.attempts.attempt import Attempt
from craftsim.validation.audit.rows import Row
from craftsim.validation.audit.suspects import Finding, find
from craftsim.validation.audit.trial import recipe_of
from craftsim.validation.campaign import Item, TrialRecord
from craftsim.validation.html.page import Cell, Column, Table
from craftsim.validation.replays.bundle import TEXT, write_bundle
from craftsim.validation.statistics.audit_rows import AuditRow, Judgement, audit_rows, verdict_counts

DISAGREEMENTS: Final = (Judgement.UNSOUND, Judgement.CONSERVATIVE)


@dataclass(frozen=True)
class Results:
    """An audit's rows, and its verdicts on the suspects."""

    rows: tuple[AuditRow, ...]
    """Of actions as the rules have them: one after the other, or by the schedule that keeps them apart."""
    at_once: tuple[AuditRow, ...]
    """Of ticks whose actions were all begun together, which the rules do not claim to work."""
    suspects: tuple[Finding, ...]

    @classmethod
    def of(cls, records: Sequence[TrialRecord]) -> Results:
        """Return what the records of an audit say."""
        rows = audit_rows(records)
        together = tuple(row for row in rows if row.context.endswith("order=at-once"))
        apart = tuple(row for row in rows if row not in together)
        return cls(apart, together, tuple(find(apart, together)))

    def of_kind(self, judgement: Judgement) -> list[AuditRow]:
        """Return the rows with a verdict."""
        return [row for row in self.rows if row.verdict == judgement]

    def figures(self, plan: Sequence[Row]) -> dict[str, Any]:
        """Return what ``report.json`` holds; ``plan`` gives the contexts of each row."""
        members = {row.name: len(row.members) for row in plan}
        return {
            "verdicts": verdict_counts(self.rows),
            "contexts": sum(members.values()),
            "rows": [
                {**asdict(row), "contexts": members[f"{row.action}/{row.context}"]} for row in self.rows
            ],
            "at_once": self.at_once,
            "suspects": self.suspects,
        }


def bundle_disagreements(
    out: Path, items: Sequence[Item], records: Sequence[TrialRecord], workers: int
) -> None:
    """Write the replay bundle of the first disagreement of each unsound or conservative row, and note it there."""
    shown = {
        f"{row.action}/{row.context}" for row in Results.of(records).rows if row.verdict in DISAGREEMENTS
    }
    first: dict[str, int] = {}
    for index, record in enumerate(records):
        if record["group"] in shown and record["attempts"] and not record["agrees"]:
            first.setdefault(record["group"], index)
    chosen = list(first.values())
    pairs = [(items[index], records[index]) for index in chosen]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for index, folder in zip(chosen, pool.map(partial(_bundle, out), pairs), strict=True):
            records[index]["bundle"] = folder


def _bundle(out: Path, pair: tuple[Item, Mapping[str, Any]]) -> str:
    """Write one bundle, unless it is there, and return its folder relative to ``out``."""
    item, record = pair
    folder = f"bundles/{record['index']:05d}"
    if not (out / folder / TEXT).exists():
        attempts = tuple(Attempt(**{**a, "differences": tuple(a["differences"])}) for a in record["attempts"])
        write_bundle(out / folder, item.key, recipe_of(item.job), attempts)
    return folder


def suspects_table(found: Sequence[Finding]) -> Table:
    """Return the table of the suspects for the page."""
    columns = (
        Column("", number=True),
        Column("suspect"),
        Column("rows", number=True),
        Column("trials", number=True),
        Column("verdict"),
        Column("evidence"),
    )
    rows = tuple(
        (
            str(f.number),
            Cell(f.question, wide=True),
            str(f.rows),
            f"{f.trials:,}",
            Cell(f.verdict, wide=True),
            Cell(f.evidence, path=True, wide=True),
        )
        for f in found
    )
    return Table(
        columns, rows, caption="Suspects", note="Evidence is the clearest row of the gravest verdict."
    )
