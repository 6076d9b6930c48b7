"""Compare our rules with recordings of CraftEnv, record by record."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from craftsim.choices import RuleSet
from craftsim.cli.options import OptionalDir
from craftsim.options import number
from craftsim.storage.folders import owning
from craftsim.storage.limits import SHOWN

if TYPE_CHECKING:
    from craftsim.discrete.conformance import Checker, Mismatch
    from craftsim.reports.report import Report


@owning
def conformance(
    files: Annotated[tuple[Path, ...], Parameter(metavar="FILE")] = (),
    *,
    rules: RuleSet = "published",
    show: Annotated[int, number(SHOWN)] = 3,
    out: OptionalDir = None,
) -> int:
    """Replay recorded ticks or plans and compare all that they tell: masks, effects, rewards, plans.

    With the physical rule set, records are left out in which something happened that only the published rules follow,
    or in which a correction changes what is legal or what follows. Exit status 0 when nothing differs, 1 when anything
    does, 2 for wrong input.

    Args:
        files: recordings, gzip-compressed JSON lines; one or more.
        rules: the rule set to compare.
        show: how many of the first mismatches to draw.
        out: folder for report.json.
    """
    from craftsim.discrete.conformance import Checker, read_records
    from craftsim.discrete.rules import Rules
    from craftsim.errors import CraftsimError, InputError
    from craftsim.reports.json_file import document

    if not files:
        raise InputError("no recordings given; name one or more .jsonl.gz files")
    begun = time.perf_counter()
    checker = Checker(Rules(rules), keep=show)
    for file in files:
        for line, record in read_records(file):
            try:
                checker.check(line, record)
            except CraftsimError as error:
                raise InputError(f"{file}:{line}: not a record: {error}") from error
    wall = {"seconds": time.perf_counter() - begun}
    config = {"files": [file.name for file in files], "rules": rules}
    written = document(checker.figures(), command="conformance", config=config, wall=wall)
    return _report(checker, rules, written).publish(out)


def _report(checker: Checker, rules: RuleSet, written: dict[str, Any]) -> Report:
    """Return the report; ``written`` is what ``report.json`` holds."""
    from craftsim.discrete.drawing import LEGEND
    from craftsim.discrete.kinds import Action
    from craftsim.reports.report import Column, DataTable, Headline, Report, Section, Tone

    tables = (checker.actions, checker.applied, checker.action_mismatches)
    by_action: list[tuple[str, *tuple[int, ...]]] = [
        (action.name, *(table[action.name] for table in tables)) for action in Action
    ]
    by_check = [(what, n, checker.mismatches[what]) for what, n in checker.checks.items()]
    heads = ("taken", "legal", "mismatches")
    left_out = {
        "records with a quirk were left out": checker.skipped,
        "records that a correction changes were left out": checker.corrected,
    }
    mismatches = checker.mismatches.total()
    sentence = f"{checker.records} records, {checker.checks.total()} checks, {mismatches} mismatches"
    drawn = [*map(_drawn, checker.first), *([str(LEGEND)] if checker.first else [])]
    return Report(
        "Conformance with CraftEnv",
        f"rule set: {rules}",
        Headline("Differs", Tone.BAD, sentence) if mismatches else Headline("Agrees", Tone.GOOD, sentence),
        sections=[
            Section(
                "compared",
                "What was compared",
                "Recordings of CraftEnv, record by record.",
                [
                    DataTable(
                        (Column("action"), *(Column(name, "number") for name in heads)),
                        [row for row in by_action if any(row[1:])],
                        "By action",
                    ),
                    DataTable(
                        (Column("compared"), Column("checks", "number"), Column("mismatches", "number")),
                        by_check,
                        "By check",
                    ),
                ],
                terminal=True,
            ),
            *([Section("first", "First mismatches", "", drawn, terminal=True)] if drawn else []),
        ],
        notes=[f"{n} {what}" for what, n in left_out.items() if n],
        document=written,
        exit_code=1 if mismatches else 0,
    )


def _drawn(mismatch: Mismatch) -> str:
    from craftsim.discrete.drawing import world_text

    lines = [f"{mismatch.where}: {mismatch.what}"]
    lines += [f"expected {mismatch.expected}", f"got      {mismatch.got}"]
    for title, grid in zip(("before", "expected after", "got after"), mismatch.grids, strict=False):
        lines += [f"{title}:", world_text(grid).plain]
    return "\n".join(lines)
