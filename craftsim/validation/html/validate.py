"""The page of a validation: do plans, actions and policies do in physics what the rules predict?"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, Final

from craftsim.checking.attempt import Verdict
from craftsim.experiments.experiment import TrialRecord
from craftsim.experiments.statistics import Figures, carried_out, legal_attempts
from craftsim.validation.html.page import (
    Case,
    Headline,
    KeyFigure,
    Page,
    Tone,
    count,
    interval,
    percent,
    provenance,
)
from craftsim.validation.html.recorded import recorded_runs
from craftsim.validation.validation import Validation

MOST_CASES: Final = 1000
"""Disagreements that a page lists."""

_TONES: Final = {
    Verdict.AS_PREDICTED: Tone.GOOD,
    Verdict.FAILED: Tone.CAUTION,
    Verdict.SIDE_EFFECT: Tone.CAUTION,
    Verdict.UNSAFE: Tone.BAD,
    Verdict.SOLVER: Tone.MUTED,
}


def validate_page(result: Validation, command: str) -> Page:
    """Return the page of a validation; ``command`` is how it can be run again."""
    cases = _cases(result.records)
    shown = list(islice(cases, MOST_CASES))
    return Page(
        "validate.html.j2",
        "Validation in physics",
        f"{', '.join(result.config['worlds'])}: {', '.join(result.config['by'])}",
        _headline(result.figures, result.records),
        tuple(_key_figures(result.figures)),
        {
            "figures": result.figures,
            "comparison": result.comparison,
            "smallest": result.smallest,
            "cases": shown,
            "recorded": recorded_runs(result.items, result.records),
            "more_cases": sum(1 for _ in cases),
            "legal": legal_attempts(result.records),
            "provenance": provenance(command, result.seed, result.config),
        },
    )


def _headline(figures: Figures, records: Sequence[TrialRecord]) -> Headline:
    actions = figures.matrix.legal
    runs = figures.all.runs
    missed = actions.trials - actions.as_predicted
    errors = sum(figures.errors.values())
    lost = f" {count(errors, 'more trial')} did not come to an end." if errors else ""
    if not runs.trials:
        return Headline("Nothing to judge", Tone.CAUTION, "No trial was carried out to its end." + lost)
    if runs.successes == runs.trials:
        sentence = f"All {count(runs.trials, 'run')} did in physics what the rules predict."
        return Headline("Agrees", Tone.CAUTION if errors else Tone.GOOD, sentence + lost)
    asked = sum(any(not a["legal"] for a in record["attempts"]) for record in records)
    lost += f" {count(asked, 'run')} asked for what the rules forbid, which was not tried." if asked else ""
    if not missed:
        return Headline("Forbidden by the rules", Tone.CAUTION, "All that was tried did as predicted." + lost)
    refused = sum(any(a["legal"] and _disagrees(a) for a in record["attempts"]) for record in records)
    sentence = (
        f"In {refused:,} of {count(runs.trials, 'run')} physics disagrees with the rules; "
        f"of {count(actions.trials, 'action')} that the rules allow, {missed:,} did not do what they predict."
    )
    return Headline("Disagrees", Tone.BAD, sentence + lost)


def _key_figures(figures: Figures) -> Iterator[KeyFigure]:
    shares = {"runs that agree": figures.all.runs, "actions as predicted": figures.all.actions}
    for label, p in shares.items():
        note = f"{p.successes:,} of {p.trials:,}; {interval(p.wilson_low, p.wilson_high)}"
        yield KeyFigure(percent(p.rate), label, note)
    if car := figures.precision.car_error_mm:
        yield KeyFigure(f"{car.median:.2g} mm", "car's error, median", f"95 % within {car.p95:.2g} mm")
    if force := figures.precision.peak_force_n:
        yield KeyFigure(f"{force.max:.0f} N", "peak contact force", f"median {force.median:.0f} N")
    if figures.rank_agreement:
        yield KeyFigure(f"{figures.rank_agreement.mmrv:.2f}", "rank violation (MMRV)", "0 best, 1 worst")


def _cases(records: Iterable[TrialRecord]) -> Iterator[Case]:
    return (case for record in carried_out(records) if (case := _case(record)))


def _case(record: TrialRecord) -> Case | None:
    """Return the first disagreement of a run, None without one."""
    attempt = next((a for a in record["attempts"] if _disagrees(a)), None)
    if attempt is None:
        return None
    result = Verdict(attempt["result"])
    return Case(
        title=f"{record['key']}: tick {attempt['tick']}, car {attempt['car']} {attempt['action']}",
        result=result.value,
        tone=_TONES[result],
        reason=attempt["reason"],
        differences=tuple(attempt["differences"]),
        bundle=record["bundle"] or "",
    )


def _disagrees(attempt: Mapping[str, Any]) -> bool:
    return bool(attempt["result"] != Verdict.AS_PREDICTED)
