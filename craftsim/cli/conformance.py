"""Compare our rules with recordings of CraftEnv, record by record."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from craftsim.choices import RuleSet
from craftsim.cli.options import OptionalDir
from craftsim.cli.text import say
from craftsim.options import number
from craftsim.storage.folders import owning
from craftsim.storage.limits import SHOWN

if TYPE_CHECKING:
    from rich.console import Console

    from craftsim.discrete.conformance import Checker, Mismatch


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
    from craftsim.report import write_report

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
    _print(checker)
    if out is not None:
        wall = {"seconds": time.perf_counter() - begun}
        config = {"files": [file.name for file in files], "rules": rules}
        write_report(out, checker.figures(), command="conformance", config=config, wall=wall)
    return 1 if checker.mismatches.total() else 0


def _print(checker: Checker) -> None:
    """Print what was compared, by action and by check, and draw the first mismatches."""
    from rich.table import Table

    from craftsim.cli.terminal import Terminal
    from craftsim.discrete.drawing import LEGEND
    from craftsim.discrete.kinds import Action

    console = Terminal(highlight=False)
    by_action = Table("action", "taken", "legal", "mismatches")
    for action in Action:
        numbers = [
            table[action.name] for table in (checker.actions, checker.applied, checker.action_mismatches)
        ]
        if any(numbers):
            by_action.add_row(action.name, *map(str, numbers))
    by_check = Table("compared", "checks", "mismatches")
    for what, checks in checker.checks.items():
        by_check.add_row(what, str(checks), str(checker.mismatches[what]))
    console.print(by_action, by_check)
    for mismatch in checker.first:
        _draw(console, mismatch)
    if checker.first:
        console.print(LEGEND)
    if checker.skipped:
        console.print(f"{checker.skipped} records with a quirk were left out")
    if checker.corrected:
        console.print(f"{checker.corrected} records that a correction changes were left out")
    mismatches = checker.mismatches.total()
    say(f"{checker.records} records, {checker.checks.total()} checks, {mismatches} mismatches")


def _draw(console: Console, mismatch: Mismatch) -> None:
    from craftsim.discrete.drawing import world_text

    console.rule(f"{mismatch.where}: {mismatch.what}", align="left")
    console.print(f"expected {mismatch.expected}\ngot      {mismatch.got}", markup=False)
    for title, grid in zip(("before", "expected after", "got after"), mismatch.grids, strict=False):
        console.print(f"{title}:", style="bold")
        console.print(world_text(grid))
