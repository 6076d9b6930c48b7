"""Drawings that reports share, and their colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from craftsim.storage.limits import shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK, SOFT, GRID, PAPER, GOOD, CAUTION, BAD, ACCENT, MUTED = (
    f"#{3 * f'0{n}'}" for n in range(1, 10)
)
"""Placeholders, which :mod:`craftsim.reports.html` replaces by the page's light or dark colours."""

_ROW_IN: Final = 0.27
"""Height of a row of :func:`interval_rows` and :func:`stacked_rows`."""
HEAD_IN: Final = 0.75
LONGEST_NAME: Final = 36


def rows_height_in(rows: int, row_in: float = _ROW_IN) -> float:
    """Return the height of a drawing with named rows."""
    return HEAD_IN + row_in * rows


def interval_rows(
    axes: Axes, rows: Mapping[str, tuple[float, float, float]], size: float = 6.0
) -> None:
    """Draw a row for each name: a value, and a bar between a lower and an upper bound."""
    for y, (value, low, high) in enumerate(rows.values()):
        axes.plot((low, high), (y, y), color=ACCENT, lw=4, alpha=0.35)
        axes.plot(value, y, "o", color=ACCENT, ms=size)
    name_rows(axes, list(rows))


def stacked_rows(
    axes: Axes, names: Sequence[str], parts: Mapping[str, tuple[str, Sequence[int]]]
) -> None:
    """Draw a stacked bar for each name; ``parts`` maps labels to a colour and the counts of all names."""
    from matplotlib.ticker import MaxNLocator

    starts = np.zeros(len(names))
    for label, (colour, counts) in parts.items():
        axes.barh(range(len(names)), counts, left=starts, height=0.62, color=colour, label=label)
        starts += np.asarray(counts)
    name_rows(axes, names)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.2, handlelength=1)


def name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Name the rows of a drawing, the first at the top."""
    axes.set_yticks(range(len(names)), [shorten(name, LONGEST_NAME) for name in names])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    axes.spines["left"].set_visible(False)


def percent_ticks(value: float, _: float) -> str:
    """Format a tick as a percentage."""
    return f"{100 * value:.0f} %"
