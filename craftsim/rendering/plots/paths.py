"""The paths of cars from above, over the world as it was at the start, and where actions failed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from craftsim.discrete.drawing import INK, car_colour
from craftsim.rendering.grid_picture import levels_of
from craftsim.rendering.plots.levels import CARS, draw_levels, size_in
from craftsim.rendering.plots.signals import (
    NOTE_IN,
    Floats,
    end_s,
    failures_of,
    mark,
    notes_of,
    path_points,
    place_of,
    write_notes,
)
from craftsim.rendering.plots.style import dash
from craftsim.rendering.trajectory import Trajectory

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
_LEGEND_ROW_IN: Final = 0.16
_WIDTHS: Final = (2.6, 2.0, 1.5, 1.1)
"""Of lines in points, car after car, so that one shows below another."""


def paths_height_in(trajectory: Trajectory) -> float:
    """Return the height of the drawing of paths."""
    _, height_in = size_in(trajectory.story.recipe.grid.size, len(_shown_levels(trajectory)))
    legend = _LEGEND_ROW_IN * math.ceil(len(trajectory.physics.cars) / _LEGEND_COLUMNS)
    return height_in + _FOOT_IN + legend + NOTE_IN * len(notes_of(trajectory))


def draw_paths(figure: Figure | SubFigure, trajectory: Trajectory) -> None:
    """Draw each car's way over the world at the start, level by level, with the design and where actions failed."""
    from matplotlib.lines import Line2D

    recipe, design = trajectory.story.recipe, trajectory.wanted
    goal = recipe.goals[0] if recipe.goals and not design else None
    by_level = draw_levels(figure, recipe.grid, _shown_levels(trajectory), goal, design)
    cars = range(len(trajectory.physics.cars))
    for car in cars:
        _draw_path(by_level, place_of(trajectory, car), car)
    for number, attempt in enumerate(failures_of(trajectory), 1):
        _mark(by_level, place_of(trajectory, attempt.car)[trajectory.at(end_s(attempt))], number)
    handles = [Line2D([], [], label=f"car {car}", **_style(car)) for car in cars]
    figure.legend(
        handles=handles, loc="outside upper center", ncols=min(_LEGEND_COLUMNS, len(handles)), handlelength=3
    )
    write_notes(figure, trajectory)


def _shown_levels(trajectory: Trajectory) -> tuple[int, ...]:
    """Return the levels on which there is anything, or any car's path: a point is on the nearest."""
    visited = {
        int(z)
        for car in range(len(trajectory.physics.cars))
        for z in np.unique(np.round(place_of(trajectory, car)[:, 2]))
    }
    return tuple(sorted({*levels_of([trajectory.story.recipe.grid], None, trajectory.wanted), *visited}))


def _draw_path(by_level: dict[int, Axes], place: Floats, car: int) -> None:
    place = place[path_points(place)]
    level = np.round(place[:, 2]).astype(int)
    for z, axes in by_level.items():
        here = np.where((level == z)[:, None], place[:, :2], np.nan)
        if np.isfinite(here).any():
            style = _style(car)
            axes.plot(*here.T, color="white", lw=style["lw"] + 1.4, solid_capstyle="butt")
            axes.plot(*here.T, **style)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place[:, :2], axis=0), axis=1))])
    for at in np.arange(0.5, way[-1], max(_ARROW_EVERY, way[-1] / _MOST_ARROWS)):
        i = int(np.searchsorted(way, at))
        ahead = place[i, :2] - place[i - 1, :2]
        _arrow(by_level[int(level[i])], place[i, :2], ahead / np.linalg.norm(ahead), car)
    if way[-1] > _STAYED:
        _end(by_level[int(level[-1])], place[-1, :2], car)


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


def _mark(by_level: dict[int, Axes], place: Floats, number: int) -> None:
    """Mark the place (3,) at which an action failed."""
    axes, (x, y) = by_level[round(place[2])], place[:2]
    axes.plot(x, y, "X", ms=9, mfc="white", mec=INK, mew=1.4, zorder=CARS + 2)
    box = {"facecolor": "white", "alpha": 0.8, "pad": 0.6}
    look: dict[str, Any] = {"weight": "bold", "color": INK, "zorder": CARS + 2, "bbox": box}
    axes.annotate(mark(number), (x, y), (6, 4), textcoords="offset points", **look)


def _style(car: int) -> dict[str, Any]:
    return {"color": car_colour(car), "lw": _WIDTHS[min(car, len(_WIDTHS) - 1)], "ls": dash(car)}
