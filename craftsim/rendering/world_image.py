"""Pictures of the grid, quickly: for environments, and beside a film."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import chain
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.drawing import INK, Rgb
from craftsim.discrete.grid import Cell, Grid
from craftsim.rendering.shapes import Outline, Wanted, Word, car_shapes, level_shapes

CELL_PX: Final = 48
MARGIN_PX: Final = 24
"""Around each level, for coordinates and titles."""
_BITS: Final = 4
"""Of a pixel's fraction, as OpenCV takes places."""
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX


def world_image(
    grid: Grid,
    goal: Cell | None = None,
    levels: Sequence[int] | None = None,
    design: Collection[Wanted] = (),
    shifts: Mapping[int, tuple[float, float]] | None = None,
) -> NDArray[np.uint8]:
    """Return a picture (height, width, 3), RGB, of levels side by side, the lowest at the left.

    Args:
        grid: the world.
        goal: a cell to be framed.
        levels: those to be shown. All that there are and the one on top of them unless given, so that all pictures of
            a world have one size.
        design: cells of a building, to be framed with dashes.
        shifts: how far cars on their way have come from their cells, along x and y.
    """
    length, width, height = grid.size
    shown = range(1, height + 2) if levels is None else levels
    pitch = length * CELL_PX + MARGIN_PX
    image = np.full((width * CELL_PX + 2 * MARGIN_PX, len(shown) * pitch + MARGIN_PX, 3), 255, np.uint8)
    for column, z in enumerate(shown):
        # Views of the same bytes: OpenCV draws into them.
        tile = image[:, column * pitch : (column + 1) * pitch + MARGIN_PX]
        part = np.ascontiguousarray(tile)
        for one in chain(level_shapes(grid, z, goal, design), car_shapes(grid, z, shifts)):
            _paint(part, one, width)
        _letter(part, MARGIN_PX + length * CELL_PX // 2, MARGIN_PX // 2, f"level {z}", 9, INK)
        for x in range(length):
            at = MARGIN_PX + x * CELL_PX + CELL_PX // 2
            _letter(part, at, image.shape[0] - MARGIN_PX // 2, str(x), 8, INK)
        for y in range(width):
            at = MARGIN_PX + (width - 1 - y) * CELL_PX + CELL_PX // 2
            _letter(part, MARGIN_PX // 2, at, str(y), 8, INK)
        tile[:] = part
    return image


def _paint(image: NDArray[np.uint8], one: Outline | Word, width: int) -> None:
    if isinstance(one, Word):
        x, y = _pixels(np.array([(one.x, one.y)]), width)[0]
        _letter(image, round(x), round(y), one.text, round(one.height * CELL_PX), one.colour)
        return
    points = np.round(_pixels(one.points, width) * (1 << _BITS)).astype(np.int32)
    if one.fill is not None:
        cv2.fillPoly(image, [points], _bytes(one.fill), cv2.LINE_AA, _BITS)
    if one.line is not None:
        thick = max(1, round(one.width * CELL_PX))
        closed = one.fill is not None
        cv2.polylines(image, [points], closed, _bytes(one.line), thick, cv2.LINE_AA, _BITS)


def _pixels(points: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Return where in a level's picture places are."""
    x = MARGIN_PX + (points[:, 0] + 0.5) * CELL_PX
    y = MARGIN_PX + (width - 0.5 - points[:, 1]) * CELL_PX
    return np.stack([x, y], axis=1)


def _letter(image: NDArray[np.uint8], x: int, y: int, text: str, height_px: int, colour: Rgb) -> None:
    """Write a text, centred."""
    scale = cv2.getFontScaleFromHeight(_FONT, height_px)
    (wide, high), _ = cv2.getTextSize(text, _FONT, scale, 1)
    place = (x - wide // 2, y + high // 2)
    cv2.putText(image, text, place, _FONT, scale, _bytes(colour), 1, cv2.LINE_AA)


def _bytes(colour: Rgb) -> tuple[int, int, int]:
    red, green, blue = (round(255 * part) for part in colour)
    return red, green, blue
