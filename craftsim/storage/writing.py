"""Writing files that are whole or, whatever happens, as they were before: a full disk, a kill, a mistake."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from craftsim.errors import InputError


@contextmanager
def whole(path: str | Path) -> Iterator[Path]:
    """Give the path of a file to write, which takes the place of ``path`` when the block ends without an error.

    Its name ends as that of ``path`` does, for libraries that choose the format by it.

    Raises InputError where the disk does not take it, or where the block leaves nothing behind.
    """
    target = Path(path)
    # Always the same name: what a kill leaves behind is gone with the next writing.
    partial = target.with_name(f".partial-{target.name}")
    try:
        yield partial
        with partial.open("rb") as file:
            os.fsync(file.fileno())
        partial.replace(target)
    except OSError as error:
        raise InputError(unwritten(target, error)) from error
    finally:
        _discard(partial)


def write_whole(path: str | Path, content: str | bytes) -> Path:
    """Write a text (as UTF-8) or bytes, such that the file is whole or as it was, and return its path.

    What UTF-8 cannot say, half of a surrogate pair for instance, is written as an escape. Raises InputError where the
    disk does not take it.
    """
    data = content if isinstance(content, bytes) else content.encode("utf-8", "backslashreplace")
    with whole(path) as partial:
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


def _discard(path: Path) -> None:
    """Remove what is left of a file, where anything is; a disk that fails has failed before."""
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)
