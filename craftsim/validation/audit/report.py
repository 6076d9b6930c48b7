"""The report of an audit: which rules does physics keep?"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

from craftsim.experiments.bundle import TRAJECTORY
from craftsim.experiments.intervals import CONFIDENCE
from craftsim.experiments.sections import (
    RESULTS,
    comparison_notes,
    duration_blocks,
    error_drawing,
    error_tables,
    legality_table,
    paired_sections,
    precision_table,
    provenance_section,
    result_cells,
    results_table,
    run_notes,
)
from craftsim.experiments.statistics import Figures, Precision, capped_steps, legal_attempts, retried
from craftsim.reports.plots import BAD, CAUTION, GOOD, MUTED, rows_height_in, stacked_rows
from craftsim.reports.report import (
    Block,
    Case,
    Cases,
    Cell,
    Column,
    DataTable,
    Drawing,
    Group,
    Headline,
    KeyFigure,
    Report,
    Section,
    Tone,
    Value,
    count,
    interval,
)
from craftsim.validation.audit.audit import Audit
from craftsim.validation.audit.suspects import SuspectFinding
from craftsim.validation.audit.verdicts import (
    SOUND_SHARE,
    AuditRow,
    Judgement,
    provisional_note,
    verdict_counts,
)
from craftsim.validation.sections import RecordedRun, case_of, recorded_section, smallest_section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_T = TypeVar("_T")

MOST_STRIKING: Final = 6
"""Unsound rows shown before all others, of as many actions as there are."""
_TONES: Final = {
    Judgement.UNSOUND: Tone.BAD,
    Judgement.CONSERVATIVE: Tone.CAUTION,
    Judgement.SOUND: Tone.GOOD,
    Judgement.RIGHTLY_FORBIDDEN: Tone.PLAIN,
    Judgement.NO_PREDICTION: Tone.MUTED,
    Judgement.NOT_TRIED: Tone.CAUTION,
}
_COLOURS: Final = {
    Judgement.SOUND: GOOD,
    Judgement.UNSOUND: BAD,
    Judgement.CONSERVATIVE: CAUTION,
    Judgement.RIGHTLY_FORBIDDEN: MUTED,
}
_OTHERS: Final = {
    Judgement.SOUND: "The rules allow these, and they work.",
    Judgement.RIGHTLY_FORBIDDEN: "The rules forbid these, and they do not work.",
    Judgement.NO_PREDICTION: "The rules forbid these, and nothing is intended that could be tried.",
    Judgement.NOT_TRIED: "Errors kept all trials of these from an end.",
}
"""What is listed last, and what it means."""
_INTERVAL: Final = Column(f"{100 * CONFIDENCE:.0f} % interval", tip="of the share that did as predicted")


def audit_report(audit: Audit, out: Path, command: str) -> Report:
    """Return the report of an audit in the folder ``out``; ``command`` is how it can be run again."""
    rows, figures = audit.results.rows, audit.figures
    found = verdict_counts(rows)
    unsound = _striking_first(rows, Judgement.UNSOUND)
    first = {row.action: row for row in reversed(unsound)}
    one_each = [row for row in unsound if first[row.action] is row]
    conservative = _striking_first(rows, Judgement.CONSERVATIVE)
    strangest_first = [*one_each, *(row for row in unsound if row not in one_each), *conservative]
    sections = [
        _disagreements("Unsound", unsound),
        _disagreements("Conservative", conservative),
        _suspects(audit.results.suspects),
        _matrix(rows, figures),
        *paired_sections(audit.comparison),
        *smallest_section(audit.smallest),
        *_unsound(audit, unsound, one_each),
        *_conservative(rows, conservative),
        *recorded_section(out, _recorded(strangest_first)),
        Section(
            "others",
            "All other rows",
            "The rules and physics agree on these, or there is nothing to compare.",
            [_others(rows, judgement) for judgement in _OTHERS if found[judgement]],
        ),
        Section(
            "errors",
            "Errors and durations",
            "Of what the rules allow and did as predicted.",
            [
                results_table("By action", "action", figures.by_verb),
                precision_table(figures.precision),
                error_drawing(legal_attempts(audit.judged)),
                *duration_blocks(figures.durations),
            ],
        ),
        provenance_section(command, audit.seed, audit.config),
    ]
    flags = ", ".join(f"{flag} {number}" for flag, number in audit.rows_by_flag.items())
    notes = [
        *([f"unsound rows by the correction that concerns them: {flags}"] if flags else []),
        *run_notes(capped_steps(audit.records), retried(audit.records)),
        *comparison_notes(audit.comparison),
        *_precision(figures.precision),
    ]
    failed = found[Judgement.UNSOUND] or any(record["error"] is not None for record in audit.records)
    return Report(
        "Audit of the rules",
        f"rule set: {audit.config['rules']}",
        _headline(audit),
        [*_key_figures(rows, figures)],
        sections,
        notes,
        exit_code=int(bool(failed)),
    )


def _headline(audit: Audit) -> Headline:
    rows, rules = audit.results.rows, audit.config["rules"]
    found = verdict_counts(rows)
    unsound, sound, conservative, forbidden = (
        found[j]
        for j in (Judgement.UNSOUND, Judgement.SOUND, Judgement.CONSERVATIVE, Judgement.RIGHTLY_FORBIDDEN)
    )
    untried, allowed = found[Judgement.NOT_TRIED], unsound + sound
    errors = sum(record["error"] is not None for record in audit.records)
    sentence = (
        f"{rules}: {unsound:,} of {count(allowed, 'row')} that the rules allow are unsound; {conservative:,} that they "
        f"forbid would have worked, {forbidden:,} are rightly forbidden."
    )
    sentence += f" {count(errors, 'trial')} did not come to an end." if errors else ""
    sentence += f" {note}" if (note := provisional_note(rows)) else ""
    if unsound:
        return Headline("Unsound", Tone.BAD, sentence)
    if not allowed or untried:
        return Headline("Not decided", Tone.CAUTION, sentence)
    return Headline("Sound", Tone.GOOD, sentence)


def _key_figures(rows: Sequence[AuditRow], figures: Figures) -> Iterator[KeyFigure]:
    found = verdict_counts(rows)
    for judgement in (
        *(Judgement.UNSOUND, Judgement.SOUND),
        *(Judgement.CONSERVATIVE, Judgement.RIGHTLY_FORBIDDEN),
    ):
        yield KeyFigure(f"{found[judgement]:,}", judgement.value, "rows")
    tried = [row.trials for row in rows if row.trials]
    yield KeyFigure(f"{figures.trials:,}", "trials", f"at least {min(tried, default=0)} a row")


def _precision(found: Precision) -> list[str]:
    """Return the 99th percentiles of the errors that figures hang on."""
    named = {
        "cars {:.2f} mm": found.car_error_mm,
        "{:.2f} mrad": found.heading_error_mrad,
        "set down {:.2f} mm": found.placed_error_mm,
        "reaching out of a cell {:.2f} mm": found.reach_mm,
        "others {:.2f} mm from their places": found.drift_mm,
    }
    parts = [words.format(one.p99) for words, one in named.items() if one is not None]
    text = f"Of what the rules allow and did as predicted, 99th percentiles: {', '.join(parts)}"
    return [text] if found.car_error_mm else []


def _suspects(suspects: Iterable[SuspectFinding]) -> Section:
    columns = (
        *(Column("suspect", "wide"), Column("verdict"), Column("evidence", "path", terminal=False)),
        *(Column("rows", "number"), Column("trials", "number")),
    )
    rows = [
        (
            f"{one.number}. {one.question}",
            Cell(one.verdict, _tone(one)),
            *(one.evidence, one.rows, one.trials),
        )
        for one in suspects
    ]
    note = "Evidence is the clearest row of the gravest verdict."
    lead = "Rules that were under suspicion before the audit."
    table = DataTable(columns, rows, "Suspects", note)
    return Section("suspects", "Suspects", lead, [table], terminal=True)


def _tone(finding: SuspectFinding) -> Tone:
    """Return the tone of the gravest verdict; verdicts are listed in that order."""
    gravest = next((j for j in Judgement if finding.verdict.split(", ")[0].endswith(f" {j}")), None)
    return _TONES[gravest] if gravest else Tone.MUTED


def _matrix(rows: Sequence[AuditRow], figures: Figures) -> Section:
    actions = grouped(rows, lambda row: row.action)
    parts = {
        judgement.value: (
            colour,
            [sum(row.verdict == judgement for row in group) for group in actions.values()],
        )
        for judgement, colour in _COLOURS.items()
    }

    def draw(axes: Axes) -> None:
        stacked_rows(axes, list(actions), parts)
        axes.set_xlabel("rows")

    height_in = rows_height_in(len(actions)) + 0.25
    drawing = Drawing.of_axes(draw, height_in, "Verdicts on the rows of each action.", "verdicts by action")
    lead = (
        "A row is one action in situations that physics cannot tell apart. The action works there when at least "
        f"{100 * SOUND_SHARE:.0f} % of the trials did what was predicted, and nothing else."
    )
    blocks: list[Block] = [legality_table(figures.matrix), drawing, *error_tables(figures.errors)]
    return Section("matrix", "Rules against physics", lead, blocks)


def _unsound(audit: Audit, unsound: Sequence[AuditRow], one_each: Sequence[AuditRow]) -> list[Section]:
    if not unsound:
        return []
    flags = audit.rows_by_flag | {"no flag": sum(not flags for flags in audit.corrections.values())}
    corrections = DataTable(
        (Column("correction", "path"), Column("unsound rows", "number")),
        [(flag, number) for flag, number in flags.items() if number],
        "The rules that these come of",
        "A correction is a difference of the physical rules from CraftEnv's; docs/rules.md says what each asks for.",
    )
    title = f"Unsound: {count(len(unsound), 'row')}"
    lead = (
        "The rules allow these, and physics refuses. First the most striking row of an action each, then all of them, "
        "by action. Replay bundles from the folder of this page."
    )
    striking = Cases([_case(row) for row in one_each][:MOST_STRIKING])
    blocks: list[Block] = [corrections, striking]
    groups = _by_action(audit.results.rows, unsound, "allowed")
    return [Section("unsound", title, lead, [*blocks, *groups])]


def _conservative(rows: Sequence[AuditRow], conservative: Sequence[AuditRow]) -> list[Section]:
    if not conservative:
        return []
    title = f"Conservative: {count(len(conservative), 'row')}"
    lead = "The rules forbid these, and they would have worked. By action."
    return [Section("conservative", title, lead, [*_by_action(rows, conservative, "forbidden")])]


def _disagreements(verdict: str, rows: Sequence[AuditRow]) -> Section:
    """Return what the terminal says of rows with a verdict, the most striking first; the page has groups of them."""
    title = f"{verdict}: {count(len(rows), 'row')}"
    columns = (
        *(Column("row", "path"), Column("as predicted", "number"), _INTERVAL),
        Column("physical reason", "wide"),
    )
    cells = [
        (
            f"{row.action}/{row.context}",
            f"{row.as_predicted:,} of {row.trials:,}",
            *(interval(row.wilson_low, row.wilson_high), row.reason),
        )
        for row in rows
    ]
    return Section(verdict.lower(), title, "", [DataTable(columns, cells, title)], terminal=True, page=False)


def _bundle(row: AuditRow) -> Value:
    bundle = row.bundles[0] if row.bundles else ""
    return Cell(bundle, link=f"{bundle}/{TRAJECTORY}") if bundle else None


def _row_table(rows: Iterable[AuditRow], title: str = "", note: str = "", actions: bool = False) -> DataTable:
    """Return the table of all that is known of rows."""
    cells = []
    for row in rows:
        bar = (row.as_predicted / row.trials, row.wilson_low, row.wilson_high) if row.trials else None
        text = interval(row.wilson_low, row.wilson_high)
        trials, *results = result_cells(row)
        provisional = Cell(f"{trials}, provisional", Tone.CAUTION) if row.provisional else trials
        first: list[Value] = [row.action] if actions else []
        last: list[Value] = [] if actions else [_bundle(row)]
        known = Cell(text, share=bar) if bar else None
        cells.append((*first, row.context, row.reason, provisional, *results, known, *last))
    columns = (
        *([Column("action", "path")] if actions else []),
        *(Column("context", "path"), Column("physical reason", "wide"), *RESULTS, _INTERVAL),
        *([] if actions else [Column("bundle", "path", "folder of a replay bundle: craftsim replay FOLDER")]),
    )
    return DataTable(columns, cells, title, note, folded=actions, tall=True)


def _others(rows: Iterable[AuditRow], judgement: Judgement) -> DataTable:
    chosen = [row for row in rows if row.verdict == judgement]
    title = f"{judgement.value.capitalize()}: {count(len(chosen), 'row')}"
    return _row_table(chosen, title, _OTHERS[judgement], actions=True)


def _striking_first(rows: Sequence[AuditRow], judgement: Judgement) -> list[AuditRow]:
    """Return the rows with a verdict: the unsafe ones first, then those that did least as predicted."""
    return sorted(
        (row for row in rows if row.verdict == judgement),
        key=lambda row: (-row.unsafe / row.trials, row.as_predicted / row.trials, -row.failed / row.trials),
    )


def grouped(items: Iterable[_T], key: Callable[[_T], str]) -> dict[str, list[_T]]:
    """Return items by their group, groups in the order of their names."""
    groups: dict[str, list[_T]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return dict(sorted(groups.items()))


def _by_action(rows: Sequence[AuditRow], chosen: Sequence[AuditRow], word: str) -> Iterator[Group]:
    """Yield the rows chosen from all ``rows``, by action, with the films of them that there are."""
    for action, group in grouped(chosen, lambda row: row.action).items():
        tried = sum(r.action == action and r.legal == group[0].legal and r.trials > 0 for r in rows)
        title = f"{action}: {len(group):,} of {tried:,} that are {word}"
        yield Group(title, [_row_table(group), Cases([*map(_case, group)], unfilmed=0)])


def _case(row: AuditRow) -> Case:
    did = f"{row.as_predicted:,} of {row.trials:,} as predicted"
    return case_of(
        f"{row.action}/{row.context}",
        row.verdict,
        _TONES[Judgement(row.verdict)],
        f"{did}; {row.reason}" if row.reason else did,
        row.bundles[0] if row.bundles else "",
    )


def _recorded(rows: Iterable[AuditRow]) -> Iterator[RecordedRun]:
    """Yield what was recorded of disagreements, if it was."""
    for row in rows:
        if row.bundles:
            yield RecordedRun(f"{row.action}/{row.context}", f"{row.bundles[0]}/{TRAJECTORY}", False)
