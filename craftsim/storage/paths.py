"""Checks of user-supplied paths with InputError instead of the various errors of pathlib (too long, link loops, null
bytes), which differ between versions of Python.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from craftsim.errors import InputError


def exists(path: str | Path) -> bool:
    """Return whether a path exists. Raises InputError for an invalid or inaccessible path."""
    return _mode(path) is not None


def is_file(path: str | Path) -> bool:
    """Return whether a path is a regular file; raises as :func:`exists`."""
    return stat.S_ISREG(_mode(path) or 0)


def is_folder(path: str | Path) -> bool:
    """Return whether a path is a folder; raises as :func:`exists`."""
    return stat.S_ISDIR(_mode(path) or 0)


def resolved(path: str | Path) -> Path:
    """Return the absolute path without links, which need not exist; raises as :func:`exists`."""
    try:
        return Path(os.path.realpath(path))
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from error


def check_working_folder() -> None:
    """Raise InputError if the current folder has been removed, since relative paths are then invalid."""
    try:
        os.getcwd()
    except OSError as error:
        raise InputError(
            f"the current folder is gone ({error.strerror}); change to another one"
        ) from error


def _mode(path: str | Path) -> int | None:
    """Return the mode of the file at a path; None if it does not exist."""
    try:
        return os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from error


def unreadable(path: str | Path, error: Exception) -> InputError:
    """Return the error for a path that cannot be read."""
    return InputError(f"{path}: cannot be read: {reason_of(error)}")


def reason_of(error: Exception) -> str:
    """Return what an error says, one of the operating system without its number and path."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
