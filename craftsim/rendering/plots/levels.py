"""The levels of a world as matplotlib draws them, and the picture of a blueprint."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch, Polygon

from craftsim.discrete.drawing import GOAL, KIND_COLOURS, LINE, car_colour
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece
from craftsim.discrete.kinds import STANDING
from craftsim.rendering.grid_picture import Outline, car_shapes, level_shapes, levels_of
from craftsim.rendering.plots.style import DPI, WIDTH_IN, line_of, paper, save

_CELL_IN: Final = (0.16, 0.5)  # the smallest and the largest side of a cell
_MARGIN_IN: Final = 0.45  # beside and below a level, for its coordinates and title
CARS_ZORDER: Final = 4.0
"""Place of cars in the order of drawing (zorder); that of lines is 2."""
_POINTS: Final = 72.0  # in an inch
_LEAST_WIDTH_IN: Final = 4.2
_HEAD_IN: Final = 0.3
_LEGEND_IN: Final = 0.4


def _arranged(size: Cell, n_levels: int) -> tuple[int, int, float]:
    """Return rows, columns and the side of a cell in inches: levels are side by side while cells stay legible."""
    length = size[0]
    smallest = _CELL_IN[0]
    columns = max(1, min(n_levels, int(WIDTH_IN / (length * 2 * smallest + _MARGIN_IN))))
    cell_in = max(smallest, min(_CELL_IN[1], WIDTH_IN / columns / length - _MARGIN_IN / length))
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
    diagrams = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in diagrams[len(levels) :]:
        axes.set_axis_off()
    axes_of = dict(zip(levels, diagrams, strict=False))
    for z, axes in axes_of.items():
        for shapes, above in (
            (level_shapes(grid, z, goal, design), 1.0),
            (car_shapes(grid, z), CARS_ZORDER),
        ):
            for number, outline in enumerate(shapes):
                _draw(axes, outline, cell_in, above + number * 1e-6)
        _coordinates(axes, grid.size)
        axes.set_title(f"level {z}")
    return axes_of


def _coordinates(axes: Axes, size: Cell) -> None:
    length, width, _ = size
    axes.set(xlim=(-0.55, length - 0.45), ylim=(-0.55, width - 0.45), aspect="equal")
    axes.set(xticks=range(0, length, _tick_step(length)), yticks=range(0, width, _tick_step(width)))
    axes.set_xlabel("x", labelpad=0)
    axes.set_ylabel("y", labelpad=3, rotation=0, ha="right", va="center")
    axes.tick_params(length=0, pad=1)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


def _tick_step(n_cells: int) -> int:
    if n_cells <= 12:
        return 1
    if n_cells <= 24:
        return 2
    return 5


def _draw(axes: Axes, outline: Outline, cell_in: float, order: float) -> None:
    width = outline.width * cell_in * _POINTS
    if outline.text:
        # A capital letter is 0.72 of a font's size.
        look: dict[str, Any] = {"fontsize": width / 0.72, "color": outline.line, "weight": "bold"}
        x, y = outline.points[0]
        axes.text(x, y, outline.text, **look, ha="center", va="center_baseline", zorder=order)
    elif outline.fill is None:
        ends: dict[str, Any] = {"solid_capstyle": "butt", "solid_joinstyle": "miter"}
        axes.plot(*outline.points.T, color=outline.line, lw=width, zorder=order, **ends)
    else:
        edge, width = ("none", 0.0) if outline.line is None else (outline.line, width)
        axes.add_patch(
            Polygon(outline.points, facecolor=outline.fill, edgecolor=edge, lw=width, zorder=order)
        )


def _legend(grid: Grid, goal: Cell | None, design: Collection[Piece]) -> Iterator[Patch]:
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
        yield Patch(
            facecolor=car_colour(0), edgecolor=LINE, lw=0.6, label="car, white at its front"
        )
    if grid.cars[:, CarField.LOAD].any():
        yield Patch(
            facecolor="none", edgecolor=KIND_COLOURS[Kind.BLOCK], lw=2, label="what a car carries"
        )
    if design:
        yield Patch(facecolor="none", edgecolor=GOAL, lw=1.4, ls=(0, (2, 1)), label="to be built")
    if goal is not None:
        yield Patch(facecolor="none", edgecolor=GOAL, lw=1.6, label="goal of the flag")


def draw_blueprint(
    path: Path, grid: Grid, title: str, goal: Cell | None = None, design: Collection[Piece] = ()
) -> Path:
    """Draw the used levels of a world, a flag's goal and a design into a PNG file; return its path."""
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
            figure.legend(
                handles=legend, loc="outside lower center", ncols=columns, handlelength=1.2
            )
        return save(figure, path)
