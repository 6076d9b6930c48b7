"""Drawings as inline SVG: the same bytes for the same data, in the colours and letters of the page."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

INK: Final = "#010101"
SOFT: Final = "#020202"
GRID: Final = "#030303"
PAPER: Final = "#040404"
GOOD: Final = "#050505"
CAUTION: Final = "#060606"
BAD: Final = "#070707"
ACCENT: Final = "#080808"
MUTED: Final = "#090909"

_VARIABLES: Final = {
    INK: "var(--ink)",
    SOFT: "var(--soft)",
    GRID: "var(--line)",
    PAPER: "var(--paper)",
    GOOD: "var(--good)",
    CAUTION: "var(--caution)",
    BAD: "var(--bad)",
    ACCENT: "var(--accent)",
    MUTED: "var(--muted)",
}
"""Colours that nobody would draw with, and the page's own that take their places, light or dark."""

_SETTINGS: Final[dict[str, Any]] = {
    "svg.hashsalt": "craftsim",
    "svg.fonttype": "none",
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "text.parse_math": False,
    "text.color": INK,
    "axes.edgecolor": GRID,
    "axes.labelcolor": SOFT,
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": GRID,
    "ytick.color": GRID,
    "xtick.labelcolor": SOFT,
    "ytick.labelcolor": INK,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "legend.frameon": False,
    "legend.labelcolor": INK,
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "patch.linewidth": 0,
}


class Canvas:
    """A figure with one pair of axes; :attr:`svg` holds the drawing after it is closed."""

    def __init__(self, width_in: float, height_in: float) -> None:
        """Make an empty figure, without pyplot's global list of figures."""
        from matplotlib.figure import Figure

        self.figure = Figure(figsize=(width_in, height_in), layout="constrained")
        self.axes = self.figure.subplots()
        self.svg = ""


@contextmanager
def canvas(width_in: float, height_in: float, label: str) -> Iterator[Canvas]:
    """Yield a canvas to draw on; ``label`` is what a reader hears who cannot see the drawing."""
    from matplotlib import style

    with style.context(_SETTINGS, after_reset=True):
        drawing = Canvas(width_in, height_in)
        yield drawing
        buffer = io.StringIO()
        drawing.figure.savefig(
            buffer, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type"))
        )
        drawing.svg = _inline(buffer.getvalue(), label)


def _inline(text: str, label: str) -> str:
    """Return a drawing without what only a file of its own needs, coloured by the page's variables."""
    from markupsafe import escape

    body = text[text.index("<svg") :]
    body = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", body, count=1, flags=re.DOTALL)
    body = re.sub(r'<g id="[^"]*"', "<g", body)
    body = re.sub(r"(?<=: )#0\d0\d0\d\b", lambda match: _VARIABLES.get(match[0], match[0]), body)
    return body.replace("<svg ", f'<svg role="img" aria-label="{escape(label)}" ', 1).strip()
