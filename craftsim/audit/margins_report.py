"""The report of robustness margins: a data sheet of the machines and their skills."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.audit.imperfections import Imperfection
from craftsim.audit.margins import PASSING_SHARE, Margin, Margins, confidence, values_of
from craftsim.experiments.report_parts import error_tables, provenance_section
from craftsim.experiments.statistics import error_counts
from craftsim.reports.plots import BAD, GOOD, INK
from craftsim.reports.report import (
    Cases,
    Column,
    DataTable,
    Drawing,
    Headline,
    KeyFigure,
    Report,
    Section,
    TableCell,
    Tone,
    Value,
    count,
    percent,
)
from craftsim.validation.report import case_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIDE_IN: Final = 5.4


def margins_report(result: Margins, command: str) -> Report:
    """Return the report of a search; ``command`` is the command line that repeats it."""
    by_action: dict[str, list[Margin]] = {action: [] for action in result.weakest}
    for margin in sorted(result.margins, key=lambda margin: margin.limit.rank):
        by_action[margin.action].append(margin)
    compared = any(margin.before for margin in result.margins)
    trials = result.config["trials"]
    n_scenarios = len({margin.scenario for margin in result.margins})
    n_trials = sum(margin.limit.tried for margin in result.margins)
    pass_text = f"{percent(PASSING_SHARE)} of worlds pass, {percent(confidence(trials))} confidence"
    return Report(
        "Margins",
        f"beyond --randomize {result.config['randomize']}, {result.config['setup'].machines.drive} drive",
        _headline(result),
        [
            KeyFigure(f"{n_scenarios}", "scenarios", f"{len(by_action)} actions"),
            KeyFigure(
                f"{len(result.with_effect)}", "imperfections that matter", "to one action or more"
            ),
            KeyFigure(f"{trials}", "trials pass each margin", pass_text),
            KeyFigure(f"{n_trials:,}", "trials in all"),
        ],
        [
            _sheet(result),
            _first_failures(result),
            *_maps(result),
            Section(
                "actions",
                "By action",
                "All scenarios and imperfections, the weakest first, and their first failures. A margin's interval: "
                "all trials pass it, and above the value under 'over 5 % fail at' more than 5 % of all worlds fail, "
                "with 95 % confidence. Replay the bundles from the folder of this page.",
                [_limits(rows, action, compared) for action, rows in by_action.items()],
            ),
            provenance_section(command, result.seed, result.config),
        ],
        list(_notes(result)),
        exit_code=int(not result.passed),
    )


def _headline(result: Margins) -> Headline:
    weak = sorted({margin.scenario for margin in result.margins if margin.limit.margin is None})
    if weak:
        sentence = f"{count(len(weak), 'scenario')} failed at the nominal level: {', '.join(weak)}."
        return Headline("Fails at the nominal level", Tone.BAD, sentence)
    lost = sum(record["error"] is not None for record in result.records)
    sentence = "The largest value of each imperfection, alone, at which each action still works."
    if lost:
        sentence += f" {count(lost, 'search', 'searches')} did not finish."
        return Headline("Data sheet", Tone.CAUTION, sentence)
    return Headline("Data sheet", Tone.GOOD, sentence)


def _sheet(result: Margins) -> Section:
    trials = result.config["trials"]
    note = (
        f"At least {100 * PASSING_SHARE:.0f} % of all worlds pass a margin, with "
        f"{100 * confidence(trials):.1f} % confidence. "
        ">=: no trial failed at the largest value tried. A dash: no effect. fails: at the nominal level."
    )
    rows = []
    for axis in result.with_effect:
        row: list[Value] = [f"{axis.words}, {axis.unit}"]
        for by_axis in result.weakest.values():
            row.append(_sheet_cell(by_axis.get(axis.name)))
        rows.append(row)
    columns = (Column("up to"), *(Column(action, "number") for action in result.weakest))
    lead = "The largest value of each imperfection, alone, that all trials pass in the weakest scenario of each action."
    table = DataTable(columns, rows, "Margins", note)
    blocks = [table, *error_tables(error_counts(result.records))]
    return Section("sheet", "Data sheet", lead, blocks, terminal=True)


def _sheet_cell(margin: Margin | None) -> Value:
    if margin is None:
        return None
    tone = {"-": Tone.MUTED, "fails": Tone.BAD}.get(margin.number, Tone.PLAIN)
    return TableCell(
        margin.number, tone, tip=": ".join(filter(None, (margin.scenario, margin.limit.reason)))
    )


def _first_failures(result: Margins) -> Section:
    """Return the first failure for each imperfection, over all actions."""
    cases = []
    for axis in result.with_effect:
        margins = [
            by_axis[axis.name] for by_axis in result.weakest.values() if axis.name in by_axis
        ]
        first = min(margins, key=lambda margin: margin.limit.rank)
        if not first.limit.reason:
            continue
        level = "the nominal level"
        tone = Tone.BAD
        if first.limit.fails_at is not None:
            level = axis.text(first.limit.fails_at)
            tone = Tone.CAUTION
        title = f"{axis.words}: {first.scenario}"
        cases.append(case_of(title, f"at {level}", tone, first.limit.reason, first.bundle))
    lead = "The scenario that fails first for each imperfection, and at which value."
    return Section("first", "First failures", lead, [Cases(cases, most=40)], terminal=bool(cases))


def _maps(result: Margins) -> list[Section]:
    if not result.maps:
        return []
    pair = " and ".join(axis.words for axis in result.pair)
    drawings = []
    for scenario, stood in result.maps.items():
        drawings.append(
            Drawing(
                partial(_map, result.pair, np.array(stood) / result.map_trials),
                _SIDE_IN,
                f"{scenario}: {result.map_trials} trials of each pair.",
                f"{scenario}: share that passes, by {pair}",
                _SIDE_IN + 1.0,
            )
        )
    lead = "Percentage of trials that pass under two imperfections together; green where all pass."
    return [Section("maps", "Two together", lead, drawings)]


def _map(pair: Sequence[Imperfection], share: NDArray[np.float64], figure: Figure) -> None:
    """Draw the share of trials that pass each pair of levels, of shape (vertical, horizontal levels)."""
    axes = figure.subplots()
    for row, column in np.ndindex(*share.shape):
        value = float(share[row, column])
        # Flat colours of the page: a colour between two of them would not follow light and dark.
        colour = GOOD
        alpha = 0.75
        if value != 1:
            colour = BAD
            alpha = 0.15 + 0.6 * (1 - value)
        axes.fill_between(
            (column - 0.5, column + 0.5), row - 0.5, row + 0.5, color=colour, alpha=alpha, lw=0
        )
        axes.text(
            column, row, f"{100 * value:.0f}", ha="center", va="center", color=INK, fontsize=7
        )
    ticks = [[f"{axis.scale * value:.3g}" for value in values_of(axis)] for axis in pair]
    axes.set_xticks(range(len(ticks[0])), ticks[0])
    axes.set_yticks(range(len(ticks[1])), ticks[1])
    axes.grid(visible=False)
    axes.set_xlabel(f"{pair[0].words}, {pair[0].unit}")
    axes.set_ylabel(f"{pair[1].words}, {pair[1].unit}")


def _limits(margins: Iterable[Margin], title: str, compared: bool) -> DataTable:
    columns = [
        Column("scenario", "wide"),
        Column("imperfection"),
        Column("margin", "number"),
        Column("fails at", "number"),
        Column("over 5 % fail at", "number"),
    ]
    if compared:
        columns.append(Column("margin before", "number"))
    columns += [Column("what fails", "wide"), Column("bundle", "path")]
    rows = []
    for margin in margins:
        limit = margin.limit
        tone = Tone.PLAIN
        if limit.margin is None:
            tone = Tone.BAD
        row: list[Value] = [
            margin.scenario,
            margin.axis.words,
            TableCell(margin.text, tone),
            _text(margin.axis, limit.fails_at, "none"),
            _text(margin.axis, limit.upper, "not known"),
        ]
        if compared:
            before = None
            if margin.before is not None:
                before = margin.before.margin
            row.append(_text(margin.axis, before, "none"))
        rows.append([*row, limit.reason, margin.bundle or None])
    return DataTable(columns, rows, title, folded=True, tall=True)


def _text(axis: Imperfection, value: float | None, otherwise: str) -> str:
    if value is None:
        return otherwise
    return axis.text(value)


def _notes(result: Margins) -> Iterator[str]:
    axes = dict.fromkeys(margin.axis for margin in result.margins)
    quiet = [axis.words for axis in axes if axis not in result.with_effect]
    if quiet:
        yield f"no effect on any action: {', '.join(quiet)}"
    fixed = list(
        dict.fromkeys(margin.axis.words for margin in result.margins if margin.limit.identical)
    )
    if fixed:
        yield (
            f"nothing is drawn at random for {', '.join(fixed)}: identical trials, run once; such a margin is exact "
            "for its scenario, and says nothing of a share of worlds"
        )
    for margin in result.margins:
        if margin.before is not None and margin.before.margin != margin.limit.margin:
            was = "fails at nominal"
            if margin.before.margin is not None:
                was = margin.axis.text(margin.before.margin)
            upper = ""
            if margin.limit.upper is not None:
                upper = f" (over 5 % fail at {margin.axis.text(margin.limit.upper)})"
            yield f"{margin.scenario}, {margin.axis.words}: {margin.text}{upper}, was {was}"
