"""What a Site looks at around each physics step, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled

UNKNOWN = -1


@compiled
def reaches(numbers: NDArray[np.int32], limit: int) -> bool:
    """Return whether one of some numbers is as large as a limit."""
    most = numbers[0]
    for i in range(len(numbers)):
        most = max(most, numbers[i])
    return bool(most >= limit)


@compiled
def note_commanded(ctrl: NDArray[np.float64], commanded: NDArray[np.int8]) -> bool:
    """Note which motors have a command, 1 for those that have, and return whether that is news."""
    news = False
    for motor in range(len(ctrl)):
        has = 1 if ctrl[motor] != 0.0 else 0
        news = news or commanded[motor] != has
        commanded[motor] = has
    return news
