"""Diagrams over time that share what was done: a row of actions for each car, and marks where one went wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from craftsim.checking.attempt import Attempt
from craftsim.discrete.drawing import car_colour
from craftsim.rendering.plots.signals import CarSignals, Signals, end_s, thinned
from craftsim.rendering.plots.style import ROW_IN, WIDTH_IN, line_of, shade

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from craftsim.rendering.plots.signals import Floats

_LANE_IN: Final = 0.17
_AXIS_IN: Final = 0.5
_SIGN_IN: Final = 0.07
"""Width of an action's sign."""
_NOTE_IN: Final = 0.14
_MOST_NOTES: Final = 6
_MOST_CARS: Final = 24
"""With a diagram of their own."""
_LONGEST: Final = 135
"""Letters in a note."""

SIGNS: Final = {
    "LIFT": "L",
    "DROP": "D",
    "FOLD": "F",
    "UNFOLD": "U",
    "ROTATE_LEFT": "↺",
    "ROTATE_RIGHT": "↻",
    "MOVE_FORWARD": "↑",
    "MOVE_BACK": "↓",
    "MOVE_LEFT": "←",
    "MOVE_RIGHT": "→",
    "STOP": "·",
}
"""Of actions; moves as on a map with y up."""


@dataclass(frozen=True)
class Diagram:
    """A diagram below the actions."""

    title: str
    unit: str
    draw: Callable[[Axes], None]
    car: int | None = None
    """Whose actions are its bands; None where it is about all."""
    height: float = 1.0


def each_car(cars: Sequence[CarSignals], make: Callable[[CarSignals], Diagram]) -> list[Diagram]:
    """Return a diagram for each car, as far as they fit on a page."""
    rows = [make(car) for car in cars[:_MOST_CARS]]
    if more := len(cars) - len(rows):
        rows[-1] = replace(rows[-1], title=f"{rows[-1].title}; {more} more cars are not drawn")
    return rows


def height_in(signals: Signals, rows: Sequence[Diagram]) -> float:
    """Return the height of diagrams over time."""
    notes = min(len(signals.failures), _MOST_NOTES + 1)
    lanes = _LANE_IN * (len(signals.cars) + 1)
    return lanes + _AXIS_IN + sum(ROW_IN * row.height for row in rows) + _NOTE_IN * notes


def draw_rows(figure: Figure | SubFigure, signals: Signals, rows: Sequence[Diagram]) -> None:
    """Draw the actions, below them diagrams over the same time, and below these what went wrong."""
    lanes = _LANE_IN * (len(signals.cars) + 1)
    heights = [lanes, *(ROW_IN * row.height for row in rows)]
    axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    _draw_actions(axes[0], signals)
    for one, row in zip(axes[1:], rows, strict=True):
        one.set_title(row.title, loc="left", pad=3)
        one.set_ylabel(row.unit)
        _draw_bands(one, signals, row.car)
        row.draw(one)
    axes[-1].set_xlabel("simulated time (s)")
    axes[0].set_xlim(signals.time_s[0], max(signals.time_s[-1], signals.time_s[0] + 0.1))
    if notes := notes_of(signals.failures):
        figure.supxlabel("\n".join(notes), x=0.01, ha="left", fontsize=6.5)


def line(
    axes: Axes, signals: Signals, values: Floats, most: int, colour: object, dashes: object, label: str
) -> None:
    """Draw a signal of about ``most`` points at most; gaps are where there is no number."""
    axes.plot(*thinned(signals.time_s, values, most), color=colour, ls=dashes, lw=0.8, label=label)


def legend(axes: Axes, columns: int) -> None:
    """Say above a diagram, at its right, what its lines are."""
    place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1, 0.98), "borderaxespad": 0}
    axes.legend(**place, ncols=columns, handlelength=2.2 if columns < 6 else 1.5, columnspacing=1.2)


def limit(axes: Axes, value: float, words: str) -> None:
    """Draw a limit."""
    ink = shade(0)
    axes.axhline(value, color=ink, lw=0.8, ls=(0, (8, 2)))
    axes.annotate(words, (0, value), (2, 1.5), **_CORNER, fontsize=6.5, color=ink)


_CORNER: Final[dict[str, Any]] = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}


def mark(number: int) -> str:
    """Return the sign of a failure, as drawings and notes have it."""
    return f"✗{number}"


def notes_of(failures: Sequence[Attempt]) -> list[str]:
    """Return what went wrong in words, numbered as in the drawings."""
    notes = []
    for number, attempt in enumerate(failures[:_MOST_NOTES], 1):
        words = attempt.action.lower().replace("_", " ")
        text = f"{mark(number)} {end_s(attempt):.1f} s, car {attempt.car} {words}: {attempt.result}. {attempt.reason}"
        notes.append(line_of(text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."))
    if more := len(failures) - len(notes):
        notes.append(f"and {more} more")
    return notes


def _draw_actions(axes: Axes, signals: Signals) -> None:
    span = max(signals.trajectory.duration_s, 0.1)
    axes.set_yticks(range(len(signals.cars)), [f"car {car.car}" for car in signals.cars])
    axes.set_ylim(len(signals.cars) - 0.5, -0.9)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    for car in signals.cars:
        for attempt in car.attempts:
            _draw_action(axes, attempt, WIDTH_IN * 0.85 * attempt.duration_s / span > _SIGN_IN)
    for number, attempt in enumerate(signals.failures, 1):
        axes.annotate(mark(number), (end_s(attempt), attempt.car - 0.42), ha="center", weight="bold")


def _draw_action(axes: Axes, attempt: Attempt, signed: bool) -> None:
    frame: dict[str, Any] = {} if attempt.agrees else {"edgecolor": shade(0), "linewidth": 1.4, "zorder": 3}
    bar: dict[str, Any] = {"height": 0.78, "facecolor": (*car_colour(attempt.car), 0.3)} | frame
    axes.barh(attempt.car, attempt.duration_s, left=attempt.start_s, **bar)
    axes.vlines(attempt.start_s, attempt.car - 0.39, attempt.car + 0.39, color=car_colour(attempt.car), lw=1)
    if signed:
        middle = attempt.start_s + attempt.duration_s / 2
        place: dict[str, Any] = {"ha": "center", "va": "center_baseline", "fontsize": 6.5, "clip_on": True}
        axes.text(middle, attempt.car, SIGNS.get(attempt.action, ""), **place)


def _draw_bands(axes: Axes, signals: Signals, car: int | None) -> None:
    """Mark when a car acts, and where its actions, or any, went wrong."""
    for attempt in () if car is None else signals.cars[car].attempts:
        axes.axvspan(attempt.start_s, end_s(attempt), color="0.5", alpha=0.12, lw=0)
    for number, attempt in enumerate(signals.failures, 1):
        if car in (None, attempt.car):
            axes.axvline(end_s(attempt), color=shade(0), lw=0.9, ls=(0, (1, 1)))
            place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
            axes.annotate(mark(number), (end_s(attempt), 1), (-2, -8), **place, ha="right", weight="bold")
