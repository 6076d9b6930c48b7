"""Where on a frame each view, and the captions beside them, have their place, and where insets hide nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np

from craftsim.models.framing import box_corners
from craftsim.rendering.cameras import View, reached_m
from craftsim.rendering.trajectory import Trajectory

Layout = Literal["side", "main", "inset"]
"""Views of the same size side by side; the first one large and the others in a column beside it; or small ones in a
corner of the first one."""

_PANEL: Final = 0.23
"""Share of a wide frame's width for the captions; of a tall frame's height it is a little more."""
_COLUMN: Final = 0.34
"""Share of the width for the smaller views."""
_INSETS: Final = (0.34, 0.28, 0.22)
"""Shares of the first view's sides that an inset may have."""
_GAP: Final = 4
"""Pixels between views."""
_MOMENTS: Final = 24
"""Of a trajectory, at which a camera that moves is looked through."""


@dataclass(frozen=True)
class Tile:
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
    def rows(self) -> slice:
        """Of a frame."""
        return slice(self.top, self.top + self.height)

    @property
    def columns(self) -> slice:
        """Of a frame."""
        return slice(self.left, self.left + self.width)


def arrange(
    size: tuple[int, int],
    n_views: int,
    layout: Layout,
    captions: bool,
    hidden_in: Callable[[Tile], Callable[[Tile], int]] = lambda first: lambda tile: 0,
) -> tuple[list[Tile], Tile | None]:
    """Return the tiles of the views and of the captions in a frame of ``size`` (width, height).

    They do not overlap, but for insets, which lie on the first view where they hide nothing; without such a corner they
    are beside it. ``hidden_in`` gives, for the tile of the first view, what gives the pixels that a tile on it hides.
    """
    width, height = size
    panel = None
    if captions and width >= height:
        taken = round(_PANEL * width)
        panel = Tile(width - taken, 0, taken, height)
        width -= taken
    elif captions:
        taken = round(1.2 * _PANEL * height)
        panel = Tile(0, height - taken, width, taken)
        height -= taken
    area = Tile(0, 0, width, height)
    if layout == "inset" and n_views > 1:
        hidden = hidden_in(area)
        for tiles in _corners(area, n_views - 1):
            if not any(map(hidden, tiles)):
                return [area, *tiles], panel
    if layout != "side" and n_views > 1:
        column = round(_COLUMN * width)
        first = Tile(0, 0, width - column - _GAP, height)
        rest = Tile(width - column, 0, column, height)
        return [first, *_tiles(rest, n_views - 1, 1)], panel
    return _tiles(area, n_views, _columns(area, n_views)), panel


def _corners(area: Tile, n: int) -> Iterator[list[Tile]]:
    """Yield n small tiles one above the other in each corner of an area, large ones first."""
    for share in _INSETS:
        width, height = round(share * area.width), round(share * area.height)
        for right, lower in ((True, False), (False, False), (True, True), (False, True)):
            left = area.left + (area.width - width - 2 * _GAP if right else 2 * _GAP)
            first = area.height - n * (height + 2 * _GAP) if lower else 2 * _GAP
            tops = [area.top + first + i * (height + 2 * _GAP) for i in range(n)]
            if tops[0] >= area.top and tops[-1] + height <= area.top + area.height:
                yield [Tile(left, top, width, height) for top in tops]


def _columns(area: Tile, n: int) -> int:
    """Return in how many columns n tiles of an area are nearest to pictures of 4:3."""

    def off(columns: int) -> float:
        rows = math.ceil(n / columns)
        return abs(math.log(area.width / columns / (area.height / rows) / (4 / 3)))

    return min(range(1, n + 1), key=off)


def _tiles(area: Tile, n: int, columns: int) -> list[Tile]:
    rows = math.ceil(n / columns)
    width = (area.width - _GAP * (columns - 1)) // columns
    height = (area.height - _GAP * (rows - 1)) // rows
    return [
        Tile(
            area.left + (i % columns) * (width + _GAP),
            area.top + (i // columns) * (height + _GAP),
            width,
            height,
        )
        for i in range(n)
    ]


def hidden_by(trajectory: Trajectory, view: View, large: Tile) -> Callable[[Tile], int]:
    """Return what gives the pixels of the area, as a view of a trajectory shows it in a tile, that another tile hides.

    The area is taken with all the height that anything in it reaches.
    """
    corners = box_corners(trajectory.story.recipe.grid.size, reached_m(trajectory))
    seen = np.zeros((large.height, large.width), np.uint8)
    half = 0.5 * np.array(large.size)
    for moment in np.linspace(trajectory.time[0], trajectory.time[-1], _MOMENTS):
        places = view.aim(float(moment)).project(corners, large.width / large.height)
        pixels = (half + half * places * [1, -1]).round().astype(np.int32)
        cv2.fillConvexPoly(seen, cv2.convexHull(pixels), 1)

    def hidden(tile: Tile) -> int:
        top, left = tile.top - large.top, tile.left - large.left
        return int(seen[top : top + tile.height, left : left + tile.width].sum())

    return hidden
