"""Blocks that stand beside their cell's middle: where a car has to be to lift them.

A boss catches a block that is a few millimetres beside it. What stands further off is lifted from below its own middle,
which is read as the rest of the world is, from outside; the car then brings it to the middle of the cell.
"""

from __future__ import annotations

from typing import Final

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import Kind
from craftsim.discrete.readback import Poses, Reading
from craftsim.skills.mecanum import Triple

_CAUGHT_M: Final = 0.003
"""Distance at which a boss still catches a block: its bevels reach 5 mm, of which a car may be off by 1 or 2."""
_CAUGHT_RAD: Final = 0.02
"""Turn that takes as much of it at the boss' corners."""
_STEP_M: Final = 0.002
_STEP_RAD: Final = 0.02
"""Steps in which a place is read: no finer than a camera above the floor tells it."""
FURTHEST_M: Final = CELL_PITCH_M / 4
"""As far as a thing counts as a car's load."""


def load_offset(poses: Poses, reading: Reading, index: int) -> Triple | None:
    """Return where a block or a flag stands beside its cell's middle, too far for a boss to catch it: x, y in metres
    and turn in radians. None for what stands well, and for what no car reaches from its cell."""
    fit = reading.objects[index]
    if fit.carrier is not None or poses.kinds[index] not in (Kind.BLOCK, Kind.FLAG):
        return None
    if fit.offset_m <= _CAUGHT_M and abs(fit.heading_rad) <= _CAUGHT_RAD:
        return None
    if fit.offset_m > FURTHEST_M:
        return None
    x, y, _ = poses.positions[index].tolist()
    away_x = x - (fit.cell[0] + 0.5) * CELL_PITCH_M
    away_y = y - (fit.cell[1] + 0.5) * CELL_PITCH_M
    return (
        round(away_x / _STEP_M) * _STEP_M,
        round(away_y / _STEP_M) * _STEP_M,
        round(fit.heading_rad / _STEP_RAD) * _STEP_RAD,
    )
