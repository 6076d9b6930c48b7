"""Tables and cases that the pages of both commands share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from craftsim.checking.attempt import Result
from craftsim.validation.html.page import Case, Cases, Cell, Column, Share, Table, Tone
from craftsim.validation.html.plots import duration_name
from craftsim.validation.statistics.durations import Duration
from craftsim.validation.statistics.matrix import LegalityMatrix, MatrixRow
from craftsim.validation.statistics.precision import Distribution, Precision
from craftsim.validation.statistics.proportions import Proportion

NONE: Final = "none"
"""Stands where there is no figure."""

MAX_CASES: Final = 24
"""Disagreements that a page shows with their films; the others are listed."""

_MAX_ERRORS: Final = 20

TONES: Final = {
    Result.AS_PREDICTED: Tone.GOOD,
    Result.FAILED: Tone.CAUTION,
    Result.SIDE_EFFECT: Tone.CAUTION,
    Result.UNSAFE: Tone.BAD,
}

_PRECISION: Final = {
    "car_error_mm": "car's place, mm",
    "heading_error_mrad": "car's heading, mrad",
    "height_error_mm": "car's height, mm",
    "placed_error_mm": "place of what is set down, mm",
    "bystander_displacement_mm": "movement of anything else, mm",
    "duration_error_s": "duration against the median of its kind, s",
    "peak_force_n": "peak contact force, N (all attempts)",
}


def count(number: int, thing: str) -> str:
    """Return a number with its thing, in the plural where it needs one."""
    return f"{number:,} {thing}{'' if number == 1 else 's'}"


def percent(share: float | None) -> str:
    """Return a share as percents, 100 % only if it is all."""
    if share is None:
        return NONE
    digits = 0 if share in (0.0, 1.0) else 1
    text = f"{100 * share:.{digits}f}"
    return f"{'> 99.9' if text == '100.0' else '< 0.1' if text == '0.0' else text} %"


def interval(low: float, high: float) -> str:
    """Return an interval of shares as percents."""
    return f"{100 * low:.1f} to {100 * high:.1f} %"


def share_cells(p: Proportion) -> tuple[Cell, Cell]:
    """Return a rate with its bar, and its interval."""
    if p.rate is None:
        return Cell(NONE, Tone.MUTED), Cell(NONE, Tone.MUTED)
    bar = Share(p.rate, p.wilson_low, p.wilson_high)
    return Cell(percent(p.rate), share=bar), Cell(interval(p.wilson_low, p.wilson_high))


def counts(as_predicted: int, failed: int, side_effect: int, unsafe: int) -> tuple[Cell, ...]:
    """Return the cells of the four results; what is zero is set back."""
    found = zip(TONES.values(), (as_predicted, failed, side_effect, unsafe), strict=True)
    return tuple(Cell(f"{n:,}", tone if n else Tone.MUTED) for tone, n in found)


RESULT_COLUMNS: Final = (
    Column("trials", number=True),
    Column("as predicted", number=True, tip="did what the rules predict, and nothing else"),
    Column("failed", number=True, tip="the intended effect is missing, or out of its limits"),
    Column("side effect", number=True, tip="did what was predicted, and something else moved or changed"),
    Column("unsafe", number=True, tip="something tipped, fell, or hit harder than it may"),
)
SHARE_COLUMNS: Final = (Column("share", number=True), Column("95 % interval", number=True))


def matrix_table(matrix: LegalityMatrix) -> Table:
    """Return the matrix of legality and result."""
    rows = {"allowed by the rules": matrix.legal, "forbidden, tried on purpose": matrix.forbidden}
    return _matrix("Legality and result", "attempts", {k: row for k, row in rows.items() if row.trials})


def verb_table(by_verb: Mapping[str, MatrixRow]) -> Table:
    """Return the results of each verb."""
    return _matrix("By action", "action", by_verb)


def _matrix(caption: str, name: str, rows: Mapping[str, MatrixRow]) -> Table:
    return Table(
        (Column(name), *RESULT_COLUMNS, *SHARE_COLUMNS),
        tuple(
            (
                key,
                f"{row.trials:,}",
                *counts(row.as_predicted, row.failed, row.side_effect, row.unsafe),
                *share_cells(row.success),
            )
            for key, row in rows.items()
        ),
        caption=caption,
    )


def precision_table(precision: Precision) -> Table:
    """Return the errors of the attempts that did as predicted."""
    rows = []
    for field, name in _PRECISION.items():
        found: Distribution | None = getattr(precision, field)
        if found is not None:
            rows.append((name, f"{found.n:,}", *map(_figure, (found.median, found.p95, found.max))))
    return Table(
        (
            Column("error"),
            Column("n", number=True),
            Column("median", number=True),
            Column("95th percentile", number=True),
            Column("largest", number=True),
        ),
        tuple(rows),
        caption="Errors",
        note="Of the legal attempts that did as predicted, unless it says all.",
    )


def _figure(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3f}"


def duration_rows(table: Sequence[Duration]) -> Table:
    """Return the durations of each kind of action."""
    return Table(
        (
            Column("kind of action"),
            *(Column(title, number=True) for title in ("n", "mean s", "5 %", "median", "95 %", "longest")),
        ),
        tuple(
            (
                duration_name(row),
                f"{row.n:,}",
                *(f"{v:.2f}" for v in (row.mean_s, row.p05_s, row.median_s, row.p95_s, row.max_s)),
            )
            for row in table
        ),
        caption="Durations in seconds",
        note="The same table is in durations.csv.",
        folded=True,
    )


def error_table(errors: Mapping[str, int]) -> Table:
    """Return what kept trials from an end."""
    shown = list(errors.items())[:_MAX_ERRORS]
    return Table(
        (Column("error"), Column("trials", number=True)),
        tuple((text, f"{number:,}") for text, number in shown),
        caption="Trials that did not come to an end",
        note="They count in no figure."
        + (
            f" {len(errors) - len(shown)} more kinds of error are in trials.jsonl."
            if len(errors) > len(shown)
            else ""
        ),
    )


def case_blocks(cases: Sequence[Case]) -> Iterator[Cases | Table]:
    """Yield the first cases with their films, and a list of the others."""
    yield Cases(tuple(cases[:MAX_CASES]))
    if others := cases[MAX_CASES:]:
        yield Table(
            (Column("disagreement"), Column("result"), Column("physical reason"), Column("bundle")),
            tuple(
                (
                    Cell(case.title, path=True, wide=True),
                    Cell(case.result, case.tone, badge=True),
                    Cell(case.reason, wide=True),
                    Cell(case.bundle or NONE, path=True),
                )
                for case in others
            ),
            caption=f"{count(len(others), 'more disagreement')}",
            folded=True,
            tall=True,
        )
