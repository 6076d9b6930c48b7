"""Types of arrays that compiled functions take."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Flags = NDArray[np.bool_]
Records = NDArray[np.void]
"""Rows of a structured type, as :func:`craftsim.compiled.jit.layout` makes it."""
Arrays = tuple[Floats, ...]
