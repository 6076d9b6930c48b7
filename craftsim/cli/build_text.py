"""What ``craftsim build`` prints."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from typing import Final

from rich.table import Table
from rich.text import Text

from craftsim.checking.attempt import Verdict
from craftsim.cli.terminal import cell
from craftsim.experiments.experiment import TrialRecord
from craftsim.validation.builds import Builds

_SHOWN: Final = 40
"""Buildings that are printed; the report has all."""


def builds_table(records: Iterable[TrialRecord]) -> Table:
    """Return a table with a row for each building."""
    caption = (
        "good: actions as predicted; planned: makespan of the first plan; both times in simulated seconds"
    )
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), caption=caption)
    table.add_column("building", overflow="fold")
    for heading in ("actions", "good", "replans", "planned", "real"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("ended", overflow="fold")
    for record in islice(records, _SHOWN):
        table.add_row(cell(record["key"]), *_cells(record))
    return table


def _cells(record: TrialRecord) -> list[Text | str]:
    if record["error"] is not None:
        return ["-"] * 5 + [cell(record["error"])]
    extra, attempts = record["extra"], record["attempts"]
    good = sum(attempt["result"] == Verdict.AS_PREDICTED for attempt in attempts)
    told = [extra["ended"], extra["why"], extra["disturbed"]]
    numbers = [len(attempts), good, extra["replans"]]
    times = [f"{extra[key]:.1f}" for key in ("planned_s", "makespan_s")]
    return [*map(str, numbers), *times, cell("; ".join(filter(None, told)))]


def conclusion(result: Builds) -> str:
    """Return how many are built, and how many plans that took."""
    n, figures = len(result.records), result.builds
    text = f"{figures.endings.get('built', 0)} of {n} buildings stand"
    if figures.replans:
        text += f"; {figures.replans} further plans were made"
    return f"{text}."
