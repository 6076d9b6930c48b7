"""The picture of a blueprint: its levels with coordinates, a title and a legend."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Final

from craftsim.discrete.grid import Cell, Grid
from craftsim.rendering.plots.levels import Arrangement, draw_levels, legend_of
from craftsim.rendering.plots.style import WIDTH_IN, line_of, paper
from craftsim.rendering.shapes import Wanted, levels_of
from craftsim.storage.writing import whole

_DPI: Final = 200
_LEAST_WIDTH_IN: Final = 4.2
_HEAD_IN: Final = 0.3
_LEGEND_IN: Final = 0.4


def draw_blueprint(
    path: Path, grid: Grid, title: str, goal: Cell | None = None, design: Collection[Wanted] = ()
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
    arrangement = Arrangement(grid.size, len(levels), WIDTH_IN)
    legend = legend_of(grid, goal, design)
    size = (
        max(_LEAST_WIDTH_IN, arrangement.width_in),
        arrangement.height_in + _HEAD_IN + _LEGEND_IN * bool(legend),
    )
    with paper():
        figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
        figure.suptitle(line_of(title), fontsize=9, weight="bold")
        draw_levels(figure, grid, levels, arrangement, goal, design)
        if legend:
            columns = min(len(legend), max(2, int(size[0] / 1.5)))
            figure.legend(handles=legend, loc="outside lower center", ncols=columns, handlelength=1.2)
        with whole(path) as partial:
            figure.savefig(partial, dpi=_DPI, metadata={"Software": None})
    return path
