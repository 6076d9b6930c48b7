"""Text in pictures."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Literal

from PIL import ImageDraw, ImageFont

Colour = tuple[int, int, int]
Weight = Literal["regular", "bold"]
Font = ImageFont.FreeTypeFont


@lru_cache(maxsize=32)
def font(size: int, weight: Weight = "regular") -> Font:
    """Return DejaVu Sans, which comes with Matplotlib, ``size`` pixels high."""
    import matplotlib  # here, since most of what imports this module draws no text

    name = "DejaVuSans-Bold.ttf" if weight == "bold" else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path(), "fonts", "ttf", name), size)


def wrap(draw: ImageDraw.ImageDraw, text: str, face: Font, width: int, most: int) -> list[str]:
    """Return a text in lines that fit into a width in pixels, ``most`` of them at most; what is left out shows as an
    ellipsis, and a word that is too long is broken."""
    lines: list[str] = []
    line = ""
    for word in text.split():
        while True:
            joined = f"{line} {word}" if line else word
            if draw.textlength(joined, face) <= width:
                line, word = joined, ""
            elif not line:
                fits = next(
                    n for n in range(len(word), 0, -1) if n == 1 or draw.textlength(word[:n], face) <= width
                )
                line, word = word[:fits], word[fits:]
            if not word:
                break
            lines.append(line)
            line = ""
    lines += [line] if line else []
    if len(lines) > most:
        lines = [*lines[: most - 1], lines[most - 1] + "\N{HORIZONTAL ELLIPSIS}"]
    return lines
