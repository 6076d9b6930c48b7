"""Where a small view may lie on a large one without hiding any of the area."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from craftsim.models.framing import box_corners
from craftsim.rendering.cameras import View, reached_m
from craftsim.rendering.layout import Tile
from craftsim.rendering.trajectory import Trajectory

_MOMENTS = 24
"""Of a trajectory, at which a camera that moves is looked through."""


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
