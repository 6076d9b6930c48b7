"""Diagrams over time: what each car did, errors and loads below it against their limits, and what went wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.discrete.drawing import car_colour
from craftsim.rendering.plots.signals import CarSignals, Floats, Signals, end_s, thinned
from craftsim.rendering.plots.style import ROW_IN, WIDTH_IN, dash, line_of, shade

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

_LANE_IN: Final = 0.17
_AXIS_IN: Final = 0.5
_SIGN_IN: Final = 0.07
"""Width of an action's sign."""
NOTE_IN: Final = 0.14
_MOST_NOTES: Final = 6
_MOST_CARS: Final = 24
"""With a diagram of their own."""
_LONGEST: Final = 135
"""Letters in a note."""
_OFFSET: Final = {"textcoords": "offset points"}

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


class _Line(NamedTuple):
    label: str
    values: Floats
    number: int
    """Of its dashes."""
    car: int | None = None
    """Whose colour it has; a shade where it is of none."""
    shade: int = 0


@dataclass(frozen=True, eq=False)
class Diagram:
    """A diagram below the actions."""

    title: str
    unit: str
    lines: list[_Line]
    columns: int = 0
    """Of the legend above it, at its right; none without."""
    limits: tuple[tuple[float, str], ...] = ()
    """Values that are not to be passed, and their words."""
    range: tuple[float, float] | None = None
    car: int | None = None
    """Whose actions are its bands; None where it is about all."""
    height: float = 1.0
    zero: bool = False
    """Whether zero is marked."""
    note: str = ""


def _of_car(values: Floats, labels: Iterable[str], car: int) -> list[_Line]:
    """Return a line for each column (n, m), the first in the car's colour."""
    pairs = enumerate(zip(labels, values.T, strict=True))
    return [
        _Line(label, column, number, *((None, number - 1) if number else (car,)))
        for number, (label, column) in pairs
    ]


def _each_car(cars: Sequence[CarSignals], make: Callable[[CarSignals], Diagram]) -> list[Diagram]:
    """Return a diagram for each car, as far as they fit on a page."""
    rows = [make(car) for car in cars[:_MOST_CARS]]
    if more := len(cars) - len(rows):
        rows[-1] = replace(rows[-1], title=f"{rows[-1].title}; {more} more cars are not drawn")
    return rows


def tracking_rows(signals: Signals) -> list[Diagram]:
    """Return a diagram for each car that drove: its measured pose less its path."""

    def tracking(car: CarSignals) -> Diagram:
        lines = _of_car(1e3 * car.error, ("along (mm)", "across (mm)", "heading (mrad)"), car.car)
        return Diagram(f"car {car.car}: off its path", "mm, mrad", lines, 3, car=car.car, zero=True)

    return _each_car([car for car in signals.cars if np.isfinite(car.error).any()], tracking)


def torque_rows(signals: Signals) -> list[Diagram]:
    """Return a diagram of the wheel torques of each car that acted."""

    def torques(car: CarSignals) -> Diagram:
        most = car.torque_limit_nm
        lines = _of_car(car.torque_nm, ("front left", "front right", "rear left", "rear right"), car.car)
        limits, seen = ((most, "limit"), (-most, "")), (-1.25 * most, 1.25 * most)
        return Diagram(f"car {car.car}: wheel torques", "Nm", lines, 4, limits, seen, car.car)

    return _each_car([car for car in signals.cars if car.attempts], torques)


def board_rows(signals: Signals) -> list[Diagram]:
    """Return diagrams of the boards' heights and forces, and of the hinges where there are slopes."""
    cars, rows = signals.cars, []
    if cars:
        names = [f"car {car.car}" if len(cars) <= 6 else str(car.car) for car in cars]
        heights = [
            _Line(name, 1e3 * car.board_m, car.car, car.car) for name, car in zip(names, cars, strict=True)
        ]
        rows.append(Diagram("height of the boards", "mm", heights, min(12, len(cars))))
        most_n = max(car.board_limit_n for car in cars)
        largest = max(float(np.nanmax(np.abs(car.board_force_n), initial=0)) for car in cars)
        said, shown = f"limit {most_n:.0f} N", largest > most_n / 2
        forces = Diagram(
            "force of the boards",
            "N",
            [_Line(str(car.car), car.board_force_n, car.car, car.car) for car in cars],
            limits=((most_n, said),) if shown else (),
            note="" if shown else f"{said}, above this diagram",
        )
        rows.append(forces)
    if signals.hinges_rad:
        hinges = [
            _Line(f"slope {number}", np.rad2deg(angle), number, shade=number)
            for number, angle in enumerate(signals.hinges_rad)
        ]
        rows.append(Diagram("angle of the hinges", "degrees", hinges, min(8, len(hinges))))
    return rows


