"""Where on a frame each view, and the captions beside them, have their place, and where insets hide nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import cv2
import numpy as np

from craftsim.compiled.arrays import Flags
from craftsim.models.cameras import box_corners
from craftsim.rendering.cameras import View, reached_m
from craftsim.rendering.trajectory import Trajectory

TileLayout = Literal["side", "main", "inset"]
"""Views of the same size side by side; the first one large and the others in a column beside it; or small ones in a
corner of the first one."""


_PANEL: Final = 0.26
"""Share of a wide frame's width for the captions, at least; of a tall frame's height it is a little more."""
_WIDEST_PANEL: Final = 0.4
"""The same at most, beside a single view that does not fill the remaining width."""
_FRAMED: Final = 1.15
"""Width of a picture over that of what it shows, with the coordinates beside it."""
_SHARES: Final = (0.5, 0.55, 0.6, 0.66, 0.72, 0.78)
"""Shares of a side that the large view may have beside smaller ones."""
_LEAST_SHARE: Final = 0.25  # of an equal part of a side, for a view that is narrow or flat
_INSETS: Final = (0.34, 0.28, 0.22)  # shares of the first view's sides that an inset may have
_GAP: Final = 4  # pixels between views
_MOMENTS: Final = 24  # of a trajectory, at which a camera that moves is looked through


class Tile(NamedTuple):
    """A rectangle of a frame, in pixels from its upper left corner."""

    left: int
    top: int
    width: int
    height: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.width, self.height

    @property
    def place(self) -> tuple[slice, slice]:
        """Its rows and columns of a frame."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)


def arrange(
    size: tuple[int, int],
    aspects: Sequence[float],
    layout: TileLayout,
    captions: bool,
    covered: Callable[[tuple[int, int]], Flags] | None = None,
    below: bool = False,
) -> tuple[list[Tile], Tile | None]:
    """Return the tiles of the views and of the captions in a frame of ``size`` (width, height).

    Views are placed so that what they show, of their own aspects (width over height), leaves little of the frame empty.
    Tiles do not overlap, but for insets, which lie on the first view where they hide nothing; without such a corner
    they are beside it: ``covered`` gives the pixels (height, width) of a first view of a size that none may hide.
    Captions are at the right; below in a tall frame, and where ``below`` asks for it.
    """
    n_views = len(aspects)
    width, height = size
    panel = None
    if captions and width >= height and not below:
        panel_px = round(_PANEL * width)
        if n_views == 1:
            unused_px = round(width - _FRAMED * aspects[0] * height)
            panel_px = max(panel_px, min(unused_px, round(_WIDEST_PANEL * width)))
        panel = Tile(width - panel_px, 0, panel_px, height)
        width -= panel_px
    elif captions:
        panel_px = round(1.2 * _PANEL * height)
        panel = Tile(0, height - panel_px, width, panel_px)
        height -= panel_px
    area = Tile(0, 0, width, height)
    if layout == "inset" and n_views > 1:
        if covered is None:
            mask = np.zeros((height, width), bool)
        else:
            mask = covered(area.size)
        for tiles in _corners(area, n_views - 1):
            if not any(mask[tile.place].any() for tile in tiles):
                return [area, *tiles], panel
    if layout != "side" and n_views > 1:
        candidates = list(_beside(area, aspects))
    else:
        candidates = [
            tiles_in_row(area, aspects),
            [
                _turned(tile)
                for tile in tiles_in_row(_turned(area), [1 / aspect for aspect in aspects])
            ],
            *(_grid(area, n_views, columns) for columns in range(1, n_views + 1)),
        ]
    return max(candidates, key=lambda tiles: _filled(tiles, aspects)), panel


def _filled(tiles: Sequence[Tile], aspects: Sequence[float]) -> float:
    pairs = zip(tiles, aspects, strict=True)
    return sum(min(t.width, t.height * a) * min(t.height, t.width / a) for t, a in pairs)


def _turned(tile: Tile) -> Tile:
    return Tile(tile.top, tile.left, tile.height, tile.width)


def tiles_in_row(area: Tile, aspects: Sequence[float]) -> list[Tile]:
    """Return tiles in one row, of widths as their aspects."""
    narrowest = _LEAST_SHARE * sum(aspects) / len(aspects)
    edges = np.cumsum([0.0, *(max(aspect, narrowest) for aspect in aspects)])
    lefts = (edges / edges[-1] * (area.width + _GAP)).round().astype(int).tolist()
    tiles = []
    for start, end in pairwise(lefts):
        tiles.append(Tile(area.left + start, area.top, end - start - _GAP, area.height))
    return tiles


def _beside(area: Tile, aspects: Sequence[float]) -> Iterator[list[Tile]]:
    n = len(aspects) - 1
    for share in _SHARES:
        first, remainder = tiles_in_row(area, (share, 1 - share))
        yield [first, *_grid(remainder, n, 1)]
        first, remainder = (
            _turned(tile) for tile in tiles_in_row(_turned(area), (share, 1 - share))
        )
        yield [first, *tiles_in_row(remainder, aspects[1:])]


def _corners(area: Tile, n: int) -> Iterator[list[Tile]]:
    for share in _INSETS:
        width = round(share * area.width)
        height = round(share * area.height)
        for right, lower in ((True, False), (False, False), (True, True), (False, True)):
            left_px = area.left + (area.width - width - 2 * _GAP if right else 2 * _GAP)
            if lower:
                first = area.height - n * (height + 2 * _GAP)
            else:
                first = 2 * _GAP
            tops = [area.top + first + i * (height + 2 * _GAP) for i in range(n)]
            if tops[0] >= area.top and tops[-1] + height <= area.top + area.height:
                yield [Tile(left_px, top, width, height) for top in tops]


def _grid(area: Tile, n: int, columns: int) -> list[Tile]:
    rows = math.ceil(n / columns)
    width = (area.width - _GAP * (columns - 1)) // columns
    height = (area.height - _GAP * (rows - 1)) // rows
    corners = [((i % columns) * (width + _GAP), (i // columns) * (height + _GAP)) for i in range(n)]
    return [Tile(area.left + x, area.top + y, width, height) for x, y in corners]


def covered_by(trajectory: Trajectory, view: View, size: tuple[int, int]) -> Flags:
    """Return where in a picture of ``size`` a view shows the area of a trajectory, up to the height that is reached."""
    corners = box_corners(trajectory.story.recipe.grid.size, reached_m(trajectory))
    width, height = size
    mask = np.zeros((height, width), np.uint8)
    half = 0.5 * np.array(size)
    for moment in np.linspace(trajectory.time[0], trajectory.time[-1], _MOMENTS):
        places = view.aim(float(moment)).project(corners, width / height)
        pixels = (half + half * places * [1, -1]).round().astype(np.int32)
        cv2.fillConvexPoly(mask, cv2.convexHull(pixels), 1)
    return mask > 0
