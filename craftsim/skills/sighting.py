"""What a car's line sensors say of its place: a block or a slope stands in the middle of its cell."""

from __future__ import annotations

import math
from typing import Final

from craftsim.discrete.compiled import Record, compiled
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.skills.filtering import correct

_LOWERED_M: Final = 0.003
"""Below this height the board touches nothing: what is above stands where the map says."""
_LEVEL_RAD: Final = 0.05
"""A car that leans further stands on a slope, where nothing is above it."""


@compiled
def sight(now: Record, known: Record, along_m: float, across_m: float, variance: float) -> None:
    """Correct a pose by the lines that are seen of the cross above.

    Args:
        now: the reading, with the pose as estimated so far.
        known: the FILTER of the estimate, whose first figures are of x, y and heading.
        along_m: distance of the sensors before and behind from the car's middle.
        across_m: distance of those beside.
        variance: of where a line is seen, and of where what bears it stands.
    """
    if now.board_m > _LOWERED_M or abs(now.pitch) > _LEVEL_RAD or abs(now.roll) > _LEVEL_RAD:
        return
    x, y, c, s = now.x, now.y, math.cos(now.heading), math.sin(now.heading)
    state, slopes = known.state, known.slopes
    before = (state[0], state[1], state[2])
    for k in range(4):
        if not math.isfinite(now.lines[k]):
            continue
        reach = (along_m, -along_m, across_m, -across_m)[k]
        # Where the sensor is, and along which axis it measures.
        if k < 2:
            place, axis = (reach * c, reach * s), (-s, c)
        else:
            place, axis = (-reach * s, reach * c), (c, s)
        along_x = abs(axis[0]) > abs(axis[1])
        to_axis = axis[0] if along_x else axis[1]
        at = x + place[0] if along_x else y + place[1]
        middle = (math.floor(at / CELL_PITCH_M) + 0.5) * CELL_PITCH_M
        slopes[0 if along_x else 1] = -1 / to_axis
        # By how much the place of the sensor moves when the car turns.
        slopes[2] = (place[1] if along_x else -place[0]) / to_axis
        off = now.lines[k] - (middle - at) / to_axis
        for j in range(3):
            off -= slopes[j] * (state[j] - before[j])
        correct(known, off, variance)
