"""How cars moved, from above: their paths over the world as it was at the start, and where actions failed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.discrete.drawing import INK, car_colour
from craftsim.rendering.grid_picture import levels_of
from craftsim.rendering.plots.levels import CARS, Arrangement, draw_levels
from craftsim.rendering.plots.signals import CarSignals, Signals, end_s, path_points
from craftsim.rendering.plots.style import WIDTH_IN, dash
from craftsim.rendering.plots.timeline import NOTE_IN, mark, notes_of, write_notes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

_FOOT_IN: Final = 0.15
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


def paths_height_in(signals: Signals) -> float:
    """Return the height of the drawing of paths."""
    legend = _LEGEND_IN * math.ceil(len(signals.cars) / _LEGEND_COLUMNS)
    return _arranged(signals).height_in + _FOOT_IN + legend + NOTE_IN * len(notes_of(signals.failures))


def draw_paths(figure: Figure | SubFigure, signals: Signals) -> None:
    """Draw each car's way over the world at the start, level by level, with the design and where actions failed."""
    from matplotlib.lines import Line2D

    recipe = signals.trajectory.story.recipe
    goal = recipe.goals[0] if recipe.goals and not signals.design else None
    levels = _levels(signals)
    by_level = draw_levels(figure, recipe.grid, levels, _arranged(signals), goal, signals.design)
    for car in signals.cars:
        _draw_path(by_level, car)
    for number, attempt in enumerate(signals.failures, 1):
        _mark(by_level, signals, attempt, number)
    handles = [Line2D([], [], label=f"car {car.car}", **_style(car.car)) for car in signals.cars]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=min(_LEGEND_COLUMNS, len(handles)), handlelength=3
    )
    write_notes(figure, signals)


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
            style = _style(car.car)
            axes.plot(*here.T, color="white", lw=style["lw"] + 1.4, solid_capstyle="butt")
            axes.plot(*here.T, **style)
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
    at = signals.trajectory.at(end_s(attempt))
    car = signals.cars[attempt.car]
    axes = by_level[int(_level(car)[at])]
    x, y = car.place[at, :2]
    axes.plot(x, y, "X", ms=9, mfc="white", mec=INK, mew=1.4, zorder=CARS + 2)
    box = {"facecolor": "white", "alpha": 0.8, "pad": 0.6}
    look: dict[str, Any] = {"weight": "bold", "color": INK, "zorder": CARS + 2, "bbox": box}
    axes.annotate(mark(number), (x, y), (6, 4), textcoords="offset points", **look)


def _style(car: int) -> dict[str, Any]:
    return {"color": car_colour(car), "lw": _WIDTHS[min(car, len(_WIDTHS) - 1)], "ls": dash(car)}
