"""The report of an identification: each parameter with its interval, and how well the identified car predicts a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from craftsim.reports.report import (
    Cell,
    Column,
    DataTable,
    Headline,
    KeyFigure,
    Report,
    Section,
    Tone,
    count,
)
from craftsim.tuning.identification import Identification, Identified

_LOGS = {"fitted_log": "the log that was fitted to", "held_out_log": "the held-out log"}


def identified_report(
    found: Identification, log: str, document: Mapping[str, Any], files: Mapping[str, str | Path]
) -> Report:
    """Return the report of an identification.

    Args:
        found: its result.
        log: name of the log.
        document: what ``report.json`` holds.
        files: what was written, by what it is.
    """
    figures = document["figures"]
    identified = sum(one.told for one in found.estimates)
    sentence = f"{identified} of {count(len(found.estimates), 'parameter')} identified from {log}."
    badge, tone = ("Identified", Tone.GOOD) if identified else ("Nothing identified", Tone.CAUTION)
    return Report(
        "Identification of a car",
        log,
        Headline(badge, tone, sentence),
        [
            KeyFigure(f"{identified}", "parameters identified", f"of {len(found.estimates)}"),
            KeyFigure(
                f"{figures['values']:,}", "measured values", f"{figures['outliers']:,} outliers left out"
            ),
        ],
        [
            Section(
                "parameters",
                "Parameters",
                "What was assumed before, what the log says, and how sure it is.",
                [_estimates(found.estimates)],
                terminal=True,
            ),
            Section(
                "prediction",
                "Prediction",
                "Errors of predictions over 1.5 s, with the car as assumed and as identified.",
                [_prediction(figures[key], words) for key, words in _LOGS.items() if key in figures],
                terminal=True,
            ),
            Section(
                "unidentified",
                "Not identified",
                "What the log cannot say, and why.",
                [
                    *(f"Unidentifiable: {text}" for text in figures["untold"]),
                    *(f"Not in parameters.yaml: {text}" for text in figures["left_out"]),
                ],
                terminal=True,
            ),
        ],
        files=files,
        document=document,
        exit_code=0 if identified else 1,
    )


def _estimates(estimates: Sequence[Identified]) -> DataTable:
    names = ("assumed", "identified", "95 % interval")
    rows = [(one.unknown.words, f"{one.start:.4g}", *_said(one)) for one in estimates]
    return DataTable((Column("what"), *(Column(name, "number") for name in names)), rows, "Parameters")


def _said(one: Identified) -> tuple[Cell, str]:
    if one.half_width is None:
        return Cell("held", Tone.MUTED), ""
    width = "at the border of the search" if one.at_bound else f"+- {one.half_width:.2g}"
    return Cell(f"{one.value:.4g}", Tone.CAUTION if one.at_bound else Tone.PLAIN), width


def _prediction(errors: Mapping[str, Mapping[str, Mapping[str, Any]]], words: str) -> DataTable:
    before, after = errors["as_assumed"], errors["as_identified"]
    names = ("as assumed", "as identified", "95 % below")
    rows = [
        (
            f"{channel}, {one['unit']}",
            *(f"{value:.3g}" for value in (before[channel]["rms"], one["rms"], one["p95"])),
        )
        for channel, one in after.items()
    ]
    columns = (Column("channel"), *(Column(name, "number") for name in names))
    return DataTable(columns, rows, f"RMS errors of 1.5 s predictions, {words}")
