"""The parts of an audit's page where the rules and physics disagree: rows by action, most striking first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from craftsim.validation.html.page import Block, Case, Cases, Cell, Column, Group, Section, Share, Table, Tone
from craftsim.validation.html.tables import MAX_CASES, NONE, RESULT_COLUMNS, count, counts, interval
from craftsim.validation.statistics.audit_rows import AuditRow, Judgement
from craftsim.validation.statistics.records import grouped

MOST_STRIKING: Final = 6
"""Unsound rows shown before all others, of as many actions as there are."""

TONES: Final = {
    Judgement.UNSOUND: Tone.BAD,
    Judgement.CONSERVATIVE: Tone.CAUTION,
    Judgement.SOUND: Tone.GOOD,
    Judgement.RIGHTLY_FORBIDDEN: Tone.PLAIN,
    Judgement.NO_PREDICTION: Tone.MUTED,
    Judgement.NOT_TRIED: Tone.CAUTION,
}

_COLUMNS: Final = (
    Column("context"),
    Column("physical reason"),
    *RESULT_COLUMNS,
    Column("95 % interval", tip="of the share that did as predicted"),
    Column("bundle", tip="folder of a replay bundle: craftsim replay FOLDER"),
)


def unsound_section(rows: Sequence[AuditRow], by_rule: Table | None) -> Section:
    """Return the section of what the rules allow and physics refuses.

    Args:
        rows: all of an audit.
        by_rule: which rules these come of.
    """
    chosen = _striking_first(rows, Judgement.UNSOUND)
    first = {row.action: row for row in reversed(chosen)}.values()
    shown = [row for row in chosen if row in first][:MOST_STRIKING]
    return Section(
        "unsound",
        f"Unsound: {count(len(chosen), 'row')}",
        "The rules allow these, and physics refuses. First the most striking row of an action each, then all of them, "
        "by action. Replay bundles from the folder of this page.",
        (
            *([by_rule] if by_rule else []),
            Cases(tuple(_case(row) for row in shown)),
            *_by_action(rows, chosen, "allowed", legal=True),
        ),
    )


def conservative_section(rows: Sequence[AuditRow]) -> Section:
    """Return the section of what the rules forbid and would have worked; ``rows`` are all of an audit."""
    chosen = _striking_first(rows, Judgement.CONSERVATIVE)
    return Section(
        "conservative",
        f"Conservative: {count(len(chosen), 'row')}",
        "The rules forbid these, and they would have worked. By action.",
        tuple(_by_action(rows, chosen, "forbidden", legal=False)),
    )


def agreement_table(rows: Sequence[AuditRow], judgement: Judgement, note: str) -> Table:
    """Return the folded table of all rows with a verdict on which there is nothing to see."""
    chosen = [row for row in rows if row.verdict == judgement]
    return Table(
        (Column("action"), *_COLUMNS[:-1]),
        tuple((Cell(row.action, path=True), *_cells(row)[:-1]) for row in chosen),
        caption=f"{judgement.value.capitalize()}: {count(len(chosen), 'row')}",
        note=note,
        folded=True,
        tall=True,
    )


def _striking_first(rows: Sequence[AuditRow], judgement: Judgement) -> list[AuditRow]:
    """Return the rows with a verdict: the unsafe ones first, then those that did least as predicted."""
    return sorted(
        (row for row in rows if row.verdict == judgement),
        key=lambda row: (-row.unsafe / row.trials, row.as_predicted / row.trials, -row.failed / row.trials),
    )


def _by_action(
    rows: Sequence[AuditRow], chosen: Sequence[AuditRow], word: str, *, legal: bool
) -> Iterator[Block]:
    """Yield a group for each action, with a table of all its rows and the films that there are."""
    for action, group in grouped(chosen, lambda row: row.action).items():
        of = sum(row.action == action and row.legal == legal and row.trials > 0 for row in rows)
        table = Table(_COLUMNS, tuple(map(_cells, group)), tall=True)
        films = Cases(tuple(_case(row) for row in group[:MAX_CASES]), filmed_only=True)
        yield Group(f"{action}: {len(group):,} of {of:,} that are {word}", (table, films))


def _cells(row: AuditRow) -> tuple[str | Cell, ...]:
    share = Share(row.as_predicted / row.trials, row.wilson_low, row.wilson_high) if row.trials else None
    return (
        Cell(row.context, path=True, wide=True),
        Cell(row.reason, wide=True),
        Cell(f"{row.trials:,}, provisional", Tone.CAUTION) if row.provisional else f"{row.trials:,}",
        *counts(row.as_predicted, row.failed, row.side_effect, row.unsafe),
        Cell(interval(row.wilson_low, row.wilson_high), share=share) if share else Cell(NONE, Tone.MUTED),
        Cell(row.bundles[0] if row.bundles else NONE, path=True),
    )


def _case(row: AuditRow) -> Case:
    did = f"{row.as_predicted:,} of {row.trials:,} as predicted"
    return Case(
        title=f"{row.action}/{row.context}",
        result=row.verdict,
        tone=TONES[Judgement(row.verdict)],
        reason=f"{did}; {row.reason}" if row.reason else did,
        bundle=row.bundles[0] if row.bundles else "",
    )
