"""The page of an audit: which rules does physics keep?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from craftsim.experiments.statistics import Figures, legal_attempts
from craftsim.validation.audit.audit import Audit
from craftsim.validation.audit.suspects import SuspectFinding
from craftsim.validation.audit.verdicts import (
    SOUND_SHARE,
    AuditRow,
    Judgement,
    provisional_note,
    verdict_counts,
)
from craftsim.validation.html.page import Case, Headline, KeyFigure, Page, Tone, count, provenance
from craftsim.validation.html.plots import grouped
from craftsim.validation.html.recorded import recorded_cases

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


@dataclass(frozen=True)
class ActionGroup:
    """The rows of one action on which the rules and physics disagree, the most striking first."""

    action: str
    rows: Sequence[AuditRow]
    tried: int
    """How many rows of the action were tried that the rules allow, or forbid, as they do these."""

    @property
    def cases(self) -> tuple[Case, ...]:
        """The rows, to be watched and replayed."""
        return tuple(map(_case, self.rows))


def audit_page(audit: Audit, command: str) -> Page:
    """Return the page of an audit; ``command`` is how it can be run again."""
    rows, rules = audit.results.rows, audit.config["rules"]
    unsound = _striking_first(rows, Judgement.UNSOUND)
    first = {row.action: row for row in reversed(unsound)}
    one_each = [row for row in unsound if first[row.action] is row]
    conservative = _striking_first(rows, Judgement.CONSERVATIVE)
    strangest_first = [*one_each, *(row for row in unsound if row not in one_each), *conservative]
    uncorrected = sum(not flags for flags in audit.corrections.values())
    return Page(
        "audit.html.j2",
        "Audit of the rules",
        f"rule set: {rules}",
        _headline(rows, rules),
        tuple(_key_figures(rows, audit.figures)),
        {
            "rows": rows,
            "counts": verdict_counts(rows),
            "sound_share": SOUND_SHARE,
            "suspects": [(suspect, _tone(suspect)) for suspect in audit.results.suspects],
            "figures": audit.figures,
            "comparison": audit.comparison,
            "smallest": audit.smallest,
            "unsound": _by_action(rows, unsound),
            "most_striking": [_case(row) for row in one_each][:MOST_STRIKING],
            "corrections": audit.rows_by_flag | {"no flag": uncorrected},
            "conservative": _by_action(rows, conservative),
            "recorded": recorded_cases(map(_case, strangest_first)),
            "legal": legal_attempts(audit.judged),
            "provenance": provenance(command, audit.seed, audit.config),
        },
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
        sentence = f"Of what the {rules} rules allow, {allowed:,} works."
        return Headline("Not decided", Tone.CAUTION, sentence + rest)
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


def _striking_first(rows: Sequence[AuditRow], judgement: Judgement) -> list[AuditRow]:
    """Return the rows with a verdict: the unsafe ones first, then those that did least as predicted."""
    return sorted(
        (row for row in rows if row.verdict == judgement),
        key=lambda row: (-row.unsafe / row.trials, row.as_predicted / row.trials, -row.failed / row.trials),
    )


def _by_action(rows: Sequence[AuditRow], chosen: Sequence[AuditRow]) -> list[ActionGroup]:
    """Return the groups of rows chosen from all ``rows``."""
    return [
        ActionGroup(
            action,
            group,
            sum(r.action == action and r.legal == group[0].legal and r.trials > 0 for r in rows),
        )
        for action, group in grouped(chosen, lambda row: row.action).items()
    ]


def _case(row: AuditRow) -> Case:
    did = f"{row.as_predicted:,} of {row.trials:,} as predicted"
    return Case(
        title=f"{row.action}/{row.context}",
        result=row.verdict,
        tone=_TONES[Judgement(row.verdict)],
        reason=f"{did}; {row.reason}" if row.reason else did,
        bundle=row.bundles[0] if row.bundles else "",
    )


def _tone(finding: SuspectFinding) -> Tone:
    """Return the tone of the gravest verdict; verdicts are listed in that order."""
    gravest = next((j for j in Judgement if finding.verdict.split(", ")[0].endswith(f" {j}")), None)
    return _TONES[gravest] if gravest else Tone.MUTED
