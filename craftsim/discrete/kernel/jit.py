"""How rules and controllers are compiled: numba in nopython mode, cached on disk only when the cache is safe.

Numba stamps a cached function with the time of the one file that defines it, so a function that calls into
another of our files would go on using a stale copy after that file changes. The cache of all
our compiled functions therefore has a version that holds a digest of every source file of their room and of the rooms
below it; where numba does not let us, nothing is cached. One process at a time compiles a function: numba's own cache
is not made for two that write to it, and would let each of the workers of a campaign compile everything.

Compiled functions may not make arrays; they work on those they are given. So numba needs no reference counting in
them, which would otherwise take ten times as long as the rules themselves (``_nrt``), and all of them can be inlined.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

_ROOMS: Final = ("discrete", "models", "skills", "checking", "planning")
"""Those that hold compiled functions; each calls functions of its own and of those before it."""
_OPTIONS: Final[dict[str, Any]] = {"error_model": "numpy", "forceinline": True, "_nrt": False}

F = TypeVar("F", bound=Callable[..., Any])
Record = Any
"""One of :func:`records` in a compiled function: its fields are attributes, and writing to them changes the array."""


@cache
def _source_digest(room: str) -> str:
    """Return the digest of the sources of a room and of those before it, all of them for a room that is not listed."""
    before = _ROOMS[: _ROOMS.index(room)] if room in _ROOMS else _ROOMS
    digest = hashlib.sha256()
    if before:
        digest.update(_source_digest(before[-1]).encode())
    if room in _ROOMS:
        for path in sorted((Path(__file__).parents[2] / room).rglob("*.py")):
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def compiled(function: F) -> F:
    """Compile a function with numba at its first call; NUMBA_DISABLE_JIT=1 leaves it plain Python."""
    dispatcher: Any = numba.njit(function, **_OPTIONS)
    if dispatcher is function:
        return function
    try:
        with _cache_of_the_environment():
            dispatcher.enable_caching()
        cache_file = dispatcher._cache._cache_file
        # Read before anything else of a cache file: what an older craftsim left there may not even unpickle.
        room = function.__module__.partition(".")[2].partition(".")[0]
        cache_file._version = f"{cache_file._version} {_source_digest(room)}"
        _one_process_at_a_time(dispatcher, Path(cache_file._index_path))
    except (AttributeError, RuntimeError):
        dispatcher = numba.njit(function, **_OPTIONS)
    return cast(F, dispatcher)


@contextmanager
def _cache_of_the_environment() -> Iterator[None]:
    """Let the environment alone say where the cache is.

    Numba heeds the file .numba_config.yaml of the working folder, too, and it unpickles what it finds in a cache.
    """
    names = [name for name in ("CACHE_DIR", "CACHE_LOCATOR_CLASSES") if hasattr(numba.config, name)]
    usual = {name: getattr(numba.config, name) for name in names}
    for name in names:
        setattr(numba.config, name, os.environ.get(f"NUMBA_{name}", ""))
    try:
        yield
    finally:
        for name in names:
            setattr(numba.config, name, usual[name])


def _one_process_at_a_time(dispatcher: Any, index: Path) -> None:
    """Let the processes that need a function wait for the one that compiles it, and read what it leaves."""
    compile_or_read = dispatcher.compile

    def compile_alone(signature: Any) -> Any:
        with _locked(index):
            return compile_or_read(signature)

    dispatcher.compile = compile_alone


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Keep other processes out of the block for the same path; where there are no locks, none are kept out."""
    place = zlib.crc32(path.name.encode())
    number = None
    # The system refuses a lock that two processes would wait for each other with.
    with suppress(OSError):
        number = _lock_file(path.parent)
        fcntl.lockf(number, fcntl.LOCK_EX, 1, place)
    try:
        yield
    finally:
        if number is not None:
            fcntl.lockf(number, fcntl.LOCK_UN, 1, place)


@cache
def _lock_file(folder: Path) -> int:
    """Return the number of an open file with a byte for each function; it stays open as long as the process lives."""
    folder.mkdir(parents=True, exist_ok=True)
    return os.open(folder / "compiling.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)


def records(count: int, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Return zeroed records for compiled functions, which read and write ``array[i].field``."""
    array = np.zeros(count, dtype)
    # Without the compiler, records need a type of their own for that; with it, that type is slow to recognise.
    return array.view(np.recarray) if numba.config.DISABLE_JIT else array  # type: ignore[attr-defined]
