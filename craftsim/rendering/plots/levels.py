"""The levels of a world as matplotlib draws them: the picture of a blueprint, and the paths of cars from above."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from craftsim.discrete.drawing import GOAL, INK, KIND_COLOURS, LINE, car_colour
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece
from craftsim.discrete.kinds import STANDING
from craftsim.rendering.grid_picture import Outline, car_shapes, level_shapes, levels_of
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
from craftsim.rendering.plots.style import DPI, WIDTH_IN, dash, line_of, paper, save
from craftsim.rendering.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.patches import Patch

_CELL_IN: Final = (0.16, 0.5)
"""The smallest and the largest side of a cell."""
_MARGIN_IN: Final = 0.45
"""Beside and below a level, for its coordinates and title."""
CARS: Final = 4.0
"""Place of cars in the order of drawing (zorder); that of lines is 2."""
_POINTS: Final = 72.0
"""In an inch."""
_LEAST_WIDTH_IN: Final = 4.2
_HEAD_IN: Final = 0.3
_LEGEND_IN: Final = 0.4


def _arranged(size: Cell, n_levels: int) -> tuple[int, int, float]:
    """Return rows, columns and the side of a cell in inches: levels are side by side while cells stay legible."""
    length, least = size[0], _CELL_IN[0]
    columns = max(1, min(n_levels, int(WIDTH_IN / (length * 2 * least + _MARGIN_IN))))
    cell_in = max(least, min(_CELL_IN[1], WIDTH_IN / columns / length - _MARGIN_IN / length))
    return math.ceil(n_levels / columns), columns, cell_in


def size_in(size: Cell, n_levels: int) -> tuple[float, float]:
    """Return width and height of a drawing of levels."""
    rows, columns, cell_in = _arranged(size, n_levels)
    return columns * (size[0] * cell_in + _MARGIN_IN), rows * (size[1] * cell_in + _MARGIN_IN)


def draw_levels(
    figure: Figure | SubFigure,
    grid: Grid,
    levels: Sequence[int],
    goal: Cell | None = None,
    design: Collection[Piece] = (),
) -> dict[int, Axes]:
    """Draw levels of a world, each in a diagram of its own with the coordinates of cells; return these by level."""
    rows, columns, cell_in = _arranged(grid.size, len(levels))
    found = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in found[len(levels) :]:
        axes.set_axis_off()
    drawn = dict(zip(levels, found, strict=False))
    for z, axes in drawn.items():
        for shapes, above in ((level_shapes(grid, z, goal, design), 1.0), (car_shapes(grid, z), CARS)):
            for number, one in enumerate(shapes):
                _draw(axes, one, cell_in, above + number * 1e-6)
        _coordinates(axes, grid.size)
        axes.set_title(f"level {z}")
    return drawn


def _coordinates(axes: Axes, size: Cell) -> None:
    length, width, _ = size
    axes.set(xlim=(-0.55, length - 0.45), ylim=(-0.55, width - 0.45), aspect="equal")
    axes.set_xticks(_ticks(length))
    axes.set_yticks(_ticks(width))
    axes.set_xlabel("x", labelpad=0)
    axes.set_ylabel("y", labelpad=3, rotation=0, ha="right", va="center")
    axes.tick_params(length=0, pad=1)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _ticks(count: int) -> list[int]:
    return list(range(0, count, 1 if count <= 12 else 2 if count <= 24 else 5))


def _draw(axes: Axes, one: Outline, cell_in: float, order: float) -> None:
    from matplotlib.patches import Polygon

    width = one.width * cell_in * _POINTS
    if one.text:
        # A capital letter is 0.72 of a font's size.
        look: dict[str, Any] = {
            "fontsize": width / 0.72,
            "color": one.line,
            "weight": "bold",
            "zorder": order,
        }
        x, y = one.points[0]
        axes.text(x, y, one.text, **look, ha="center", va="center_baseline")
    elif one.fill is None:
        ends: dict[str, Any] = {"solid_capstyle": "butt", "solid_joinstyle": "miter"}
        axes.plot(*one.points.T, color=one.line, lw=width, zorder=order, **ends)
    else:
        edge, width = ("none", 0.0) if one.line is None else (one.line, width)
        axes.add_patch(Polygon(one.points, facecolor=one.fill, edgecolor=edge, lw=width, zorder=order))


def _legend(grid: Grid, goal: Cell | None, design: Collection[Piece]) -> Iterator[Patch]:
    """Yield what the signs mean that a world's picture has."""
    from matplotlib.patches import Patch

    kinds = {Kind(int(kind)) for kind in np.unique(grid.kind)}
    named = {
        Kind.BLOCK: "block",
        Kind.FSLOPE: "folded slope",
        Kind.GEAR: "its gear",
        Kind.BODY: "slope, upper half",
        Kind.FOOT: "slope, lower half",
        Kind.FLAG: "flag",
        Kind.WALL: "wall",
    }
    named = {kind: kind.name.lower() for kind in kinds.intersection(STANDING)} | named
    for kind, words in named.items():
        if kind in kinds:
            yield Patch(facecolor=KIND_COLOURS[kind], edgecolor=LINE, lw=0.6, label=words)
    if grid.n_cars:
        yield Patch(facecolor=car_colour(0), edgecolor=LINE, lw=0.6, label="car, white at its front")
    if grid.cars[:, CarField.LOAD].any():
        yield Patch(facecolor="none", edgecolor=KIND_COLOURS[Kind.BLOCK], lw=2, label="what a car carries")
    if design:
        yield Patch(facecolor="none", edgecolor=GOAL, lw=1.4, ls=(0, (2, 1)), label="to be built")
    if goal is not None:
        yield Patch(facecolor="none", edgecolor=GOAL, lw=1.6, label="goal of the flag")


def draw_blueprint(
    path: Path, grid: Grid, title: str, goal: Cell | None = None, design: Collection[Piece] = ()
) -> Path:
    """Draw a world into a PNG file, level by level, without empty levels.

    Args:
        path: of the file.
        grid: the world.
        title: what it is called.
        goal: where a flag is to go.
        design: cells of the building that is to be put up.

    Returns the path; raises InputError where the disk does not take it.
    """
    from matplotlib.figure import Figure

    levels = levels_of([grid], goal, design)
    legend = list(_legend(grid, goal, design))
    width_in, height_in = size_in(grid.size, len(levels))
    width_in = max(_LEAST_WIDTH_IN, width_in)
    height_in += _HEAD_IN + _LEGEND_IN * bool(legend)
    with paper():
        figure = Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained")
        figure.suptitle(line_of(title), fontsize=9, weight="bold")
        draw_levels(figure, grid, levels, goal, design)
        if legend:
            columns = min(len(legend), max(2, int(width_in / 1.5)))
            figure.legend(handles=legend, loc="outside lower center", ncols=columns, handlelength=1.2)
        return save(figure, path)


# The paths of cars over the world as it was at the start, and where actions failed.

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
