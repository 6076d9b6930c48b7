"""How cars moved: their paths from above, and how far they were from where they should have been."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.discrete.drawing import INK, car_colour
from craftsim.rendering.plots.levels import CARS, Arrangement, draw_levels
from craftsim.rendering.plots.signals import CarSignals, Signals, end_s, path_points
from craftsim.rendering.plots.style import WIDTH_IN, dash, shade
from craftsim.rendering.plots.timeline import Diagram, each_car, legend, line, mark, notes_of
from craftsim.rendering.shapes import levels_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

_FOOT_IN: Final = 0.15
_NOTE_IN: Final = 0.14
_ARROW_EVERY: Final = 0.9
"""Cells of way between two arrows, at least."""
_STAYED: Final = 0.5
"""Cells of way that are none."""
_BESIDE: Final = 0.33
"""Cells in x and in y: where no number of a car stands that began there."""
_MOST_ARROWS: Final = 100
"""Of a car."""
_LEGEND_COLUMNS: Final = 8
_LEGEND_IN: Final = 0.16
_WIDTHS: Final = (2.6, 2.0, 1.5, 1.1)
"""Of lines in points, car after car, so that one shows below another."""
_PARTS: Final = ("along (mm)", "across (mm)", "heading (mrad)")


def paths_height_in(signals: Signals) -> float:
    """Return the height of the drawing of paths."""
    legend = _LEGEND_IN * math.ceil(len(signals.cars) / _LEGEND_COLUMNS)
    return _arranged(signals).height_in + _FOOT_IN + legend + _NOTE_IN * len(notes_of(signals.failures))


def draw_paths(figure: Figure | SubFigure, signals: Signals) -> None:
    """Draw each car's way over the world at the start, level by level, with the design and where actions failed."""
    recipe = signals.trajectory.story.recipe
    goal = recipe.goals[0] if recipe.goals and not signals.design else None
    levels = _levels(signals)
    by_level = draw_levels(figure, recipe.grid, levels, _arranged(signals), goal, signals.design)
    for car in signals.cars:
        _draw_path(by_level, car)
    for number, attempt in enumerate(signals.failures, 1):
        _mark(by_level, signals, attempt, number)
    handles = [_handle(car.car) for car in signals.cars]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=min(_LEGEND_COLUMNS, len(handles)), handlelength=3
    )
    if notes := notes_of(signals.failures):
        figure.supxlabel("\n".join(notes), x=0.01, ha="left", fontsize=6.5)


def tracking_rows(signals: Signals, most: int) -> list[Diagram]:
    """Return a diagram for each car that drove: its measured pose less its path."""
    driven = [car for car in signals.cars if np.isfinite(car.error).any()]
    return each_car(driven, lambda car: _tracking(signals, car, most))


def _tracking(signals: Signals, car: CarSignals, most: int) -> Diagram:
    def draw(axes: Axes) -> None:
        for number, name in enumerate(_PARTS):
            colour = car_colour(car.car) if number == 0 else shade(number - 1)
            line(axes, signals, 1e3 * car.error[:, number], most, colour, dash(number), name)
        axes.axhline(0, color="0.6", lw=0.5)
        legend(axes, len(_PARTS))

    return Diagram(f"car {car.car}: off its path", "mm, mrad", draw, car.car)


def _levels(signals: Signals) -> tuple[int, ...]:
    recipe = signals.trajectory.story.recipe
    visited = {int(z) for car in signals.cars for z in np.unique(_level(car))}
    return tuple(sorted({*levels_of([recipe.grid], None, signals.design), *visited}))


def _level(car: CarSignals) -> np.ndarray:
    """Return the level (n,) in whose drawing each point of a path is: the nearest."""
    return np.round(car.place[:, 2]).astype(int)


def _arranged(signals: Signals) -> Arrangement:
    return Arrangement(signals.trajectory.story.recipe.grid.size, len(_levels(signals)), WIDTH_IN)


def _draw_path(by_level: dict[int, Axes], car: CarSignals) -> None:
    chosen = path_points(car.place)
    place, level = car.place[chosen], _level(car)[chosen]
    for z, axes in by_level.items():
        here = np.where((level == z)[:, None], place[:, :2], np.nan)
        if np.isfinite(here).any():
            axes.plot(*here.T, color="white", lw=_width(car.car) + 1.4, solid_capstyle="butt")
            axes.plot(*here.T, color=car_colour(car.car), lw=_width(car.car), ls=dash(car.car))
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place[:, :2], axis=0), axis=1))])
    for at in np.arange(0.5, way[-1], max(_ARROW_EVERY, way[-1] / _MOST_ARROWS)):
        i = int(np.searchsorted(way, at))
        ahead = place[i, :2] - place[i - 1, :2]
        _arrow(by_level[int(level[i])], place[i, :2], ahead / np.linalg.norm(ahead), car.car)
    if way[-1] > _STAYED:
        _end(by_level[int(level[-1])], place[-1, :2], car.car)


def _arrow(axes: Axes, place: np.ndarray, ahead: np.ndarray, car: int) -> None:
    from matplotlib.patches import Polygon

    left = np.array([-ahead[1], ahead[0]])
    points = [place + 0.13 * ahead, place - 0.07 * ahead + 0.1 * left, place - 0.07 * ahead - 0.1 * left]
    axes.add_patch(Polygon(points, facecolor=car_colour(car), edgecolor="white", lw=0.6, zorder=3))


def _end(axes: Axes, place: np.ndarray, car: int) -> None:
    """Put a car's number beside the end of its way."""
    x, y = place[0] + _BESIDE, place[1] - _BESIDE
    axes.plot(x, y, "o", ms=7.5, mfc=car_colour(car), mec="white", mew=0.8, zorder=CARS + 1)
    text: dict[str, Any] = {"ha": "center", "va": "center_baseline", "fontsize": 5.5, "weight": "bold"}
    axes.text(x, y, str(car), color="white", zorder=CARS + 1, **text)


def _mark(by_level: dict[int, Axes], signals: Signals, attempt: Attempt, number: int) -> None:
    """Mark where a car was when its action had failed."""
    at = signals.trajectory.at(end_s(attempt))
    car = signals.cars[attempt.car]
    axes = by_level[int(_level(car)[at])]
    x, y = car.place[at, :2]
    axes.plot(x, y, "X", ms=9, mfc="white", mec=INK, mew=1.4, zorder=CARS + 2)
    place: dict[str, Any] = {
        "textcoords": "offset points",
        "weight": "bold",
        "color": INK,
        "zorder": CARS + 2,
    }
    box = {"facecolor": "white", "alpha": 0.8, "pad": 0.6}
    axes.annotate(mark(number), (x, y), (6, 4), **place, bbox=box)


def _width(car: int) -> float:
    return _WIDTHS[min(car, len(_WIDTHS) - 1)]


def _handle(car: int) -> object:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=car_colour(car), lw=_width(car), ls=dash(car), label=f"car {car}")
