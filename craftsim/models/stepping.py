"""What a Site looks at after each physics step, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled


@compiled
def reaches(numbers: NDArray[np.int32], limit: int) -> bool:
    """Return whether one of some numbers is as large as a limit."""
    most = numbers[0]
    for i in range(len(numbers)):
        most = max(most, numbers[i])
    return bool(most >= limit)
