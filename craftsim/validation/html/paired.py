"""The section of a page that compares a run with an earlier one of the same trials."""

from __future__ import annotations

from craftsim.validation.html.page import Cell, Column, Section, Table
from craftsim.validation.html.tables import NONE, SHARE_COLUMNS, share_cells
from craftsim.validation.statistics.paired import Comparison, Paired


def paired_section(comparison: Comparison) -> Section:
    """Return how many trials agree in which of the runs, and the settings that differ."""
    return Section(
        "paired",
        "Two settings",
        f"The same trials under other settings, in {comparison.against}.",
        (_pairs_table(comparison.trials), _runs_table(comparison.trials), _changed_table(comparison)),
    )


def _pairs_table(trials: Paired) -> Table:
    rows = {
        "both runs": trials.both,
        "the earlier run alone": trials.only_first,
        "this run alone": trials.only_second,
        "neither": trials.neither,
    }
    return Table(
        (Column("agrees with the rules in"), Column("trials", number=True)),
        tuple((name, f"{n:,}") for name, n in rows.items()),
        caption=f"{trials.pairs:,} pairs",
        note=f"McNemar's exact test, two-sided: p = {trials.p_value:.3g}. {trials.unpaired:,} trials that only one of "
        "the runs carried out are left out.",
    )


def _runs_table(trials: Paired) -> Table:
    runs = {"earlier run": trials.first, "this run": trials.second}
    return Table(
        (Column("run"), *SHARE_COLUMNS),
        tuple((name, *share_cells(share)) for name, share in runs.items()),
        caption="Trials that agree",
    )


def _changed_table(comparison: Comparison) -> Table:
    return Table(
        (Column("setting"), Column("earlier run"), Column("this run")),
        tuple(
            (Cell(name, path=True), *(Cell(_told(value), path=True) for value in values))
            for name, values in comparison.changed.items()
        ),
        caption="What differs",
        folded=True,
    )


def _told(value: object) -> str:
    return NONE if value is None else str(value)
