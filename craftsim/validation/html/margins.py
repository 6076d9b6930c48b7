"""The page of a search for margins: a data sheet of what the machines and their skills stand."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from markupsafe import Markup

from craftsim.experiments.statistics import error_counts
from craftsim.validation.html.page import Headline, KeyFigure, Page, Tone, count, percent, provenance
from craftsim.validation.html.svg import BAD, GOOD, INK, canvas
from craftsim.validation.margins.maps import Map, values_of
from craftsim.validation.margins.margins import Margins
from craftsim.validation.margins.search import SHARE, confidence

_SIDE_IN: Final = 5.4


def margins_page(result: Margins, command: str) -> Page:
    """Return the page of a search; ``command`` is how it can be run again."""
    weakest = result.weakest
    return Page(
        "margins.html.j2",
        "Margins",
        f"beyond --randomize {result.config['randomize']}, {result.config['setup'].machines.drive} drive",
        _headline(result),
        tuple(_key_figures(result)),
        {
            "axes": result.telling,
            "weakest": weakest,
            "by_action": {
                action: [by_axis[axis.name] for axis in result.telling if axis.name in by_axis]
                for action, by_axis in weakest.items()
            },
            "margins": result.margins,
            "maps": [(one, _drawn(one)) for one in result.maps],
            "errors": error_counts(result.records),
            "share": SHARE,
            "sure": confidence(result.config["trials"]),
            "compared": any(one.before for one in result.margins),
            "provenance": provenance(command, result.seed, result.config),
        },
    )


def _headline(result: Margins) -> Headline:
    weak = sorted({one.scenario for one in result.margins if one.limit.margin is None})
    if weak:
        sentence = f"{count(len(weak), 'scenario')} not stood even in the base: {', '.join(weak)}."
        return Headline("Fails in the base", Tone.BAD, sentence)
    lost = sum(record["error"] is not None for record in result.records)
    sentence = "How far each imperfection may grow, alone, until an action fails."
    sentence += f" {count(lost, 'search')[:-1] + 'es'} came to no end." if lost else ""
    return Headline("Data sheet", Tone.CAUTION if lost else Tone.GOOD, sentence)


def _key_figures(result: Margins) -> Iterator[KeyFigure]:
    yield KeyFigure(
        f"{len({one.scenario for one in result.margins})}", "scenarios", f"{len(result.weakest)} actions"
    )
    yield KeyFigure(f"{len(result.telling)}", "imperfections that matter", "to one action or more")
    trials = result.config["trials"]
    yield KeyFigure(
        f"{trials}", "trials stand each margin", f"{percent(confidence(trials))} sure of {percent(SHARE)}"
    )
    tried = sum(one.limit.tried for one in result.margins)
    yield KeyFigure(f"{tried:,}", "trials in all")


def _drawn(one: Map) -> Markup:
    """Draw the share of trials that stand each pair of levels, and where all do."""
    import numpy as np

    right, up = one.pair
    share = np.array(one.stood) / one.of
    label = f"{one.scenario}: share that stands {right.words} and {up.words}"
    with canvas(_SIDE_IN + 1.0, _SIDE_IN, label) as drawing:
        axes = drawing.axes
        for row, column in np.ndindex(*share.shape):
            value = share[row, column]
            # Flat colours of the page: a colour between two of them would not follow light and dark.
            colour, alpha = (GOOD, 0.75) if value == 1 else (BAD, 0.15 + 0.6 * (1 - value))
            axes.fill_between(
                (column - 0.5, column + 0.5), row - 0.5, row + 0.5, color=colour, alpha=alpha, lw=0
            )
            axes.text(column, row, f"{100 * value:.0f}", ha="center", va="center", color=INK, fontsize=7)
        ticks = [[f"{axis.scale * value:.3g}" for value in values_of(axis)] for axis in one.pair]
        axes.set_xticks(range(len(ticks[0])), ticks[0])
        axes.set_yticks(range(len(ticks[1])), ticks[1])
        axes.grid(visible=False)
        axes.set_xlabel(f"{right.words}, {right.unit}")
        axes.set_ylabel(f"{up.words}, {up.unit}")
    return drawing.svg
