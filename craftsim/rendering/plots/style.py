"""How figures look on paper, what tells cars apart where there are no colours, and figures into files."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from matplotlib import rcParams, style
from matplotlib.figure import Figure

from craftsim.storage.writing import whole, writable

WIDTH_IN: Final = 7.2
"""Of a figure: two columns of a paper."""
ROW_IN: Final = 1.15
"""Height of a diagram over time."""

DASHES: Final = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), (0, (3, 1.2)))
"""One a line of a diagram; lines beyond the last start over."""

_PAPER: Final = Path(__file__).with_name("paper.mplstyle")
DPI: Final = 200
_LEFT_OUT: Final[dict[str, dict[str, Any]]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None, "Producer": None},
}
"""By the ending of a file's name what is not to be written into it: the same figure gives the same bytes."""


@contextmanager
def paper() -> Iterator[None]:
    """Draw for paper within the block, whatever the user has set."""
    with style.context(_PAPER, after_reset=True), warnings.catch_warnings():
        # A name may have letters that the font lacks; boxes stand for them.
        warnings.filterwarnings("ignore", "Glyph .* missing")
        yield


def save(figure: Figure, path: Path) -> Path:
    """Write a figure into a PNG, SVG or PDF file and return its path; InputError where the disk does not take it."""
    with whole(path) as partial:
        figure.savefig(partial, dpi=DPI, metadata=_LEFT_OUT[path.suffix])
    return path


def line_of(text: str) -> str:
    """Return a text as one line that can be drawn, wherever it comes from."""
    return writable(" ".join(text.split()))


def shade(number: int) -> Any:
    """Return the colour of line ``number`` that belongs to no car: that of text, or a softer one."""
    return rcParams["axes.labelcolor" if number % 2 else "text.color"]


def dash(number: int) -> Any:
    """Return how line ``number`` of a diagram is dashed."""
    return DASHES[number % len(DASHES)]
