"""The report of an audit: which rules does physics keep?"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

from craftsim.audit.audit import (
    Audit,
    AuditRow,
    RuleVerdict,
    judged_by_rules,
    verdict_counts,
)
from craftsim.audit.plan import rows_by_flag
from craftsim.audit.stopping import FAILING_ERROR, PERFECT_TRIALS, SOUND_SHARE
from craftsim.experiments import report_parts as shared
from craftsim.experiments import statistics
from craftsim.experiments.bundle import TRAJECTORY_FILE
from craftsim.experiments.intervals import CONFIDENCE
from craftsim.reports.plots import BAD, CAUTION, GOOD, MUTED, rows_height_in, stacked_rows
from craftsim.reports.report import (
    Block,
    Case,
    Cases,
    Column,
    DataTable,
    Drawing,
    Group,
    Headline,
    KeyFigure,
    Report,
    Section,
    TableCell,
    Tone,
    Value,
    count,
    interval,
    percent,
)
from craftsim.validation.report import case_of, smallest_section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_STRIKING: Final = 6
"""Unsound rows shown before all others, of as many actions as there are."""
_UNSOUND, _CONSERVATIVE, _SOUND, _RIGHT, _NO_PREDICTION, _NOT_TRIED = RuleVerdict
_TONES: Final = {
    _UNSOUND: Tone.BAD,
    _CONSERVATIVE: Tone.CAUTION,
    _SOUND: Tone.GOOD,
    _RIGHT: Tone.PLAIN,
    _NO_PREDICTION: Tone.MUTED,
    _NOT_TRIED: Tone.CAUTION,
}
_COLOURS: Final = {_SOUND: GOOD, _UNSOUND: BAD, _CONSERVATIVE: CAUTION, _RIGHT: MUTED}
_OTHERS: Final = {
    _SOUND: "The rules allow these, and they work.",
    _RIGHT: "The rules forbid these, and they do not work.",
    _NO_PREDICTION: "The rules forbid these, and nothing is intended that could be tried.",
    _NOT_TRIED: "Errors kept all trials of these from an end, or their worlds cannot stand.",
}
"""What is listed last, and what it means."""
_INTERVAL: Final = Column(
    f"{100 * CONFIDENCE:.0f} % interval", tip="of the share that did as predicted"
)


def audit_report(audit: Audit, command: str) -> Report:
    """Return the report of an audit; ``command`` is how it can be run again."""
    figures = audit.figures
    counts = verdict_counts(audit.rows)
    by_flag = rows_by_flag(audit.corrections)
    notes = []
    if by_flag:
        flags = ", ".join(f"{flag} {number}" for flag, number in by_flag.items())
        notes.append(f"unsound rows by the correction that concerns them: {flags}")
    notes += shared.identical_notes(figures.identical)
    notes += shared.run_notes(
        statistics.capped_steps(audit.records), statistics.retried(audit.records)
    )
    notes += shared.comparison_notes(audit.comparison)
    notes += _error_notes(audit)
    decided = (_UNSOUND, _SOUND, _CONSERVATIVE, _RIGHT)
    min_trials = min((row.trials for row in audit.rows if row.trials), default=0)
    nothing = not any(counts[verdict] for verdict in decided)
    key_figures = [KeyFigure(f"{counts[verdict]:,}", verdict.value, "rows") for verdict in decided]
    key_figures.append(KeyFigure(f"{figures.trials:,}", "trials", f"at least {min_trials} a row"))
    failed = (nothing, counts[_UNSOUND], _given_up(audit), statistics.error_counts(audit.records))
    return Report(
        "Audit of the rules",
        f"rule set: {audit.config['rules']}",
        _headline(audit),
        key_figures,
        _sections(audit, command),
        notes,
        exit_code=int(any(failed)),
    )


def _given_up(audit: Audit) -> int:
    """Return the number of trials of allowed actions that say nothing of the rules, as the solver gave up in them."""
    return sum(row.numerics for row in audit.rows if row.legal)


def _error_notes(audit: Audit) -> list[str]:
    """Return how many rows are wrongly judged at most; nothing where no row has enough trials."""
    if not audit.error_bounds:
        return []
    limits = []
    for bound in audit.error_bounds:
        limits.append(
            f"{bound.rows:.1f} succeed in {percent(bound.success_rate)} of trials or less"
        )
    return [
        f"Of the rows without a failure in their first {PERFECT_TRIALS} trials, at most {' and '.join(limits)} "
        f"(expected number, {percent(CONFIDENCE)} confidence); a row that works is called failing early in at most "
        f"{percent(FAILING_ERROR)} of audits."
    ]


def _sections(audit: Audit, command: str) -> list[Section]:
    """Return the sections of an audit, what matters most first."""
    rows = audit.rows
    figures = audit.figures
    unsound = _striking_first(rows, _UNSOUND)
    conservative = _striking_first(rows, _CONSERVATIVE)
    most_striking: dict[str, AuditRow] = {}
    for row in unsound:
        most_striking.setdefault(row.action, row)
    striking_cases = Cases([_case(row) for row in most_striking.values()][:MOST_STRIKING])
    legal_attempts = statistics.legal_attempts(judged_by_rules(audit.records))
    return [
        _disagreements("Unsound", unsound),
        _disagreements("Conservative", conservative),
        _suspects(audit.suspects),
        _matrix(rows, figures),
        *shared.paired_sections(audit.comparison),
        *smallest_section(audit.smallest),
        *_groups(
            rows,
            "The rules allow these, and physics refuses.",
            unsound,
            _corrections(audit.corrections),
            striking_cases,
        ),
        *_groups(rows, "The rules forbid these, and they would have worked.", conservative),
        Section(
            "others",
            "All other rows",
            "The rules and physics agree on these, or there is nothing to compare.",
            _other_tables(rows),
        ),
        Section(
            "errors",
            "Errors and durations",
            "Of what the rules allow and did as predicted.",
            [
                shared.results_table("By action", "action", figures.by_verb),
                shared.precision_table(figures.precision),
                shared.error_drawing(legal_attempts),
                *shared.duration_blocks(figures.durations),
            ],
        ),
        shared.provenance_section(command, audit.seed, audit.config),
    ]


def _corrections(flags_by_row: Mapping[str, Sequence[str]]) -> DataTable:
    """Return a table of the corrections that concern unsound rows."""
    counts = rows_by_flag(flags_by_row)
    without_flag = sum(not flags for flags in flags_by_row.values())
    if without_flag:
        counts["no flag"] = without_flag
    return DataTable(
        (Column("correction", "path"), Column("unsound rows", "number")),
        list(counts.items()),
        "The rules that these come of",
        "A correction is a difference of the physical rules from CraftEnv's; docs/rules.md says what each asks for.",
    )


def _other_tables(rows: Sequence[AuditRow]) -> list[DataTable]:
    """Return a table of the rows of each verdict on which the rules and physics do not differ."""
    tables = []
    for verdict, note in _OTHERS.items():
        rows_of_verdict = [row for row in rows if row.verdict == verdict]
        if rows_of_verdict:
            tables.append(_row_table(rows_of_verdict, verdict.value, note))
    return tables


def _headline(audit: Audit) -> Headline:
    counts = verdict_counts(audit.rows)
    errors = sum(statistics.error_counts(audit.records).values())
    unsound = counts[_UNSOUND]
    conservative = counts[_CONSERVATIVE]
    allowed = unsound + counts[_SOUND]
    provisional = sum(row.provisional for row in audit.rows)
    sentence = (
        f"{audit.config['rules']}: {unsound:,} of {count(allowed, 'row')} that the rules allow are unsound; "
        f"{conservative:,} that they forbid would have worked, {counts[_RIGHT]:,} are rightly forbidden."
    )
    if errors:
        sentence += f" {count(errors, 'trial')} did not finish."
    fallen = audit.figures.not_standing
    if fallen:
        sentence += f" {count(fallen, 'world')} cannot stand, and nothing was tried there."
    given_up = _given_up(audit)
    if given_up:
        sentence += (
            f" The solver gave up in {count(given_up, 'trial')} of these, which do not count."
        )
    if provisional:
        if provisional == 1:
            are = "row is"
        else:
            are = "rows are"
        sentence += f" {provisional:,} {are} judged by too few trials: provisional."
    if unsound:
        return Headline("Unsound", Tone.BAD, sentence)
    if not allowed or counts[_NOT_TRIED] or given_up:
        return Headline("Not decided", Tone.CAUTION, sentence)
    return Headline("Sound", Tone.GOOD, sentence)


def _suspects(suspects: Iterable[Mapping[str, Any]]) -> Section:
    columns = (
        Column("suspect", "wide"),
        Column("verdict"),
        Column("evidence", "path", terminal=False),
        Column("rows", "number"),
        Column("trials", "number"),
    )
    rows = []
    for suspect in suspects:
        # Verdicts are listed the gravest first.
        first = suspect["verdict"].split(", ")[0]
        gravest = next((verdict for verdict in RuleVerdict if first.endswith(f" {verdict}")), None)
        tone = Tone.MUTED
        if gravest is not None:
            tone = _TONES[gravest]
        cell = TableCell(suspect["verdict"], tone)
        question = f"{suspect['number']}. {suspect['question']}"
        rows.append((question, cell, suspect["evidence"], suspect["rows"], suspect["trials"]))
    table = DataTable(
        columns, rows, "Suspects", "Evidence is the clearest row of the gravest verdict."
    )
    lead = "Rules that were under suspicion before the audit."
    return Section("suspects", "Suspects", lead, [table], terminal=True)


def _matrix(rows: Sequence[AuditRow], figures: statistics.Figures) -> Section:
    actions = _by_action(rows)
    parts = {}
    for verdict, colour in _COLOURS.items():
        counts = []
        for rows_of_action in actions.values():
            counts.append(sum(row.verdict == verdict for row in rows_of_action))
        parts[verdict.value] = (colour, counts)

    def draw(axes: Axes) -> None:
        stacked_rows(axes, list(actions), parts)
        axes.set_xlabel("rows")

    height_in = rows_height_in(len(actions)) + 0.25
    drawing = Drawing.of_axes(
        draw, height_in, "Verdicts on the rows of each action.", "verdicts by action"
    )
    lead = (
        "A row is one action in situations that physics cannot tell apart. The action works there when at least "
        f"{100 * SOUND_SHARE:.0f} % of the trials did what was predicted, and nothing else."
    )
    blocks = [shared.legality_table(figures.matrix), drawing, *shared.error_tables(figures.errors)]
    return Section("matrix", "Rules against physics", lead, blocks)


def _groups(
    rows: Sequence[AuditRow], lead: str, chosen: Sequence[AuditRow], *first: Block
) -> list[Section]:
    """Return the rows with a verdict by action, with the films of them that there are; nothing for no row."""
    if not chosen:
        return []
    blocks = [*first]
    legal = chosen[0].legal
    verdict = chosen[0].verdict
    rule = "forbidden"
    if legal:
        rule = "allowed"
    for action, group in _by_action(chosen).items():
        tried = sum(row.action == action and row.legal == legal and row.trials > 0 for row in rows)
        title = f"{action}: {len(group):,} of {tried:,} that are {rule}"
        blocks.append(Group(title, [_row_table(group), Cases([*map(_case, group)], unfilmed=0)]))
    if first:
        lead += " First the most striking row of an action each, then all of them."
    title = f"{verdict.capitalize()}: {count(len(chosen), 'row')}"
    return [Section(verdict, title, f"{lead} Replay bundles from the folder of this page.", blocks)]


def _disagreements(verdict: str, rows: Sequence[AuditRow]) -> Section:
    """Return what the terminal says of rows with a verdict, the most striking first; the page has groups of them."""
    title = f"{verdict}: {count(len(rows), 'row')}"
    columns = (
        Column("row", "path"),
        Column("as predicted", "number"),
        _INTERVAL,
        Column("physical reason", "wide"),
    )
    cells = []
    for row in rows:
        share = f"{row.as_predicted:,} of {row.trials:,}"
        cells.append((row.name, share, interval(row.low, row.high), row.reason))
    return Section(
        verdict.lower(), title, "", [DataTable(columns, cells, title)], terminal=True, page=False
    )


def _row_table(rows: Sequence[AuditRow], verdict: str = "", note: str = "") -> DataTable:
    """Return the table of all that is known of rows; folded where all have one verdict."""
    cells: list[tuple[Value, ...]] = []
    for row in rows:
        trials, *results = shared.result_cells(row)
        if row.provisional:
            trials = TableCell(f"{trials}, provisional", Tone.CAUTION)
        share = None
        if row.trials:
            bar = (row.as_predicted / row.trials, row.low, row.high)
            share = TableCell(interval(row.low, row.high), share=bar)
        bundle = None
        if row.bundles:
            bundle = TableCell(row.bundles[0], link=f"{row.bundles[0]}/{TRAJECTORY_FILE}")
        cells.append((row.name, row.reason, trials, *results, share, bundle))
    columns = (
        Column("row", "path"),
        Column("physical reason", "wide"),
        *shared.RESULT_COLUMNS,
        _INTERVAL,
        Column("bundle", "path", "folder of a replay bundle: craftsim replay FOLDER"),
    )
    title = ""
    if verdict:
        title = f"{verdict.capitalize()}: {count(len(rows), 'row')}"
    return DataTable(columns, cells, title, note, folded=bool(verdict), tall=True)


def _striking_first(rows: Sequence[AuditRow], judgement: RuleVerdict) -> list[AuditRow]:
    """Return the rows with a verdict: the unsafe ones first, then those that did least as predicted."""
    return sorted(
        (row for row in rows if row.verdict == judgement),
        key=lambda row: (
            -row.unsafe / row.trials,
            row.as_predicted / row.trials,
            -row.failed / row.trials,
        ),
    )


def _by_action(rows: Iterable[AuditRow]) -> dict[str, list[AuditRow]]:
    """Return rows by their action, in the order of the actions' names."""
    groups: dict[str, list[AuditRow]] = {}
    for row in sorted(rows, key=attrgetter("action")):
        groups.setdefault(row.action, []).append(row)
    return groups


def _case(row: AuditRow) -> Case:
    bundle = ""
    if row.bundles:
        bundle = row.bundles[0]
    return case_of(row.name, row.verdict, _TONES[RuleVerdict(row.verdict)], row.evidence, bundle)
