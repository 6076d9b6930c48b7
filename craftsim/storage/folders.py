"""Output folders with an exclusive lock, so that concurrent processes never overwrite each other's files."""

from __future__ import annotations

import contextlib
import errno
import functools
import inspect
import os
import shutil
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, ParamSpec, TypeVar

from craftsim.errors import InputError
from craftsim.storage.paths import reason_of
from craftsim.storage.writing import FLAGS, is_at, lock

P = ParamSpec("P")
R = TypeVar("R")

LOCK: Final = ".craftsim-lock"
"""Lock file of a folder; a leftover after a kill locks nothing."""

_RETRIES: Final = 100
"""Attempts to lock a folder whose lock file vanishes because its owner is ending."""


_OWNED: Final = set[tuple[int, tuple[int, int] | None]]()
"""The locked folders, each with the thread that has locked it."""


def output_directory(out: Path) -> Path:
    """Create a directory for results, with parents, and return it. Raises InputError if it is not writable."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        file = isinstance(error, FileExistsError)
        if file:
            reason = "it is a file; choose another one"
        else:
            reason = reason_of(error)
        raise InputError(f"cannot make the output directory {out}: {reason}") from error
    if not os.access(out, os.W_OK | os.X_OK):
        raise InputError(f"cannot write into the output directory {out}")
    return out


def directory_within(folder: Path, *names: str) -> Path:
    """Create a directory within an output folder, with parents, and return it.

    Raises InputError if it cannot be created, if a name leads out of the folder, and for a link in the path.
    """
    for name_part in Path(*names).parts:
        if name_part in ("..", "/"):
            raise InputError(
                f"'{Path(*names)}' leads out of {folder}; allowed: names of folders in it"
            )
        folder /= name_part
        if folder.is_symlink():
            raise InputError(
                f"{folder} is a link, and none is followed within a folder of results; remove it"
            )
    return output_directory(folder)


def remove(path: Path) -> None:
    """Remove a file, a link or a directory tree, if it exists; links are not followed. Raises OSError."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def owned(out: Path) -> Iterator[Path]:
    """Make an output folder and lock it against other processes and threads until the block ends; re-entrant.

    The lock is that of the operating system on an empty file in the folder. A folder that was made for the block and is
    empty afterwards is removed. Raises InputError if it is in use, or cannot be made, written to or locked.
    """
    thread = threading.get_ident()
    if (thread, _identity(out)) in _OWNED:
        yield out
        return
    new_folders = [
        folder for folder in (out, *out.parents) if not os.path.lexists(folder)
    ]  # innermost first
    number = _lock(out)
    key = thread, _identity(out)
    _OWNED.add(key)
    try:
        yield out
    finally:
        _OWNED.discard(key)
        with contextlib.suppress(OSError):
            if is_at(number, out / LOCK):
                (out / LOCK).unlink()
        os.close(number)
        with contextlib.suppress(OSError):
            for folder in new_folders:
                folder.rmdir()


def owning(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator: lock the folder given as argument ``out``, if any, during a call."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def locking(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        out = bound.arguments["out"]
        with contextlib.nullcontext() if out is None else owned(Path(out)):
            return function(*args, **kwargs)

    return locking


def _identity(out: Path) -> tuple[int, int] | None:
    """Return the identity of a directory, independent of paths and links; None if it does not exist."""
    try:
        status = out.stat()
    except (OSError, ValueError):  # the latter for a name that can be none
        return None
    return status.st_dev, status.st_ino


def _lock(out: Path) -> int:
    """Create and lock a directory; return the descriptor of its lock file."""
    for tries_left in reversed(range(_RETRIES)):
        try:
            output_directory(out)
        except InputError:
            if not tries_left:
                raise
            continue  # its creator may be removing it at this moment, and another be making it again
        number = _try_to_lock(out, out / LOCK)
        if number is not None:
            return number
    raise InputError(
        f"{out / LOCK}: cannot be locked, something keeps removing it; choose another --out"
    )


def _try_to_lock(out: Path, path: Path) -> int | None:
    """Return the descriptor of a locked file; None if it vanished meanwhile."""
    try:
        number = os.open(path, FLAGS | os.O_CREAT, 0o666)
    except FileNotFoundError:
        return None
    except OSError as error:
        obstacle = error.strerror
        if error.errno == errno.ELOOP:
            obstacle = "a link"
        raise InputError(
            f"{path}: cannot be locked: {obstacle}; remove it, or choose another --out"
        ) from error
    with contextlib.ExitStack() as closing:
        closing.callback(os.close, number)
        if not stat.S_ISREG(os.fstat(number).st_mode):
            raise InputError(
                f"{path}: cannot be locked: not a file; remove it, or choose another --out"
            )
        try:
            ours = lock(number, path)
        except OSError as error:
            raise InputError(
                f"{out}: its file system has no locks ({error.strerror}), which keep processes apart; "
                "choose an --out elsewhere"
            ) from error
        if ours:
            closing.pop_all()
            return number
        if is_at(number, path):
            raise InputError(
                f"{out} is in use: another craftsim writes into it; wait until it has ended, or choose another --out"
            )
    return None
