"""The page of a tuning: before and after, convergence, front, and what each gain does."""

from __future__ import annotations

from collections.abc import Iterator

from craftsim.tuning.gains import plots
from craftsim.tuning.gains.knobs import KEPT
from craftsim.tuning.gains.objectives import OBJECTIVES
from craftsim.tuning.gains.tune import Tuned
from craftsim.tuning.gains.verdict import Ratio
from craftsim.validation.html.page import Headline, KeyFigure, Page, Tone, count, provenance


def tune_page(tuned: Tuned, command: str) -> Page:
    """Return the page of a tuning; ``command`` is how it can be run again."""
    return Page(
        "tune.html.j2",
        "Tuning of gains",
        f"{tuned.config['subject']}: {tuned.goal}",
        _headline(tuned),
        tuple(_key_figures(tuned)),
        {
            "tuned": tuned,
            "objectives": OBJECTIVES,
            "kept": KEPT,
            "drawings": {
                "convergence": plots.converging(tuned),
                "sensitivity": plots.sensitivity(tuned),
                "front": plots.front(tuned) if tuned.goal.front else "",
            },
            "provenance": provenance(command, tuned.seed, tuned.config),
        },
    )


def change(ratio: Ratio) -> str:
    """Return a ratio as a change in per cent."""
    return f"{100 * (ratio.factor - 1):+.1f} %"


def interval(ratio: Ratio) -> str:
    """Return its interval, of single blocks of trials."""
    return f"blocks of trials: {100 * (ratio.low - 1):+.1f} to {100 * (ratio.high - 1):+.1f} %"


def sentence(tuned: Tuned) -> str:
    """Return the verdict in a sentence."""
    verdict = tuned.verdict
    seeds = f"on {count(verdict.before.trials, 'action')} whose seeds were held out"
    if not verdict.improved:
        return f"Nothing better than the start was found, {seeds}; gains.yaml holds the start's gains."
    return (
        f"The product of the objectives changes by {change(verdict.against_start)} from the start "
        f"({interval(verdict.against_start)}), {seeds}; "
        f"{verdict.after.failed} failed, and {verdict.before.failed} before."
    )


def _headline(tuned: Tuned) -> Headline:
    if tuned.verdict.improved and tuned.verdict.against_start.high < 1:
        return Headline("Better", Tone.GOOD, sentence(tuned))
    if tuned.verdict.improved:
        return Headline("Better on average", Tone.CAUTION, sentence(tuned))
    return Headline("Not better", Tone.CAUTION, sentence(tuned))


def _key_figures(tuned: Tuned) -> Iterator[KeyFigure]:
    verdict = tuned.verdict
    yield KeyFigure(change(verdict.against_start), "against the start", interval(verdict.against_start))
    yield KeyFigure(
        change(verdict.against_shipped), "against the shipped gains", interval(verdict.against_shipped)
    )
    before, after = verdict.before, verdict.after
    yield KeyFigure(f"{after.values['time']:.2f} s", "an action", f"{before.values['time']:.2f} s before")
    yield KeyFigure(
        f"{100 * after.margin_left:.0f} %",
        "margin left at the worst trial",
        f"{100 * before.margin_left:.0f} % before",
    )
