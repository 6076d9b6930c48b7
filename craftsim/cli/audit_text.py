"""What ``craftsim audit`` prints."""

from __future__ import annotations

from typing import Final

from rich.console import Console
from rich.table import Table

from craftsim.cli.text import say
from craftsim.validation.audit.audit import Audit
from craftsim.validation.audit.results import Results
from craftsim.validation.audit.verdicts import Judgement, provisional_note

_SHOWN: Final = 40
"""How many rows of a verdict are printed; the others are in the reports."""


def print_results(console: Console, results: Results) -> None:
    """Print the rows on which the rules and physics disagree, and the suspects."""
    for judgement in (Judgement.UNSOUND, Judgement.CONSERVATIVE):
        rows = results.of_kind(judgement)
        console.print(f"[bold]{judgement.value}: {len(rows)} rows")
        for row in rows[:_SHOWN]:
            share = f"{row.as_predicted} of {row.trials} as predicted"
            share += f" ({row.wilson_low:.2f} to {row.wilson_high:.2f})"
            say(f"  {row.action}/{row.context}: {share}" + (f"; {row.reason}" if row.reason else ""))
        if len(rows) > _SHOWN:
            say(f"  and {len(rows) - _SHOWN} more in the reports")
    table = Table("", "suspect", "verdict", title="suspects", title_justify="left", box=None, pad_edge=False)
    for found in results.suspects:
        table.add_row(str(found.number), found.question, found.verdict)
    console.print(table)


def conclude(audit: Audit) -> int:
    """Print the verdict on a rule set, and return the exit status."""
    n = {judgement: len(audit.results.of_kind(judgement)) for judgement in Judgement}
    errors = sum(record["error"] is not None for record in audit.records)
    allowed = n[Judgement.UNSOUND] + n[Judgement.SOUND]
    if flags := audit.rows_by_flag:
        text = ", ".join(f"{flag} {count}" for flag, count in flags.items())
        say(f"unsound rows by the correction that concerns them: {text}")
    say(
        f"{audit.config['rules']}: {n[Judgement.UNSOUND]} of {allowed} rows that the rules allow are unsound; "
        f"{n[Judgement.CONSERVATIVE]} that they forbid would have worked, "
        f"{n[Judgement.RIGHTLY_FORBIDDEN]} are rightly forbidden."
        + (f" {errors} trials came to no end." if errors else "")
    )
    if note := provisional_note(audit.results.rows):
        say(note)
    if car := audit.figures.precision.car_error_mm:
        found = audit.figures.precision
        heading, placed, reach, drift = (
            *(found.heading_error_mrad, found.placed_error_mm),
            *(found.reach_mm, found.drift_mm),
        )
        say(
            f"Of what the rules allow and did as predicted, 99th percentiles: cars {car.p99:.2f} mm"
            + (f" and {heading.p99:.2f} mrad" if heading else "")
            + (f", set down {placed.p99:.2f} mm" if placed else "")
            + (f", reaching out of a cell {reach.p99:.2f} mm" if reach else "")
            + (f", others {drift.p99:.2f} mm from their places" if drift else "")
        )
    return 1 if n[Judgement.UNSOUND] or errors else 0
