"""What cars feel of their floor: by how much they lean where it should be level.

A car's pitch and roll are averaged over a while, and the floor is uneven when their mean is too large beyond doubt: how
noisy the sensors are shows in how they scatter. Slopes are left out, which the map shows. No car knows the
floor.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from craftsim.discrete.kernel.jit import Record, compiled
from craftsim.skills.state import DRIVE

_FEWEST: Final = 5
"""Readings without which there is doubt: fewer do not show how much they scatter."""
_SURE: Final = 3.0
"""There is no doubt beyond so many standard errors of the mean."""

GROUND: Final = np.dtype(
    [
        ("pitch", "f8"),
        ("roll", "f8"),
        ("variance", "f8"),
        ("n_read", "i8"),
        ("doubtful", "i8"),
        ("uneven", "i8"),
    ],
    align=True,
)
"""Of one car: mean pitch and roll in radians and the variance of both together, of how many readings; whether the mean
is too large, but may be noise; whether it ever was too large beyond doubt."""


@compiled
def feel_ground(ground: Record, now: Record, task: Record, known: Record) -> bool:
    """Take a car's reading into its GROUND and return True.

    Return False, and leave it, for one that stands on a slope or drives from or onto one.
    """
    leans = max(abs(now.pitch), abs(now.roll)) > known.hold.level
    if leans or (task.law == DRIVE and task.drive.sloping):
        return False
    ground.n_read += 1
    share = 1 / min(float(ground.n_read), max(1.0, known.uneven.tilt_time / known.period_s))
    pitch, roll = now.pitch - ground.pitch, now.roll - ground.roll
    ground.pitch += share * pitch
    ground.roll += share * roll
    ground.variance += share * ((1 - share) * (pitch * pitch + roll * roll) - ground.variance)
    beyond = math.hypot(ground.pitch, ground.roll) - known.uneven.tilt
    # The mean of n readings has 1 / n of their variance, a fading one of shares s has s / (2 - s).
    error = math.sqrt(ground.variance * max(share / (2 - share), 1.0 / ground.n_read))
    if ground.n_read >= _FEWEST and beyond > _SURE * error:
        ground.uneven = 1
    ground.doubtful = beyond > 0 and not ground.uneven
    return True
