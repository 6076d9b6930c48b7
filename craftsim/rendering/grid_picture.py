"""The grid seen from above: levels as polygons and words, which plots draw too, and quick pictures of them.

Lengths of shapes are in cells: the centre of cell (x, y) is at (x, y), with x to the right and y up.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain, product
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.drawing import (
    FLAG_POST,
    GOAL,
    INK,
    KIND_COLOURS,
    LINE,
    TRIM,
    TYRE_COLOUR,
    Rgb,
    car_colour,
    cars_by_cell,
)
from craftsim.discrete.geometry import yaw_angle
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece
from craftsim.discrete.kinds import STANDING

Points = NDArray[np.float64]
"""Shape (n, 2)."""

CELL_PX: Final = 48
MARGIN_PX: Final = 24
"""Around each level, for coordinates and titles."""
_WHITE: Final[Rgb] = (1.0, 1.0, 1.0)
_FRAME: Final = 0.44  # half the side of the frame around a goal cell
_DASHES: Final = 7  # of a side of a frame, and the gaps between them
_BITS: Final = 4  # of a pixel's fraction, as OpenCV takes places
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_ROUND: Final = np.array(
    [(math.cos(a), math.sin(a)) for a in np.linspace(0, 2 * math.pi, 24, endpoint=False)]
)
_NOSE: Final = np.array([(0.22, 0.13), (0.33, 0.0), (0.22, -0.13)])
_CHEVRON: Final = np.array([(-0.16, 0.20), (0.04, 0.0), (-0.16, -0.20)])


class Outline(NamedTuple):
    """A polygon, an open line where it is not filled, or a word that is centred at its only point."""

    points: Points
    fill: Rgb | None = None
    line: Rgb | None = None
    """Also of a word."""
    width: float = 0.02
    """Width of the line; height of a capital letter."""
    text: str = ""


def levels_of(
    grids: Iterable[Grid], goal: Cell | None = None, design: Collection[Piece] = ()
) -> tuple[int, ...]:
    """Return the levels on which anything is in one of the worlds, or is to be; the floor always."""
    used = {1, *(piece.cell[2] for piece in design), *([] if goal is None else [goal[2]])}
    for grid in grids:
        used |= {z for z in range(1, grid.size[2] + 1) if grid.kind[:, :, z].any()}
        used |= {int(z) for z in grid.cars[:, CarField.Z]}
    return tuple(sorted(used))


def level_shapes(
    grid: Grid, z: int, goal: Cell | None = None, design: Collection[Piece] = ()
) -> Iterator[Outline]:
    """Yield what is on a level but cars, in the order in which it is drawn: ground, things, designs."""
    length, width, _ = grid.size
    ground = _WHITE
    if z == 1:
        ground = KIND_COLOURS[Kind.GROUND]
    yield Outline(_box(-0.5, -0.5, length - 0.5, width - 0.5), fill=ground)
    for x in range(length + 1):
        yield Outline(np.array([(x - 0.5, -0.5), (x - 0.5, width - 0.5)]), line=LINE)
    for y in range(width + 1):
        yield Outline(np.array([(-0.5, y - 0.5), (length - 0.5, y - 0.5)]), line=LINE)
    if z <= grid.size[2]:
        for cell_x, cell_y in np.argwhere(grid.kind[:, :, z]):
            cell = (int(cell_x), int(cell_y), z)
            yield from _thing(grid.kind_at(cell), int(grid.yaw[cell]), cell)
    for piece in design:
        if piece.cell[2] == z:
            yield from _design_shapes(piece)
    if goal is not None and goal[2] == z:
        yield Outline(_closed(_square(goal, _FRAME)), line=GOAL, width=0.06)


def car_shapes(
    grid: Grid, z: int, shifts: Mapping[int, tuple[float, float]] | None = None
) -> Iterator[Outline]:
    """Yield the cars of a level; ``shifts`` are how far cars on their way have come from their cells, along x and y."""
    for cell, cars in cars_by_cell(grid).items():
        for car in cars if cell[2] == z else ():
            shift = np.array((shifts or {}).get(car, (0.0, 0.0)))
            yield from (
                outline._replace(points=outline.points + shift) for outline in _car(grid, car, cell)
            )


def _car(grid: Grid, car: int, cell: Cell) -> Iterator[Outline]:
    row = grid.cars[car]
    x, y, _ = cell
    load = Kind(row[CarField.LOAD])
    if load != Kind.AIR:
        for colour, width in ((INK, 0.13), (KIND_COLOURS[load], 0.09)):
            yield Outline(_closed(_square(cell, 0.38)), line=colour, width=width)
        if load == Kind.FSLOPE:
            tip = np.array([(0.36, 0.1), (0.47, 0.0), (0.36, -0.1)])
            yield Outline(_placed(tip, x, y, yaw_angle(int(row[CarField.LOAD_YAW]))), fill=INK)
    turn = yaw_angle(int(row[CarField.YAW]))
    for along, across in product((-0.2, 0.2), (-0.26, 0.26)):
        wheel = _box(along - 0.1, across - 0.06, along + 0.1, across + 0.06)
        yield Outline(_placed(wheel, x, y, turn), fill=TYRE_COLOUR)
    body = _box(-0.33, -0.2, 0.33, 0.2)
    yield Outline(_placed(body, x, y, turn), fill=car_colour(car), line=INK, width=0.015)
    yield Outline(_placed(_NOSE, x, y, turn), fill=_WHITE)
    yield Outline(np.array([(x, y)], np.float64), line=_WHITE, width=0.2, text=str(car))


def _thing(kind: Kind, yaw: int, cell: Cell) -> Iterator[Outline]:
    x, y, _ = cell
    colour = KIND_COLOURS[kind]
    turn = yaw_angle(yaw)
    match kind:
        case Kind.WALL:
            yield Outline(_square(cell, 0.5), fill=colour)
            for shift in (-0.5, 0.0, 0.5):
                ends = [(max(-0.5, shift - 0.5), max(-0.5, -shift - 0.5))]
                ends += [(min(0.5, shift + 0.5), min(0.5, 0.5 - shift))]
                yield Outline(_placed(np.array(ends), x, y), line=INK)
        case Kind.BLOCK:
            yield Outline(_square(cell, 0.45), fill=colour, line=TRIM, width=0.03)
            yield Outline(_closed(_square(cell, 0.33)), line=TRIM)
        case Kind.FLAG:
            yield Outline(_square(cell, 0.4), fill=FLAG_POST, line=INK)
            flag = np.array([(-0.18, 0.3), (0.26, 0.14), (-0.18, -0.02)])
            yield Outline(_placed(flag, x, y), fill=colour, line=INK)
            yield Outline(
                np.array([(x - 0.18, y + 0.32), (x - 0.18, y - 0.3)]), line=INK, width=0.05
            )
        case Kind.FSLOPE:
            yield Outline(_square(cell, 0.45), fill=colour, line=INK)
            yield Outline(_placed(_CHEVRON, x, y, turn), line=_WHITE, width=0.07)
        case Kind.GEAR:
            yield Outline(
                _placed(0.13 * _ROUND - np.array([0.4, 0]), x, y, turn), fill=colour, line=INK
            )
        case Kind.BODY | Kind.FOOT:
            if kind == Kind.BODY:
                low = -0.45
                high = 0.5
            else:
                low = -0.5
                high = 0.45
            yield Outline(_placed(_box(low, -0.45, high, 0.45), x, y, turn), fill=colour, line=INK)
            for along in (-0.14, 0.22):  # two signs that point downhill
                yield Outline(
                    _placed(_CHEVRON + np.array([along, 0]), x, y, turn), line=_WHITE, width=0.07
                )
        case _ if kind in STANDING:
            yield Outline(_square(cell, 0.45), fill=colour, line=INK)


def _design_shapes(piece: Piece) -> Iterator[Outline]:
    x, y, _ = piece.cell
    corners = _square(piece.cell, _FRAME)
    for first, second in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        marks = np.linspace(first, second, _DASHES + 1)
        for i in range(0, _DASHES, 2):
            yield Outline(marks[i : i + 2], line=GOAL, width=0.06)
    if piece.yaw >= 0:
        tip = np.array([(_FRAME - 0.14, 0.11), (_FRAME, 0.0), (_FRAME - 0.14, -0.11)])
        yield Outline(_placed(tip, x, y, yaw_angle(piece.yaw)), fill=GOAL)


def _box(low_x: float, low_y: float, high_x: float, high_y: float) -> Points:
    return np.array(
        [(low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y)], np.float64
    )


def _square(cell: Cell, half: float) -> Points:
    x, y, _ = cell
    return _box(x - half, y - half, x + half, y + half)


def _closed(points: Points) -> Points:
    return np.concatenate([points, points[:1]])


def _placed(points: Points, x: float, y: float, turn_rad: float = 0.0) -> Points:
    c = math.cos(turn_rad)
    s = math.sin(turn_rad)
    return points @ np.array([(c, s), (-s, c)]) + (x, y)


def world_image(
    grid: Grid,
    goal: Cell | None = None,
    levels: Sequence[int] | None = None,
    design: Collection[Piece] = (),
    shifts: Mapping[int, tuple[float, float]] | None = None,
) -> NDArray[np.uint8]:
    """Return a picture (height, width, 3), RGB, of levels side by side, the lowest at the left.

    ``goal`` is framed, ``design`` with dashes, and ``shifts`` say how far cars on their way have come from their cells,
    along x and y. All levels that there are and the one on top of them are shown, unless ``levels`` names them, so that
    all pictures of a world have one size.
    """
    length, width, height = grid.size
    shown_levels = range(1, height + 2) if levels is None else levels
    half = CELL_PX // 2
    pitch = length * CELL_PX + MARGIN_PX
    image = np.full(
        (width * CELL_PX + 2 * MARGIN_PX, len(shown_levels) * pitch + MARGIN_PX, 3), 255, np.uint8
    )
    for column, z in enumerate(shown_levels):
        # Views of the same bytes: OpenCV draws into them.
        tile = image[:, column * pitch : (column + 1) * pitch + MARGIN_PX]
        pixels = np.ascontiguousarray(tile)
        for outline in chain(level_shapes(grid, z, goal, design), car_shapes(grid, z, shifts)):
            _paint(pixels, outline, width)
        _letter(pixels, MARGIN_PX + length * CELL_PX // 2, MARGIN_PX // 2, f"level {z}", 9, INK)
        for x in range(length):
            at = MARGIN_PX + x * CELL_PX + half
            _letter(pixels, at, image.shape[0] - MARGIN_PX // 2, str(x), 8, INK)
        for y in range(width):
            _letter(
                pixels, MARGIN_PX // 2, MARGIN_PX + (width - 1 - y) * CELL_PX + half, str(y), 8, INK
            )
        tile[:] = pixels
    return image


def _paint(image: NDArray[np.uint8], outline: Outline, width: int) -> None:
    x, y = outline.points.T
    pixels = MARGIN_PX + np.stack([x + 0.5, width - 0.5 - y], axis=1) * CELL_PX
    thick = max(1, round(outline.width * CELL_PX))
    if outline.text:
        assert outline.line is not None
        x, y = pixels[0]
        _letter(image, round(x), round(y), outline.text, thick, outline.line)
        return
    points = np.round(pixels * (1 << _BITS)).astype(np.int32)
    if outline.fill is not None:
        cv2.fillPoly(image, [points], _bytes(outline.fill), cv2.LINE_AA, _BITS)
    if outline.line is not None:
        closed = outline.fill is not None
        cv2.polylines(image, [points], closed, _bytes(outline.line), thick, cv2.LINE_AA, _BITS)


def _letter(
    image: NDArray[np.uint8], x: int, y: int, text: str, height_px: int, colour: Rgb
) -> None:
    scale = cv2.getFontScaleFromHeight(_FONT, height_px)
    (wide, high), _ = cv2.getTextSize(text, _FONT, scale, 1)
    place = (x - wide // 2, y + high // 2)
    cv2.putText(image, text, place, _FONT, scale, _bytes(colour), 1, cv2.LINE_AA)


def _bytes(colour: Rgb) -> tuple[int, int, int]:
    red, green, blue = (round(255 * channel) for channel in colour)
    return red, green, blue
