"""How the rules are compiled: numba in nopython mode, cached on disk only when the cache is safe.

Numba stamps a cached function with the time of the one file that defines it, so a function that calls into
another of our files would go on using a stale copy after that file changes. The cache of all
our compiled functions therefore has a version that holds a digest of every source file of the grid world; where numba
does not let us, nothing is cached.

Compiled functions may not make arrays; they work on those they are given. So numba needs no reference counting in
them, which would otherwise take ten times as long as the rules themselves (``_nrt``), and all of them can be inlined.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba

_OPTIONS: Final[dict[str, Any]] = {"error_model": "numpy", "forceinline": True, "_nrt": False}

F = TypeVar("F", bound=Callable[..., Any])


@cache
def _source_digest() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def compiled(function: F) -> F:
    """Compile a function with numba at its first call; NUMBA_DISABLE_JIT=1 leaves it plain Python."""
    dispatcher: Any = numba.njit(function, **_OPTIONS)
    if dispatcher is function:
        return function
    try:
        dispatcher.enable_caching()
        cache_file = dispatcher._cache._cache_file
        # Read before anything else of a cache file: what an older craftsim left there may not even unpickle.
        cache_file._version = f"{cache_file._version} {_source_digest()}"
    except (AttributeError, RuntimeError):
        dispatcher = numba.njit(function, **_OPTIONS)
    return cast(F, dispatcher)
