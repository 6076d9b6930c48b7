"""Atomic writing of files: after a full disk, a kill, an error or a concurrent writer a file is complete or unchanged.

Locks are those of the operating system: exclusive, and released when the process ends.
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
"""Key of a field's metadata: the field is left out of reports if it is empty."""
WRITERS: Final = 16
"""Concurrent writers of one file; the last to finish wins."""
FLAGS: Final = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
"""Flags for locked files: no links, no waiting for pipes, not inherited; for writing, since network file systems lock
nothing else."""


def lock(number: int, path: Path) -> bool:
    """Lock an open file until it is closed; return whether it is locked and still at its path. Raises OSError."""
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return is_at(number, path)


def is_at(number: int, path: Path) -> bool:
    """Return whether an open file is the regular one at a path."""
    try:
        status = path.lstat()
    except FileNotFoundError:
        return False
    return stat.S_ISREG(status.st_mode) and os.path.samestat(os.fstat(number), status)


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Give the path of an empty temporary file, which replaces ``path`` when the block ends without an error.

    It has the suffix of ``path``, for libraries that choose the format by it. Links in its place are not followed; a
    link at ``path`` itself is replaced, not its target.

    Raises InputError if it cannot be written, or the block writes nothing.
    """
    target = Path(path)
    with _replacing(target) as partial:
        yield partial
        if not partial.stat().st_size:
            raise InputError(f"{target}: cannot be written: nothing was written")


def write_whole(path: str | Path, content: str | bytes) -> Path:
    """Write a text (as UTF-8) or bytes atomically, and return the path.

    Unencodable characters, such as half of a surrogate pair, are escaped. Raises InputError if it cannot be written.
    """
    if isinstance(content, bytes):
        data = content
    else:
        data = content.encode("utf-8", "backslashreplace")
    with _replacing(Path(path)) as partial:
        partial.write_bytes(data)
    return Path(path)


def writable(text: str) -> str:
    r"""Return a text with escapes for characters that UTF-8 cannot encode, such as undecodable bytes of a file name.

    Example:
        >>> writable("caf\udce9")
        'caf\\udce9'
    """
    return text.encode("utf-8", "backslashreplace").decode()


def unwritten(path: Path, error: OSError) -> str:
    """Return the message for a file that cannot be written."""
    return (
        f"{path}: cannot be written: {error.strerror or error}; make room, or choose another --out"
    )


@contextmanager
def _replacing(target: Path) -> Iterator[Path]:
    """Give a new, locked file beside a target, which replaces it when the block ends without an error."""
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
    """Create a file with an unused name, and return its path and descriptor."""
    # From a fixed set of names, so that leftovers of killed writers are reused.
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
    """Remove the leftover of a dead writer; a live one has it locked."""
    with contextlib.suppress(OSError):
        number = os.open(partial, FLAGS)
        try:
            if lock(number, partial):
                partial.unlink()
        finally:
            os.close(number)
