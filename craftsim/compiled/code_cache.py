"""The cache of compiled code: a file for each function, named by a digest of all that it depends on.

The files are in the user's cache directory, or in NUMBA_CACHE_DIR. Unpickling runs code, so a folder that others may
write to or replace is refused, and only the environment sets the folder: numba's own cache also reads a file of the
working directory. All files are opened relative to the folder that was checked, and links are not followed.

A wheel may ship code for any processor of its platform (``make_wheel.py``), read where the user's folder has none.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import pickle
import platform
import re
import stat
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

from craftsim.compiled.progress import PROGRESS_LOG
from craftsim.storage.paths import reason_of

SHIPPED_CODE: Final = Path(__file__).parents[1] / "data" / "compiled"
_GENERIC: Final = ("generic", "")
"""Name and features of the processor that shipped code is for."""
_MOST: Final = 600
"""Files that are kept, the last used ones: several versions of all that is compiled."""
_OURS: Final = re.compile(r"(\.partial-\d+-)?[^/]+\.(entry|part|called)-[0-9a-f]{32}")
"""Names of files of the cache, finished or not; others in its folder are left alone."""
_LOCK: Final = "lock"
_DIGEST_BYTES: Final = 32
_FLAGS: Final = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
_READ: Final = os.O_RDONLY | _FLAGS
_CREATE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | _FLAGS
_CREATE_OR_OPEN: Final = os.O_RDWR | os.O_CREAT | _FLAGS
_LIST: Final = os.O_RDONLY | os.O_DIRECTORY | _FLAGS
_PASS: Final = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | _FLAGS
"""Flags for folders on the way, which need not be readable."""
_FORMAT: Final = 2
"""Version of the files' format: the needs of a library, what others need of it, and the code."""


def load_code(name: str, context: Any, bring: Callable[[Any], None]) -> Any:
    """Return the ``CompileResult`` of numba that was saved under a name; None if there is none, or a damaged one.

    The name is unique to the function and all that it depends on. ``bring`` loads the functions that the code calls,
    ``needs`` of its library.
    """
    # What compiling needs besides, which takes 0.4 s, is loaded by numba when something is compiled.
    rtsys.initialize(context)
    triple, *processor = context.codegen().magic_tuple()
    places: list[tuple[str | Path, int | None]] = [
        (SHIPPED_CODE / _file(name, triple, *_GENERIC), None)
    ]
    own_folder = folder()
    if own_folder is not None:
        places.insert(0, (_file(name, triple, *processor), own_folder))
    for file, folder_number in places:
        with suppress(OSError):
            content = _read(file, folder_number)
            if hashlib.sha256(content[_DIGEST_BYTES:]).digest() != content[:_DIGEST_BYTES]:
                continue
            needs, itself, code = pickle.loads(content[_DIGEST_BYTES:])
            bring(needs)
            result = compiler.CompileResult._rebuild(context, *code)
            result.library.needs = needs
            result.library.itself = itself
            return result
    return None


def save_code(name: str, result: Any) -> None:
    """Save a ``CompileResult`` of numba under a name, if there is a safe folder."""
    own_folder = folder()
    if own_folder is None or result.library.has_dynamic_globals:
        return
    data = serialize.dumps((result.library.needs, result.library.itself, result._reduce()))
    # On a full disk nothing is kept.
    with suppress(OSError):
        _write(
            _file(name, *result.codegen.magic_tuple()),
            own_folder,
            hashlib.sha256(data).digest() + data,
        )


def _read(file: str | Path, folder_number: int | None) -> bytes:
    """Return the content of a file, for one in the cache's folder its descriptor ``folder_number``. Raises OSError."""
    number = os.open(file, _READ, dir_fd=folder_number)
    with open(number, "rb") as opened:
        if folder_number is not None:
            _check(os.fstat(number), str(file))
            # The last used ones are kept.
            os.utime(number)
        return opened.read()


def _write(name: str, folder: int, content: bytes) -> None:
    """Write a file of the cache's folder, whole or not at all. Raises OSError."""
    partial = f".partial-{os.getpid()}-{name}"
    with suppress(FileNotFoundError):
        os.unlink(partial, dir_fd=folder)
    number = os.open(partial, _CREATE, 0o600, dir_fd=folder)
    try:
        with open(number, "wb") as opened:
            opened.write(content)
            opened.flush()
            os.fsync(number)
        os.rename(partial, name, src_dir_fd=folder, dst_dir_fd=folder)
    except BaseException:
        with suppress(OSError):
            os.unlink(partial, dir_fd=folder)
        raise


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
def folder() -> int | None:
    """Return a descriptor of the folder of the cache, created if needed; None if it is not safe."""
    try:
        return _folder()
    except (OSError, RuntimeError) as error:
        PROGRESS_LOG.warning("what is compiled is not kept: %s", _words(error))
        return None


def kept_in() -> tuple[Path | None, str]:
    """Return the folder of the cache, created if needed, and, where there is none, the reason."""
    try:
        os.close(_folder())
        return Path(*_place()), ""
    except (OSError, RuntimeError) as error:
        return None, _words(error)


