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
from craftsim.skills.filtering import correct, forget

Flags = NDArray[np.bool_]

_LOWERED_M: Final = 0.003
"""Below this height the board touches nothing: what is above stands where the map says."""
_LEVEL_RAD: Final = 0.05
"""A car that leans further stands on a slope, where nothing is above it."""
CROSS_X: Final = 6
"""Place in the state of the first of three figures: by how much the cross is beside its cell's middle, and turned."""

CROSS: Final = np.dtype(
    [
        *((name, "f8") for name in ("along_m", "across_m", "variance", "placed", "turned")),
        *((name, "i8") for name in ("seen", "x", "y", "raised")),
    ],
    align=True,
)
"""How far a car's line sensors are from its middle, before and behind, and beside; the variances of where a line is
seen, and of where and how a cross stands; whether one is seen, and its cell; whether the board was raised last."""


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
    state, slopes = known.state, known.slopes
    before = (state[0], state[1], state[2])
    if not _sees(now, cross, x, y, c, s):
        cross.seen = 0
    for k in range(4):
        if not math.isfinite(now.lines[k]):
            continue
        place, axis = _sensor(cross, k, c, s)
        cell_x = math.floor((x + place[0]) / CELL_PITCH_M)
        cell_y = math.floor((y + place[1]) / CELL_PITCH_M)
        within = 0 <= cell_x < moved.shape[0] and 0 <= cell_y < moved.shape[1]
        if within and moved[cell_x, cell_y]:
            continue
        if not cross.seen:
            cross.seen, cross.x, cross.y = 1, cell_x, cell_y
            for j in range(3):
                forget(known, CROSS_X + j, cross.turned if j == 2 else cross.placed)
        elif cell_x != cross.x or cell_y != cross.y:
            continue
        # From the middle of the cell to the sensor.
        at_x, at_y = (
            x + place[0] - (cell_x + 0.5) * CELL_PITCH_M,
            y + place[1] - (cell_y + 0.5) * CELL_PITCH_M,
        )
        along_x = abs(axis[0]) > abs(axis[1])
        to_axis = axis[0] if along_x else axis[1]
        row = 0 if along_x else 1
        slopes[row], slopes[CROSS_X + row] = -1 / to_axis, 1 / to_axis
        # By how much the place of the sensor, or of the line there, moves when the car or the cross turns.
        slopes[2] = (place[1] if along_x else -place[0]) / to_axis
        slopes[CROSS_X + 2] = (-at_y if along_x else at_x) / to_axis
        off = now.lines[k] + (at_x if along_x else at_y) / to_axis
        for j in range(3):
            off -= slopes[j] * (state[j] - before[j]) + slopes[CROSS_X + j] * state[CROSS_X + j]
        correct(known, off, cross.variance, 0, 0)


@compiled
def _sees(now: Record, cross: Record, x: float, y: float, c: float, s: float) -> bool:
    """Return whether a sensor still sees the cross that the car looks at."""
    for k in range(4):
        if math.isfinite(now.lines[k]):
            place, _ = _sensor(cross, k, c, s)
            there_x = math.floor((x + place[0]) / CELL_PITCH_M) == cross.x
            if there_x and math.floor((y + place[1]) / CELL_PITCH_M) == cross.y:
                return True
    return False


@compiled
def _sensor(cross: Record, k: int, c: float, s: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return where a sensor is, from the car's middle, and along which axis it measures."""
    reach = (cross.along_m, -cross.along_m, cross.across_m, -cross.across_m)[k]
    if k < 2:
        return (reach * c, reach * s), (-s, c)
    return (-reach * s, reach * c), (c, s)
