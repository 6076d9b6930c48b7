"""Giving memory back in a process that tries one world after the other.

MuJoCo's models and Python's objects of a world go when it is done, but leave the heap in fragments, which by and by
make the process grow.
"""

from __future__ import annotations

import ctypes
import gc
from itertools import count
from typing import Final

EVERY: Final = 20
"""Trials after which a process tidies up."""

_DONE: Final = count(1)


def tidy() -> None:
    """Say that a trial is done; now and then its memory is given back to the system."""
    if next(_DONE) % EVERY == 0:
        gc.collect()
        # Of glibc alone; other systems have none, or need none.
        if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
            trim(0)
