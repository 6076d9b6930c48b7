"""What cars feel of their floor: by how much they lean where it should be level.

A car's pitch and roll are averaged over a while; slopes are left out, which the map shows. Nobody is told what the floor
is like.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from craftsim.discrete.compiled import Record, compiled
from craftsim.skills.state import DRIVE

GROUND: Final = np.dtype(
    [("pitch", "f8"), ("roll", "f8"), ("n_read", "i8"), ("uneven", "i8")],
    align=True,
)
"""Of one car: its mean pitch and roll in radians, from how many readings, and whether they were ever too much."""


@compiled
def feel_ground(ground: Record, now: Record, task: Record, known: Record) -> None:
    """Take a car's reading into its GROUND, unless it stands on a slope or drives from or onto one."""
    if max(abs(now.pitch), abs(now.roll)) > known.hold.level or (task.law == DRIVE and task.drive.sloping):
        return
    n_mean = max(1.0, known.uneven.tilt_time / known.period_s)
    ground.n_read += 1
    share = 1 / min(float(ground.n_read), n_mean)
    ground.pitch += share * (now.pitch - ground.pitch)
    ground.roll += share * (now.roll - ground.roll)
    if ground.n_read >= n_mean and math.hypot(ground.pitch, ground.roll) > known.uneven.tilt:
        ground.uneven = 1
