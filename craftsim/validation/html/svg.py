"""Drawings as inline SVG: the same bytes for the same data, in the colours and letters of the page."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final

from markupsafe import Markup, escape

from craftsim.rendering.plots.style import DENSE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_VARIABLES: Final = ("ink", "soft", "line", "paper", "good", "caution", "bad", "accent", "muted")
"""The page's own colours, light or dark, that take the places of colours that nobody would draw with."""
INK, SOFT, GRID, PAPER, GOOD, CAUTION, BAD, ACCENT, MUTED = (f"#{3 * f'0{n}'}" for n in range(1, 10))

_STYLE: Final = Path(__file__).with_name("template") / "drawing.mplstyle"


class Canvas:
    """A figure; :attr:`svg` holds the drawing after it is closed."""

    def __init__(self, width_in: float, height_in: float) -> None:
        """Make an empty figure, without pyplot's global list of figures."""
        from matplotlib.figure import Figure

        self.figure = Figure(figsize=(width_in, height_in), layout="constrained")
        self.svg = Markup()

    @cached_property
    def axes(self) -> Axes:
        """The one pair of axes, where there is to be one."""
        return self.figure.subplots()


@contextmanager
def canvas(width_in: float, height_in: float, label: str, dense: bool = False) -> Iterator[Canvas]:
    """Yield a canvas to draw on; ``label`` is what a reader hears who cannot see the drawing.

    A dense one is for many diagrams in a figure: letters and lines are small.
    """
    from matplotlib import style

    with style.context([_STYLE, DENSE if dense else {}], after_reset=True):
        drawing = Canvas(width_in, height_in)
        yield drawing
        buffer = io.StringIO()
        drawing.figure.savefig(
            buffer, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type"))
        )
        drawing.svg = _inline(buffer.getvalue(), label)


def _inline(text: str, label: str) -> Markup:
    """Return a drawing without what only a file of its own needs, coloured by the page's variables."""
    body = text[text.index("<svg") :]
    body = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", body, count=1, flags=re.DOTALL)
    body = re.sub(r'<g id="[^"]*"', "<g", body)
    body = re.sub(r"(?<=: )#(0[1-9])\1\1\b", lambda found: f"var(--{_VARIABLES[int(found[1]) - 1]})", body)
    return Markup(body.replace("<svg ", f'<svg role="img" aria-label="{escape(label)}" ', 1).strip())
