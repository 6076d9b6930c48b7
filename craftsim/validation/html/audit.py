"""The page of an audit: which rules does physics keep?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from craftsim.validation.audit.audit import Audit
from craftsim.validation.html.audit_tables import corrections_table, suspects_table
from craftsim.validation.html.disagreements import (
    agreement_table,
    conservative_section,
    unsound_section,
)
from craftsim.validation.html.page import Headline, KeyFigure, Page, Section, Tone
from craftsim.validation.html.paired import paired_section
from craftsim.validation.html.plots import durations_plot, errors_plot, judgement_plot
from craftsim.validation.html.run_description import RunDescription, provenance_section
from craftsim.validation.html.tables import (
    count,
    duration_rows,
    error_table,
    matrix_table,
    precision_table,
    verb_table,
)
from craftsim.validation.statistics.audit_rows import (
    SOUND_SHARE,
    AuditRow,
    Judgement,
    provisional_note,
    verdict_counts,
)
from craftsim.validation.statistics.figures import Figures
from craftsim.validation.statistics.records import attempts_of, carried_out

_NOTES: Final = {
    Judgement.SOUND: "The rules allow these, and they work.",
    Judgement.RIGHTLY_FORBIDDEN: "The rules forbid these, and they do not work.",
    Judgement.NO_PREDICTION: "The rules forbid these, and nothing is intended that could be tried.",
    Judgement.NOT_TRIED: "Errors kept all trials of these from an end.",
}


def audit_page(audit: Audit, command: str) -> Page:
    """Return the page of an audit; ``command`` is how it can be run again."""
    rows, rules = audit.results.rows, audit.config["rules"]
    return Page(
        "Audit of the rules",
        f"rule set: {rules}",
        _headline(rows, rules),
        tuple(_key_figures(rows, audit.figures)),
        tuple(_sections(audit, RunDescription.of(command, audit.seed, audit.config))),
    )


def _headline(rows: Sequence[AuditRow], rules: str) -> Headline:
    found = verdict_counts(rows)
    unsound, sound, conservative, untried = (
        found[j] for j in (Judgement.UNSOUND, Judgement.SOUND, Judgement.CONSERVATIVE, Judgement.NOT_TRIED)
    )
    allowed = unsound + sound
    rest = f" The rules forbid {conservative:,} needlessly." if conservative else ""
    rest += f" Errors kept {count(untried, 'row')} from being judged." if untried else ""
    rest += f" {note}" if (note := provisional_note(rows)) else ""
    if unsound:
        sentence = f"Of {count(allowed, 'row')} that the {rules} rules allow, physics refuses {unsound:,}."
        return Headline("Unsound", Tone.BAD, sentence + rest)
    if not allowed or untried:
        return Headline(
            "Not decided", Tone.CAUTION, f"Of what the {rules} rules allow, {allowed:,} works." + rest
        )
    sentence = f"All that the {rules} rules allow works in physics: {count(allowed, 'row')}."
    return Headline("Sound", Tone.GOOD, sentence + rest)


def _key_figures(rows: Sequence[AuditRow], figures: Figures) -> Iterator[KeyFigure]:
    found = verdict_counts(rows)
    for judgement in (
        Judgement.UNSOUND,
        Judgement.SOUND,
        Judgement.CONSERVATIVE,
        Judgement.RIGHTLY_FORBIDDEN,
    ):
        yield KeyFigure(f"{found[judgement]:,}", judgement.value, "rows")
    tried = [row.trials for row in rows if row.trials]
    yield KeyFigure(f"{figures.trials:,}", "trials", f"at least {min(tried, default=0)} a row")


def _sections(audit: Audit, description: RunDescription) -> Iterator[Section]:
    rows, figures, comparison = audit.results.rows, audit.figures, audit.comparison
    lead = "Rules that were under suspicion before the audit."
    yield Section("suspects", "Suspects", lead, (suspects_table(audit.results.suspects),))
    yield Section(
        "matrix",
        "Rules against physics",
        "A row is one action in situations that physics cannot tell apart. The action works there when at least "
        f"{100 * SOUND_SHARE:.0f} % of the trials did what was predicted, and nothing else.",
        (
            matrix_table(figures.matrix),
            judgement_plot(rows),
            *((error_table(figures.errors),) if figures.errors else ()),
        ),
    )
    if comparison is not None:
        yield paired_section(comparison)
    found = verdict_counts(rows)
    if found[Judgement.UNSOUND]:
        yield unsound_section(rows, corrections_table(audit.corrections))
    if found[Judgement.CONSERVATIVE]:
        yield conservative_section(rows)
    yield Section(
        "others",
        "All other rows",
        "The rules and physics agree on these, or there is nothing to compare.",
        tuple(
            agreement_table(rows, judgement, note) for judgement, note in _NOTES.items() if found[judgement]
        ),
    )
    legal = [attempt for attempt in attempts_of(carried_out(audit.judged)) if attempt["legal"]]
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
    yield provenance_section(description)
