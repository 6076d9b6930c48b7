"""The page of an audit: which rules does physics keep?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from craftsim.validation.html.page import (
    Block,
    Case,
    Cell,
    Column,
    Headline,
    KeyFigure,
    Page,
    Section,
    Share,
    Table,
    Tone,
)
from craftsim.validation.html.plots import durations_plot, errors_plot, judgement_plot
from craftsim.validation.html.provenance import Provenance, provenance_section
from craftsim.validation.html.tables import (
    NONE,
    RESULT_COLUMNS,
    case_blocks,
    count,
    counts,
    duration_rows,
    error_table,
    interval,
    matrix_table,
    precision_table,
    verb_table,
)
from craftsim.validation.statistics.audit_rows import SOUND_SHARE, AuditRow, Judgement, verdict_counts
from craftsim.validation.statistics.figures import Figures
from craftsim.validation.statistics.records import Record, attempts_of, carried_out

_TONES: Final = {
    Judgement.UNSOUND: Tone.BAD,
    Judgement.CONSERVATIVE: Tone.CAUTION,
    Judgement.SOUND: Tone.GOOD,
    Judgement.RIGHTLY_FORBIDDEN: Tone.PLAIN,
    Judgement.NO_PREDICTION: Tone.MUTED,
    Judgement.NOT_TRIED: Tone.CAUTION,
}

_LEADS: Final = {
    Judgement.UNSOUND: "The rules allow these, and physics refuses.",
    Judgement.CONSERVATIVE: "The rules forbid these, and they would have worked.",
    Judgement.SOUND: "The rules allow these, and they work.",
    Judgement.RIGHTLY_FORBIDDEN: "The rules forbid these, and they do not work.",
    Judgement.NO_PREDICTION: "The rules forbid these, and nothing is intended that could be tried.",
    Judgement.NOT_TRIED: "Errors kept all trials of these from an end.",
}

_COLUMNS: Final = (
    Column("action"),
    Column("context"),
    Column("physical reason"),
    *RESULT_COLUMNS,
    Column("95 % interval", tip="of the share that did as predicted"),
)


def audit_page(
    rows: Sequence[AuditRow],
    records: Sequence[Record],
    figures: Figures,
    provenance: Provenance,
    rules: str,
    suspects: Table | None = None,
) -> Page:
    """Return the page of an audit.

    Args:
        rows: the audit's rows.
        records: all records of the audit.
        figures: what :func:`~craftsim.validation.statistics.figures.campaign_figures` says of the records.
        provenance: what decides the figures.
        rules: name of the rule set.
        suspects: verdicts on rules that were under suspicion beforehand.
    """
    return Page(
        "Audit of the rules",
        f"rule set: {rules}",
        _headline(rows, rules),
        tuple(_key_figures(rows, figures)),
        tuple(_sections(rows, records, figures, provenance, suspects)),
    )


def _headline(rows: Sequence[AuditRow], rules: str) -> Headline:
    found = verdict_counts(rows)
    unsound, sound, conservative, untried = (
        found[j] for j in (Judgement.UNSOUND, Judgement.SOUND, Judgement.CONSERVATIVE, Judgement.NOT_TRIED)
    )
    allowed = unsound + sound
    rest = f" They forbid {count(conservative, 'context')} needlessly." if conservative else ""
    rest += f" Errors kept {count(untried, 'context')} from being judged." if untried else ""
    if unsound:
        sentence = (
            f"The {rules} rules allow {count(allowed, 'context')}, and physics refuses {unsound:,} of them."
        )
        return Headline("Unsound", Tone.BAD, sentence + rest)
    if not allowed or untried:
        return Headline(
            "Not decided", Tone.CAUTION, f"Of what the {rules} rules allow, {allowed:,} works." + rest
        )
    sentence = f"All that the {rules} rules allow works in physics: {count(allowed, 'context')}."
    return Headline("Sound", Tone.GOOD, sentence + rest)


def _key_figures(rows: Sequence[AuditRow], figures: Figures) -> Iterator[KeyFigure]:
    found = verdict_counts(rows)
    for judgement in (
        Judgement.UNSOUND,
        Judgement.SOUND,
        Judgement.CONSERVATIVE,
        Judgement.RIGHTLY_FORBIDDEN,
    ):
        yield KeyFigure(f"{found[judgement]:,}", judgement.value, "contexts")
    tried = [row.trials for row in rows if row.trials]
    yield KeyFigure(f"{figures.trials:,}", "trials", f"at least {min(tried, default=0)} a context")


def _sections(
    rows: Sequence[AuditRow],
    records: Sequence[Record],
    figures: Figures,
    provenance: Provenance,
    suspects: Table | None,
) -> Iterator[Section]:
    if suspects is not None:
        yield Section(
            "suspects", "Suspects", "Rules that were under suspicion before the audit.", (suspects,)
        )
    yield Section(
        "matrix",
        "Rules against physics",
        "What the rules say against what physics does.",
        (matrix_table(figures.matrix), judgement_plot(rows)),
    )
    disagreeing = [r for r in rows if r.verdict in (Judgement.UNSOUND, Judgement.CONSERVATIVE)]
    disagreeing.sort(key=lambda row: row.verdict != Judgement.UNSOUND)
    cases = [_case(row) for row in disagreeing if row.bundles]
    blocks: list[Block] = [
        _table(rows, judgement) for judgement in (Judgement.UNSOUND, Judgement.CONSERVATIVE)
    ]
    if cases:
        blocks += case_blocks(cases)
    if figures.errors:
        blocks.append(error_table(figures.errors))
    yield Section(
        "disagreements",
        "Disagreements",
        f"Works means that at least {SOUND_SHARE:.0%} of the trials did what was predicted, and nothing else. "
        "Replay bundles from the folder of this page.",
        tuple(blocks),
    )
    yield Section(
        "contexts",
        "All other contexts",
        "The rules and physics agree on these, or there is nothing to compare.",
        tuple(
            _table(rows, judgement, folded=True)
            for judgement in (
                Judgement.SOUND,
                Judgement.RIGHTLY_FORBIDDEN,
                Judgement.NO_PREDICTION,
                Judgement.NOT_TRIED,
            )
            if any(row.verdict == judgement for row in rows)
        ),
    )
    legal = [attempt for attempt in attempts_of(carried_out(records)) if attempt["legal"]]
    yield Section(
        "errors",
        "Errors and durations",
        "Of what the rules allow and did as predicted.",
        (
            verb_table(figures.by_verb),
            precision_table(figures.precision),
            errors_plot(legal),
            durations_plot(figures.durations),
            duration_rows(figures.durations),
        ),
    )
    yield provenance_section(provenance)


def _table(rows: Sequence[AuditRow], judgement: Judgement, folded: bool = False) -> Table:
    chosen = [row for row in rows if row.verdict == judgement]
    return Table(
        _COLUMNS,
        tuple(_row(row) for row in chosen),
        caption=f"{judgement.value.capitalize()}: {count(len(chosen), 'context')}",
        note=_LEADS[judgement],
        folded=folded,
        tall=True,
    )


def _row(row: AuditRow) -> tuple[str | Cell, ...]:
    share = Share(row.as_predicted / row.trials, row.wilson_low, row.wilson_high) if row.trials else None
    return (
        Cell(row.action, path=True),
        Cell(row.context, path=True, wide=True),
        Cell(row.reason, wide=True),
        f"{row.trials:,}",
        *counts(row.as_predicted, row.failed, row.side_effect, row.unsafe),
        Cell(interval(row.wilson_low, row.wilson_high), share=share) if share else Cell(NONE, Tone.MUTED),
    )


def _case(row: AuditRow) -> Case:
    return Case(
        title=f"{row.action}/{row.context}",
        result=row.verdict,
        tone=_TONES[Judgement(row.verdict)],
        reason=row.reason,
        bundle=row.bundles[0],
    )
