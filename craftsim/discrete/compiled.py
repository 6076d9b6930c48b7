"""How the rules are compiled: numba in nopython mode, cached on disk only when the cache is safe.

Numba stamps a cached function with the time of the one file that defines it, so a function that calls into
another of our files would go on using a stale copy after that file changes. All our compiled functions are
therefore stamped with a digest of every source file in this folder; where numba does not let us, nothing is
cached.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


@cache
def _source_digest() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def compiled(function: F) -> F:
    """Compile a function with numba at its first call; NUMBA_DISABLE_JIT=1 leaves it plain Python."""
    dispatcher: Any = numba.njit(function, error_model="numpy")
    if dispatcher is function:
        return function
    try:
        dispatcher.enable_caching()
        cache_file = dispatcher._cache._cache_file
        if not hasattr(cache_file, "_source_stamp"):
            raise AttributeError("numba's cache has no source stamp")
        cache_file._source_stamp = _source_digest()
    except (AttributeError, RuntimeError):
        dispatcher = numba.njit(function, error_model="numpy")
    return cast(F, dispatcher)