def contact_rows(signals: Signals) -> list[Diagram]:
    """Return the diagram of the largest force between any two machines; none where contacts were not looked at."""
    if np.isnan(signals.contact_n).all():
        return []
    most_n = signals.impact_limit_n
    seen = 0.0, 1.12 * max(most_n, float(np.nanmax(signals.contact_n)))
    lines, limits = (
        [_Line("largest of all", signals.contact_n, 0, shade=1)],
        ((most_n, f"limit {most_n:.0f} N"),),
    )
    return [Diagram("largest force between two machines", "N", lines, 0, limits, seen, height=1.6)]


def height_in(signals: Signals, rows: Sequence[Diagram]) -> float:
    """Return the height of diagrams over time."""
    notes = min(len(signals.failures), _MOST_NOTES + 1)
    lanes = _LANE_IN * (len(signals.cars) + 1)
    return lanes + _AXIS_IN + sum(ROW_IN * row.height for row in rows) + NOTE_IN * notes


def draw_rows(figure: Figure | SubFigure, signals: Signals, rows: Sequence[Diagram], most: int) -> None:
    """Draw the actions, below them diagrams over the same time, and below these what went wrong.

    Lines have about ``most`` points at most; gaps are where there is no number.
    """
    lanes = _LANE_IN * (len(signals.cars) + 1)
    heights = [lanes, *(ROW_IN * row.height for row in rows)]
    axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    _draw_actions(axes[0], signals)
    for one, row in zip(axes[1:], rows, strict=True):
        one.set_title(row.title, loc="left", pad=3)
        one.set_ylabel(row.unit)
        _draw_bands(one, signals, row.car)
        _draw_diagram(one, signals.time_s, row, most)
    axes[-1].set_xlabel("simulated time (s)")
    axes[0].set_xlim(signals.time_s[0], max(signals.time_s[-1], signals.time_s[0] + 0.1))
    write_notes(figure, signals)


def write_notes(figure: Figure | SubFigure, signals: Signals) -> None:
    """Say below a figure what went wrong."""
    if notes := notes_of(signals.failures):
        figure.supxlabel("\n".join(notes), x=0.01, ha="left", fontsize=6.5)


def _draw_diagram(axes: Axes, time_s: Floats, row: Diagram, most: int) -> None:
    for line in row.lines:
        colour = shade(line.shade) if line.car is None else car_colour(line.car)
        dashes, points = dash(line.number), thinned(time_s, line.values, most)
        axes.plot(*points, color=colour, ls=dashes, lw=0.8, label=line.label)
    if row.zero:
        axes.axhline(0, color="0.6", lw=0.5)
    for value, words in row.limits:
        axes.axhline(value, color=shade(0), lw=0.8, ls=(0, (8, 2)))
        corner: dict[str, Any] = {"xycoords": ("axes fraction", "data"), **_OFFSET}
        axes.annotate(words, (0, value), (2, 1.5), **corner, fontsize=6.5, color=shade(0))
    if row.note:
        axes.annotate(row.note, (0.003, 0.86), xycoords="axes fraction", fontsize=6.5)
    if row.range is not None:
        axes.set_ylim(row.range)
    if row.columns:
        place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1, 0.98), "borderaxespad": 0}
        long = 2.2 if row.columns < 6 else 1.5
        axes.legend(**place, ncols=row.columns, handlelength=long, columnspacing=1.2)


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
            place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), **_OFFSET}
            axes.annotate(mark(number), (end_s(attempt), 1), (-2, -8), **place, ha="right", weight="bold")
