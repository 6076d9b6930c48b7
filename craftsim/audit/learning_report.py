"""The report of learned rules: what they forbid, which trials ask for it, and how play by them goes."""

from __future__ import annotations

from collections import Counter

from craftsim.audit.known_corrections import FOUND_AGAIN
from craftsim.audit.learning_result import LearnedResult
from craftsim.experiments.report_parts import provenance_section
from craftsim.reports.json_file import document
from craftsim.reports.report import (
    Column,
    DataTable,
    Headline,
    KeyFigure,
    Report,
    Section,
    Tone,
    count,
    numbers,
    percent,
)


def learning_report(result: LearnedResult, command: str, share: float) -> Report:
    """Return the report of learning; its exit status is 1 unless at least ``share`` of held-out play is as predicted.

    ``command`` is the command line that repeats it.
    """
    failures = len(result.reasons)
    as_predicted = 0.0
    if result.held_out:
        as_predicted = 1 - failures / result.held_out
    low, high = result.bounds
    passed = result.held_out > 0 and as_predicted >= share
    worlds = count(result.episodes, "world")
    sentence = (
        f"{count(len(result.rules.rules), 'rule')}; of {result.held_out:,} actions in {worlds} never seen "
        f"{as_predicted:.2%} as predicted ({low:.2%} to {high:.2%})."
    )
    headline = Headline("Learned", Tone.GOOD, sentence)
    if not passed:
        headline = Headline("Not enough", Tone.CAUTION, sentence)
    figures = [
        KeyFigure(f"{len(result.rules.rules)}", "rules", f"on {result.rules.base}"),
        KeyFigure(f"{as_predicted:.2%}", "as predicted", f"{result.held_out:,} actions held out"),
        KeyFigure(f"{result.rules.origin.actions:,}", "actions in physics", "in all"),
        KeyFigure(f"{result.cpu_s / 60:.0f} min", "CPU time"),
    ]
    if result.allowed:
        share_forbidden = percent(result.forbidden / result.allowed)
        figures.append(KeyFigure(share_forbidden, "forbidden", "of what works by the other rules"))
    return Report(
        "Learned rules",
        f"machines {result.rules.origin.machines[:8]}",
        headline,
        figures,
        [
            Section(
                "rules",
                "Rules",
                "What each forbids, and the trials that ask for it.",
                [_rules(result)],
                terminal=True,
            ),
            Section(
                "rounds",
                "Rounds",
                "Play searches for failures, trials tell what they depend on.",
                [_rounds(result)],
                terminal=True,
            ),
            Section(
                "held-out",
                "Failures in worlds never seen",
                "By reason.",
                [_reasons(result)],
            ),
            Section(
                "corrections",
                "Corrections",
                "Situations never tried that one correction alone forbids or changes: those that fail, "
                f"and those of these that learned rules forbid. Found again: {FOUND_AGAIN:.0%} of them.",
                [_corrections(result)],
                terminal=True,
            ),
            provenance_section(command, result.seed, result.config),
        ],
        _notes(result),
        document=document(
            {"learning": result.figures}, command="audit", seed=result.seed, config=result.config
        ),
        exit_code=int(not passed),
    )


def _notes(result: LearnedResult) -> list[str]:
    """Return what counts nowhere."""
    notes = []
    if result.unfinished:
        notes.append(f"{count(result.unfinished, 'trial')} did not finish, and count nowhere.")
    if result.unsolved:
        actions = count(result.unsolved, "action")
        notes.append(f"The solver gave up in {actions}, which neither worked nor failed.")
    return notes


def _rules(result: LearnedResult) -> DataTable:
    rows = []
    for rule in result.rules.rules:
        rows.append((rule.name, str(rule), rule.trials, rule.failures, rule.like or None))
    columns = (
        Column("rule", "path"),
        Column("forbids"),
        Column("trials", "number"),
        Column("failures", "number"),
        Column("like"),
    )
    return DataTable(columns, rows, "Rules", tall=True)


def _rounds(result: LearnedResult) -> DataTable:
    rows = []
    for learned in result.rounds:
        rows.append(
            (
                str(learned.number),
                learned.actions,
                learned.failures,
                learned.trials,
                learned.patterns,
                learned.uncovered,
                f"{learned.certain:.2%}",
                f"{learned.cpu_s:.0f}",
            )
        )
    heads = ("round", "actions", "failures", "trials", "rules", "uncovered", "certain", "CPU s")
    return DataTable(numbers(*heads), rows, "Rounds", tall=True)


def _reasons(result: LearnedResult) -> DataTable:
    rows = list(Counter(reason.split(":")[0][:80] for reason in result.reasons).most_common())
    return DataTable(numbers("reason", "actions"), rows, "Reasons", tall=True)


def _corrections(result: LearnedResult) -> DataTable:
    rows = []
    for name, figures in result.corrections.items():
        is_found = "no"
        if figures.is_found:
            is_found = "yes"
        cells = (name, figures.tried, figures.failures, figures.forbidden, is_found)
        rows.append((*cells, ", ".join(figures.rules) or None))
    columns = (
        Column("correction", "path"),
        Column("tried", "number"),
        Column("failures", "number"),
        Column("forbidden", "number"),
        Column("found again"),
        Column("by"),
    )
    return DataTable(columns, rows, "Corrections", tall=True)
