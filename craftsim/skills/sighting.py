"""What a car's line sensors say of its place: a block or a slope stands in the middle of its cell, or nearly there.

By how much it is beside that is estimated, too, as long as its cross is seen: however often a car looks at one cross,
it knows its place no better than that cross has been put there. Over several crosses this averages out.

That holds for crosses that have been there from the start. What a car sets down stands where that car believed to be: a
car that took it for the middle would pass its own error, or another car's, on to itself, with all that came to it in
between, and so would the next one, without end. Below it a car knows only how it moves.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.kernel.jit import Record, compiled
from craftsim.skills.filtering import correct

Flags = NDArray[np.bool_]

_LOWERED_M: Final = 0.003
"""Below this height the board touches nothing: what is above stands where the map says."""
_LEVEL_RAD: Final = 0.05
"""A car that leans further stands on a slope, where nothing is above it."""
CROSS_X: Final = 6
"""Place in the state of the first of three figures: by how much the cross is beside its cell's middle, and turned."""

CROSS: Final = np.dtype(
    [
        ("reach_m", "f8", (4,)),
        *((name, "f8") for name in ("variance", "placed", "turned")),
        *((name, "i8") for name in ("seen", "x", "y", "raised")),
    ],
    align=True,
)
"""How far a car's line sensors are before its middle, the first two, and to the left of it; the variances of where a
line is seen, and of where and how a cross stands; whether one is seen, and its cell; whether the board was raised last.
"""


@compiled
def sight(now: Record, known: Record, cross: Record, moved: Flags) -> None:
    """Correct a pose by the lines that are seen of the cross above.

    A car that passes from below one cross to the next looks at the one until it has lost it.

    Args:
        now: the reading, with the pose as estimated so far.
        known: the FILTER of the estimate; its first figures are of x, y and heading.
        cross: the CROSS that the car looks at.
        moved: (length, width), whether a car has set something down in a column of cells.
    """
    if now.board_m > _LOWERED_M:
        cross.raised, cross.seen = 1, 0
        return
    if cross.raised:
        cross.raised = 0
        column = math.floor(now.x / CELL_PITCH_M), math.floor(now.y / CELL_PITCH_M)
        # A car that believes to be outside has no column.
        if 0 <= column[0] < moved.shape[0] and 0 <= column[1] < moved.shape[1]:
            moved[column] = True
    if abs(now.pitch) > _LEVEL_RAD or abs(now.roll) > _LEVEL_RAD:
        cross.seen = 0
        return
    x, y, c, s = now.x, now.y, math.cos(now.heading), math.sin(now.heading)
    state, slopes, covariance = known.state, known.slopes, known.covariance
    before = (state[0], state[1], state[2])
    still = False
    for k in range(4):
        toward_x, toward_y = (c, s) if k < 2 else (-s, c)
        there_x = math.floor((x + cross.reach_m[k] * toward_x) / CELL_PITCH_M) == cross.x
        there_y = math.floor((y + cross.reach_m[k] * toward_y) / CELL_PITCH_M) == cross.y
        still = still or (there_x and there_y and math.isfinite(now.lines[k]))
    if not still:
        cross.seen = 0
    for k in range(4):
        if not math.isfinite(now.lines[k]):
            continue
        # Sensors before and behind measure to the left, the others forward.
        toward_x, toward_y, axis_x, axis_y = (c, s, -s, c) if k < 2 else (-s, c, c, s)
        from_x, from_y = cross.reach_m[k] * toward_x, cross.reach_m[k] * toward_y
        cell_x = math.floor((x + from_x) / CELL_PITCH_M)
        cell_y = math.floor((y + from_y) / CELL_PITCH_M)
        within = 0 <= cell_x < moved.shape[0] and 0 <= cell_y < moved.shape[1]
        if within and moved[cell_x, cell_y]:
            continue
        if not cross.seen:
            cross.seen, cross.x, cross.y = 1, cell_x, cell_y
            # It is another cross, which may stand anywhere, whatever is known of all else.
            for j in range(CROSS_X, CROSS_X + 3):
                state[j] = 0.0
                for i in range(len(state)):
                    covariance[i, j] = covariance[j, i] = 0.0
                covariance[j, j] = cross.turned if j == CROSS_X + 2 else cross.placed
        elif cell_x != cross.x or cell_y != cross.y:
            continue
        # From the middle of the cell to the sensor.
        at_x = x + from_x - (cell_x + 0.5) * CELL_PITCH_M
        at_y = y + from_y - (cell_y + 0.5) * CELL_PITCH_M
        along_x = abs(axis_x) > abs(axis_y)
        to_axis = axis_x if along_x else axis_y
        row = 0 if along_x else 1
        slopes[row], slopes[CROSS_X + row] = -1 / to_axis, 1 / to_axis
        # By how much the place of the sensor, or of the line there, moves when the car or the cross turns.
        slopes[2] = (from_y if along_x else -from_x) / to_axis
        slopes[CROSS_X + 2] = (-at_y if along_x else at_x) / to_axis
        off = now.lines[k] + (at_x if along_x else at_y) / to_axis
        for j in range(3):
            off -= slopes[j] * (state[j] - before[j]) + slopes[CROSS_X + j] * state[CROSS_X + j]
        correct(known, off, cross.variance, 0, 0)
