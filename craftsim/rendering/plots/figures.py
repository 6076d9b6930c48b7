"""The figures of a recorded run: each by itself, or all on one page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from craftsim.rendering.plots.paths import draw_paths, paths_height_in
from craftsim.rendering.plots.signals import Signals
from craftsim.rendering.plots.style import WIDTH_IN, line_of, paper
from craftsim.rendering.plots.timeline import (
    Diagram,
    board_rows,
    contact_rows,
    draw_rows,
    height_in,
    torque_rows,
    tracking_rows,
)
from craftsim.storage.folders import output_directory
from craftsim.storage.writing import whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

FORMATS: Final = ("pdf", "png")
PAGE: Final = "all"
"""Name of the page with all figures."""
_MOST_POINTS: Final = 3000
"""Of a line on paper."""
_DPI: Final = 200
_TITLE_IN: Final = 0.3

_ROWS: Final[dict[str, tuple[Callable[[Signals], list[Diagram]], str]]] = {
    "tracking": (tracking_rows, "How far each car was from its path; bands are its actions."),
    "torques": (torque_rows, "Wheel torques against their limit; gaps are where a car sleeps."),
    "boards": (board_rows, "Boards and hinges; no force is worked out while a car sleeps."),
    "contact": (contact_rows, "The largest force between any two machines, against its limit."),
}


class Plot(NamedTuple):
    """A figure that can be drawn of a run."""

    name: str
    caption: str
    height_in: float
    draw: Callable[[Figure | SubFigure], None]


def plots_of(signals: Signals, most: int = _MOST_POINTS) -> list[Plot]:
    """Return the figures that there are of a run, their lines of about ``most`` points at most."""
    caption = "Each car's way from above, over the world as it was at the start."
    plots = [Plot("paths", caption, paths_height_in(signals), lambda figure: draw_paths(figure, signals))]
    for name, (make, caption) in _ROWS.items():
        if rows := make(signals):
            plots.append(_over_time(name, caption, signals, rows, most))
    return plots


def _over_time(name: str, caption: str, signals: Signals, rows: Sequence[Diagram], most: int) -> Plot:
    height = height_in(signals, rows)
    return Plot(name, caption, height, lambda figure: draw_rows(figure, signals, rows, most))


def write_figures(folder: Path, signals: Signals) -> Iterator[Path]:
    """Write each figure of a run as PDF and PNG into a folder, and all on one page as PDF; yield the paths.

    Raises InputError where the disk does not take it.
    """
    from matplotlib.figure import Figure

    output_directory(folder)
    with paper():
        plots = plots_of(signals)
        for plot in plots:
            figure = Figure(figsize=(WIDTH_IN, plot.height_in), layout="constrained")
            plot.draw(figure)
            for ending in FORMATS:
                yield _save(figure, folder / f"{plot.name}.{ending}")
        rows = [row for make, _ in _ROWS.values() for row in make(signals)]
        on_page = plots[0], _over_time(PAGE, "", signals, rows, _MOST_POINTS)
        heights = [plot.height_in for plot in on_page]
        page = Figure(figsize=(WIDTH_IN, sum(heights) + _TITLE_IN), layout="constrained")
        page.suptitle(line_of(signals.trajectory.story.title), fontsize=10, weight="bold")
        parts = page.subfigures(2, 1, squeeze=False, height_ratios=heights)
        for plot, part in zip(on_page, parts[:, 0], strict=True):
            plot.draw(part)
        yield _save(page, folder / f"{PAGE}.pdf")


def _save(figure: Figure, path: Path) -> Path:
    # Neither a date nor a version of the library: the same run gives the same bytes.
    metadata = {"Software": None} if path.suffix == ".png" else {"CreationDate": None, "Producer": None}
    with whole(path) as partial:
        figure.savefig(partial, dpi=_DPI, metadata=metadata)
    return path
