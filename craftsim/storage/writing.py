"""Writing files that are whole or as they were, whatever happens: a full disk, a kill, a mistake, another writer.

Locks are the system's: one process at a time has one, and it ends with that process, however it ends.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from craftsim.errors import InputError

LEFT_OUT_IF_EMPTY: Final = "left_out_if_empty"
"""Key of a field's metadata: a report says nothing of it where it is empty."""
WRITERS: Final = 16
"""How many may write one file at the same time; the last to end is the one whose file stays."""
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


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Give the path of an empty file to write, which takes the place of ``path`` when the block ends without an error.

    Its name ends as that of ``path`` does, for libraries that choose the format by it. It is new, and no other
    writer's: a link in its place is not followed. A link at ``path`` itself is replaced, not what it points to.

    Raises InputError where the disk does not take it, or where the block writes nothing.
    """
    target = Path(path)
    with _replacing(target) as partial:
        yield partial
        if not partial.stat().st_size:
            raise InputError(f"{target}: cannot be written: nothing was written")


def write_whole(path: str | Path, content: str | bytes) -> Path:
    """Write a text (as UTF-8) or bytes, such that the file is whole or as it was, and return its path.

    What UTF-8 cannot say, half of a surrogate pair for instance, is written as an escape. Raises InputError where the
    disk does not take it.
    """
    data = content if isinstance(content, bytes) else content.encode("utf-8", "backslashreplace")
    with _replacing(Path(path)) as partial:
        partial.write_bytes(data)
    return Path(path)


def writable(text: str) -> str:
    """Return a text with escapes for what UTF-8 cannot say, such as bytes in a file's name that are no text.

    Example:
        >>> writable("caf\udce9")
        'caf\\udce9'
    """
    return text.encode("utf-8", "backslashreplace").decode()


def unwritten(path: Path, error: OSError) -> str:
    """Return the message for a file that the disk does not take."""
    return f"{path}: cannot be written: {error.strerror or error}; make room, or choose another --out"


@contextmanager
def _replacing(target: Path) -> Iterator[Path]:
    """Give a new, locked file beside a target, which takes its place when the block ends without an error."""
    try:
        partial, number = _new_beside(target)
        try:
            yield partial
            with partial.open("rb") as file:
                os.fsync(file.fileno())
            partial.replace(target)
        except BaseException:
            # Only then: once it has been renamed, its name may be another writer's.
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)
            raise
        finally:
            os.close(number)
    except OSError as error:
        raise InputError(unwritten(target, error)) from error


def _new_beside(target: Path) -> tuple[Path, int]:
    """Make a file of a name that nobody uses, and return its path and number."""
    # Always the same names: what a kill leaves behind is gone with the next writing.
    names = [target.with_name(f".partial-{writer}-{target.name}") for writer in range(WRITERS)]
    for partial in names:
        _remove_if_abandoned(partial)
    for partial in names:
        try:
            number = os.open(partial, FLAGS | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            continue
        try:
            ours = lock(number, partial)
        except OSError:
            ours = True  # Without locks nobody takes it for abandoned either.
        if ours:
            return partial, number
        os.close(number)
    raise InputError(
        f"{target}: cannot be written: all names from {names[0]} to {names[-1].name} are taken; "
        "remove what is there, or choose another --out"
    )


def _remove_if_abandoned(partial: Path) -> None:
    """Remove the file that a writer left which is dead, for one that lives has it locked."""
    with contextlib.suppress(OSError):
        number = os.open(partial, FLAGS)
        try:
            if lock(number, partial):
                partial.unlink()
        finally:
            os.close(number)