def _folder() -> int:
    """Return the descriptor of :func:`folder`. Raises OSError or RuntimeError where it is not safe."""
    place, name = _place()
    place.mkdir(mode=0o700, parents=True, exist_ok=True)
    number = _opened(place.resolve(), name)
    if not os.access(".", os.W_OK | os.X_OK, dir_fd=number):
        os.close(number)
        raise PermissionError(f"cannot write into {place / name}")
    return number


def _place() -> tuple[Path, str]:
    """Return where the folder of the cache is, and its name. Raises RuntimeError if that is unknown."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    if named:
        return Path(named).absolute(), "craftsim-compiled"
    place = platformdirs.user_cache_path("craftsim")
    # An empty HOME would be the root folder.
    nowhere = os.environ.get("HOME") == "" and not os.environ.get("XDG_CACHE_HOME")
    if nowhere or not place.is_absolute():
        raise RuntimeError(
            "this user has no home directory; set HOME, or NUMBA_CACHE_DIR to a folder of your own"
        )
    return place, "compiled"


def _words(error: Exception) -> str:
    """Return what an error says, with the file that it names."""
    file = getattr(error, "filename", None)
    if file is None:
        return reason_of(error)
    return f"{file}: {reason_of(error)}"


def _opened(place: Path, name: str) -> int:
    """Return a descriptor of a folder within a place, created if needed, that nobody else can write to or replace.

    ``place`` is absolute and without links. Raises OSError where others may write to the folder, or replace it or one
    of the folders that it is in.
    """
    number = os.open("/", _PASS)
    path = Path("/")
    try:
        for name_part in place.parts[1:]:
            _check_passed(os.fstat(number), path)
            path /= name_part
            inner = os.open(name_part, _PASS, dir_fd=number)
            os.close(number)
            number = inner
        _check_passed(os.fstat(number), path)
        with suppress(FileExistsError):
            os.mkdir(name, 0o700, dir_fd=number)
        status = os.stat(name, dir_fd=number, follow_symlinks=False)
        if stat.S_ISLNK(status.st_mode):
            raise PermissionError(f"{place / name} is a link, which is not followed")
        _check(status, str(place / name))
        opened = os.open(name, _LIST, dir_fd=number)
    finally:
        os.close(number)
    try:
        # It may have been replaced since.
        _check(os.fstat(opened), str(place / name))
    except OSError:
        os.close(opened)
        raise
    return opened


def _check_passed(status: os.stat_result, path: Path) -> None:
    """Raise PermissionError for a folder in which others may replace what this user has made."""
    if status.st_uid not in (0, os.geteuid()):
        raise PermissionError(f"{path} belongs to another user, who may replace what is in it")
    # In a folder with the sticky bit, such as /tmp, each user can replace only what is their own.
    if _others_write(status) and not status.st_mode & stat.S_ISVTX:
        raise PermissionError(f"{path} is not yours alone to write to")


def _check(status: os.stat_result, name: str) -> None:
    """Raise PermissionError for a folder or file of the cache that is not this user's alone."""
    if status.st_uid != os.geteuid() or _others_write(status):
        raise PermissionError(f"{name} is not yours alone to write to")
    if not (stat.S_ISDIR(status.st_mode) or stat.S_ISREG(status.st_mode)):
        raise PermissionError(f"{name} is neither a folder nor a file")


def _others_write(status: os.stat_result) -> bool:
    # Where users have groups of their own, of the same number, a umask of 002 is usual.
    own_group = status.st_gid == os.getegid() == os.geteuid()
    others = stat.S_IWOTH
    if not own_group:
        others |= stat.S_IWGRP
    return bool(status.st_mode & others)


_turns = 0


@contextmanager
def alone() -> Iterator[None]:
    """Hold the lock that lets one process compile at a time; blocks may nest."""
    global _turns
    own_folder = folder()
    if own_folder is None or _turns:
        lock = None
    else:
        lock = _lock(own_folder)
    if own_folder is None or lock is None:
        yield
        return
    try:
        # Where there are no locks, none are kept out.
        with suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX)
        _turns += 1
        try:
            yield
        finally:
            _turns -= 1
            _remove_old(own_folder)
    finally:
        os.close(lock)


def _lock(folder: int) -> int | None:
    """Return a descriptor of the lock file, which stays empty; None if it cannot be opened, as where a link is."""
    try:
        return os.open(_LOCK, _CREATE_OR_OPEN, 0o600, dir_fd=folder)
    except OSError as error:
        PROGRESS_LOG.warning(
            "processes may compile the same at a time: %s: %s", _LOCK, reason_of(error)
        )
        return None


def _remove_old(folder: int) -> None:
    """Remove the least recently used files of the cache beyond the limit."""
    with suppress(OSError):
        used = list[tuple[float, str]]()
        for name in os.listdir(folder):
            if _OURS.fullmatch(name):
                used.append((os.stat(name, dir_fd=folder, follow_symlinks=False).st_mtime, name))
        used.sort(reverse=True)
        for _, name in used[_MOST:]:
            os.unlink(name, dir_fd=folder)
