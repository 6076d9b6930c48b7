"""Locks of the system on files: one process at a time has one, and it ends with that process, however it ends."""

from __future__ import annotations

import fcntl
import os
import stat
from pathlib import Path
from typing import Final

FLAGS: Final = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
"""To open what is locked: never what a link points to, waiting for no pipe, and not for processes that one starts.

For writing, since a network's file system locks nothing else."""


def lock(number: int, path: Path) -> bool:
    """Lock an open file until its number is closed; return whether it is ours now, and still the one at a path.

    Raises OSError for a file system that has no locks.
    """
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return is_at(number, path)


def is_at(number: int, path: Path) -> bool:
    """Return whether an open file is the regular one at a path."""
    try:
        there = path.lstat()
    except FileNotFoundError:
        return False
    return stat.S_ISREG(there.st_mode) and os.path.samestat(os.fstat(number), there)
