"""The cache of compiled code: a file for each function, named by a digest of all that it depends on.

The files are in the user's cache directory, or in NUMBA_CACHE_DIR. Unpickling runs code, so a folder that others may
write to is refused, and only the environment sets the folder: numba's own cache also reads a file of the working
directory. A wheel may ship code for any processor of its platform (``make wheel``), which is read where the user's
folder has none.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import pickle
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Final

import llvmlite
import numba
import platformdirs
from numba.core import compiler, config, serialize
from numba.core.runtime import rtsys

from craftsim.compiling import LOG
from craftsim.errors import InputError
from craftsim.storage.writing import write_whole

SHIPPED: Final = Path(__file__).parents[2] / "data" / "compiled"
_GENERIC: Final = ("generic", "")
"""Name and features of the processor that shipped code is for."""
_MOST: Final = 600
"""Files that are kept, the last used ones: several versions of all that is compiled."""
_DIGEST_BYTES: Final = 32
_FORMAT: Final = 2
"""Of the files: what a library needs, what others need of it, and the code."""


def load(name: str, context: Any, bring: Callable[[Any], None]) -> Any:
    """Return the ``CompileResult`` of numba that was saved under a name; None if there is none, or a damaged one.

    The name is unique to the function and all that it depends on. ``bring`` loads the functions that the code calls,
    ``needs`` of its library.
    """
    # What compiling needs besides, which takes 0.4 s, is loaded by numba when something is compiled.
    rtsys.initialize(context)
    triple, *processor = context.codegen().magic_tuple()
    files = [SHIPPED / _file(name, triple, *_GENERIC)]
    own = folder()
    if own is not None:
        files.insert(0, own / _file(name, triple, *processor))
    for file in files:
        with suppress(OSError):
            content = file.read_bytes()
            if hashlib.sha256(content[_DIGEST_BYTES:]).digest() != content[:_DIGEST_BYTES]:
                continue
            if own is not None and file.parent == own:
                os.utime(file)
            needs, itself, code = pickle.loads(content[_DIGEST_BYTES:])
            bring(needs)
            result = compiler.CompileResult._rebuild(context, *code)
            result.library.needs, result.library.itself = needs, itself
            return result
    return None


def save(name: str, result: Any) -> None:
    """Save a ``CompileResult`` of numba under a name, if there is a safe folder."""
    own = folder()
    if own is None or result.library.has_dynamic_globals:
        return
    data = serialize.dumps((result.library.needs, result.library.itself, result._reduce()))
    file = own / _file(name, *result.codegen.magic_tuple())
    with suppress(InputError):
        write_whole(file, hashlib.sha256(data).digest() + data)


def _file(name: str, triple: str, processor: str, features: str) -> str:
    python = platform.python_implementation(), platform.python_version_tuple()[:2]
    options = (
        config.OPT,
        config.LOOP_VECTORIZE,
        config.SLP_VECTORIZE,
        config.BOUNDSCHECK,
        config.DEBUGINFO_DEFAULT,
    )
    versions = (_FORMAT, numba.__version__, llvmlite.__version__, *python)
    text = repr((name, triple, processor, features, versions, options))
    return f"{name.split()[0]}-{hashlib.sha256(text.encode()).hexdigest()[:32]}"


@cache
def folder() -> Path | None:
    """Return the folder that this process writes to, created if needed; None if it is not safe."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    place = Path(named) if named else platformdirs.user_cache_path("craftsim")
    folder = place / "craftsim-compiled" if named else place / "compiled"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for path in (folder,) if named else (place, folder):
            there = path.stat()
            if there.st_uid != os.geteuid() or there.st_mode & 0o022:
                raise PermissionError(f"{path} is not yours alone to write to")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(f"cannot write into {folder}")
    except OSError as error:
        LOG.warning("what is compiled is not kept: %s", error)
        return None
    return folder


_turns = 0


@contextmanager
def alone() -> Iterator[None]:
    """Hold the lock that lets one process compile at a time; blocks may nest."""
    global _turns
    own = folder()
    if own is None or _turns:
        yield
        return
    with open(own / "lock", "w") as lock:
        # Where there are no locks, none are kept out.
        with suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX)
        _turns += 1
        try:
            yield
        finally:
            _turns -= 1
            _remove_old(own)


def _remove_old(own: Path) -> None:
    """Remove the least recently used files beyond the limit."""
    with suppress(OSError):
        files = sorted(own.iterdir(), key=lambda file: file.stat().st_mtime, reverse=True)
        for file in files[_MOST:]:
            file.unlink()
