"""What a path leads to. It is what somebody typed or wrote into a file: it may be no path at all.

pathlib raises errors of its own, and others from one Python to the next, for names that are too long, links that go in
a circle, and bytes that no name has.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from craftsim.errors import InputError


def exists(path: str | Path) -> bool:
    """Return whether there is anything; raise InputError for a path that cannot be, or not be looked at."""
    return _mode(path) is not None


def is_file(path: str | Path) -> bool:
    """Return whether there is a regular file; raises as :func:`exists`."""
    return stat.S_ISREG(_mode(path) or 0)


def is_folder(path: str | Path) -> bool:
    """Return whether there is a folder; raises as :func:`exists`."""
    return stat.S_ISDIR(_mode(path) or 0)


def resolved(path: str | Path) -> Path:
    """Return an absolute path without links, whether anything is there or not; raises as :func:`exists`."""
    try:
        return Path(os.path.realpath(path))
    except (OSError, ValueError) as error:
        raise InputError(_unreadable(path, error)) from error


def check_working_folder() -> None:
    """Raise InputError where the current folder has been removed: no relative path means anything then."""
    try:
        os.getcwd()
    except OSError as error:
        raise InputError(f"the current folder is gone ({error.strerror}); change to another one") from error


def _mode(path: str | Path) -> int | None:
    """Return the kind and the rights of what a path leads to, or None for nothing."""
    try:
        return os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise InputError(_unreadable(path, error)) from error


def _unreadable(path: str | Path, error: Exception) -> str:
    return f"{path}: cannot be read: {(isinstance(error, OSError) and error.strerror) or error}"
