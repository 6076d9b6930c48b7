"""The drawings of a report."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
from markupsafe import Markup

from craftsim.experiments import statistics
from craftsim.experiments.durations import Duration
from craftsim.experiments.statistics import MatrixRow, PlanSurvival, PolicyScore, Survival
from craftsim.validation.audit.verdicts import AuditRow, Judgement
from craftsim.validation.html.svg import ACCENT, BAD, CAUTION, GOOD, GRID, MUTED, PAPER, SOFT, canvas

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

_T = TypeVar("_T")

_WIDTH_IN: Final = 6.6
_ROW_IN: Final = 0.27
_HEAD_IN: Final = 0.75
_LONGEST_NAME: Final = 36
_MARKERS: Final = "os^DvPX*"
_QUANTILES: Final = np.linspace(0, 1, 201)

JUDGEMENT_COLOURS: Final = {
    Judgement.SOUND: GOOD,
    Judgement.UNSOUND: BAD,
    Judgement.CONSERVATIVE: CAUTION,
    Judgement.RIGHTLY_FORBIDDEN: MUTED,
}


def success(by_verb: Mapping[str, MatrixRow]) -> Markup:
    """Draw the success of each verb with its interval."""
    rows = [(verb, row.success) for verb, row in by_verb.items() if row.trials]
    with canvas(_WIDTH_IN, _HEAD_IN + _ROW_IN * len(rows), "success by action, with intervals") as drawing:
        axes = drawing.axes
        for y, (_, p) in enumerate(rows):
            axes.plot((p.wilson_low, p.wilson_high), (y, y), color=ACCENT, lw=4, alpha=0.35)
            axes.plot(p.successes / p.trials, y, "o", color=ACCENT, ms=6)
        _names(axes, [verb for verb, _ in rows])
        low = min((p.wilson_low for _, p in rows), default=0.0)
        axes.set_xlim(math.floor(10 * low) / 10 - 0.02, 1.02)
        axes.xaxis.set_major_formatter(_percent)
    return drawing.svg


def grouped(items: Iterable[_T], key: Callable[[_T], str]) -> dict[str, list[_T]]:
    """Return items by their group, groups in the order of their names."""
    groups: dict[str, list[_T]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return dict(sorted(groups.items()))


def judgements(rows: Sequence[AuditRow]) -> Markup:
    """Draw how many rows of each action have which verdict."""
    from matplotlib.ticker import MaxNLocator

    actions = grouped(rows, lambda row: row.action)
    with canvas(_WIDTH_IN, _HEAD_IN + 0.25 + _ROW_IN * len(actions), "verdicts by action") as drawing:
        axes = drawing.axes
        left = np.zeros(len(actions))
        for judgement, colour in JUDGEMENT_COLOURS.items():
            counts = np.array([sum(r.verdict == judgement for r in group) for group in actions.values()])
            axes.barh(
                range(len(actions)), counts, left=left, height=0.62, color=colour, label=judgement.value
            )
            left += counts
        _names(axes, list(actions))
        axes.set_xlabel("rows")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2, handlelength=1)
    return drawing.svg


def survival(survival: PlanSurvival) -> Markup:
    """Draw the Kaplan-Meier curves with and without re-synchronising."""
    with canvas(_WIDTH_IN, 2.9, "plan survival") as drawing:
        axes = drawing.axes
        _curve(axes, survival.with_resync, GOOD, "re-synchronised")
        _curve(axes, survival.without_resync, ACCENT, "not re-synchronised")
        axes.set_ylim(-0.02, 1.04)
        axes.set_xlim(left=0)
        axes.yaxis.set_major_formatter(_percent)
        axes.set_xlabel("actions carried out")
        axes.legend(loc="lower left")
    return drawing.svg


def _curve(axes: Axes, curve: Survival, colour: str, label: str) -> None:
    steps = [0, *curve.actions]
    axes.step(steps, [1.0, *curve.share], where="post", color=colour, lw=1.8, label=label)
    low, high = (np.array([1.0, *bound], dtype=float) for bound in (curve.low, curve.high))
    axes.fill_between(steps, low, high, step="post", color=colour, alpha=0.16, lw=0)


def errors(attempts: DataFrame) -> Markup:
    """Draw how the errors of the attempts that did as predicted are distributed."""
    found = statistics.errors(attempts)
    kinds = (
        ("car_error_m", "car", ACCENT),
        ("placed_error_m", "what is placed", GOOD),
        ("height_error_m", "height", CAUTION),
        ("bystander_displacement_m", "others moved", SOFT),
    )
    with canvas(_WIDTH_IN, 2.9, "distribution of errors") as drawing:
        axes = drawing.axes
        for field, label, colour in kinds:
            if len(values := found[field]):
                axes.plot(np.quantile(values, _QUANTILES), _QUANTILES, color=colour, lw=1.8, label=label)
        axes.set_xscale("symlog", linthresh=0.1, linscale=0.4)
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.set_xlim(left=0)
        axes.yaxis.set_major_formatter(_percent)
        axes.set_xlabel("at most so many millimetres off")
        if axes.lines:
            axes.legend(loc="lower right")
    return drawing.svg


def durations(table: Sequence[Duration]) -> Markup:
    """Draw the durations of each kind of action."""
    with canvas(_WIDTH_IN, _HEAD_IN + 0.23 * len(table), "durations by kind of action") as drawing:
        axes = drawing.axes
        for y, row in enumerate(table):
            axes.plot((row.p05_s, row.p95_s), (y, y), color=ACCENT, lw=4, alpha=0.35)
            axes.plot(row.median_s, y, "o", color=ACCENT, ms=5)
        _names(axes, [duration_name(row) for row in table])
        axes.set_xlim(left=0)
        axes.set_xlabel("seconds")
    return drawing.svg


def duration_name(row: Duration) -> str:
    """Return a kind of action in words."""
    load = "" if row.load == "none" else f" with {row.load}"
    return f"{row.verb}{load}, {'slope' if row.slope else 'flat'}, level {row.level}"


def policies(scores: Sequence[PolicyScore]) -> Markup:
    """Draw each policy's success in the grid world and in physics."""
    with canvas(_WIDTH_IN, 3.4, "success of policies in the grid world and in physics") as drawing:
        axes = drawing.axes
        axes.plot((0, 1), (0, 1), color=GRID, lw=1.2, zorder=1)
        for score, marker in zip(scores, cycle(_MARKERS)):
            axes.plot(
                score.grid,
                score.physics,
                marker,
                color=ACCENT,
                ms=8,
                mec=PAPER,
                clip_on=False,
                zorder=3,
                label=_short(score.policy),
            )
        axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), handletextpad=0.1)
        axes.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), aspect="equal")
        axes.set(xlabel="success in the grid world", ylabel="success in physics")
        axes.xaxis.set_major_formatter(_percent)
        axes.yaxis.set_major_formatter(_percent)
    return drawing.svg


def _names(axes: Axes, names: Sequence[str]) -> None:
    """Name the rows of a drawing, the first at the top."""
    axes.set_yticks(range(len(names)), [_short(name) for name in names])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_visible(False)


def _short(name: str) -> str:
    """Return a name that leaves room for the drawing."""
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 3]}..."


def _percent(value: float, _: float) -> str:
    return f"{100 * value:.0f} %"
