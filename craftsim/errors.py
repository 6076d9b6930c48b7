"""Errors a user can cause and fix."""

from __future__ import annotations

import difflib
import errno
import os
from collections.abc import Iterable
from traceback import walk_tb
from typing import Final

DISK_ERRORS: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO})
"""Numbers of the OSErrors that the place where results go is to blame for."""


FEW_FILES: Final = frozenset({errno.EMFILE, errno.ENFILE})
"""Numbers of the OSErrors for too many open files."""
LITTLE_MEMORY: Final = (
    "failed to map segment",
    "cannot allocate memory",
    "can't start new thread",
    "out of memory",
)
"""What errors other than MemoryError say where memory, or room for a process or thread, is short."""


class CraftsimError(Exception):
    """Base of all errors that craftsim raises on purpose; the command line turns them into exit code 2."""


class InputError(CraftsimError):
    """A file or argument is wrong; the message says where, what is allowed and what to try."""


class BlueprintError(InputError):
    """A blueprint or goal file is wrong."""


class StartError(InputError):
    """A world cannot stand as it is drawn."""


class PlanError(InputError):
    """A plan file is wrong."""


class RenderingUnavailable(CraftsimError):
    """No backend renders a frame on this machine; the message says why and which command fixes it."""


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the known word closest to a misspelt one, or an empty string."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f"; did you mean '{close[0]}'?" if close else ""


def check_choice(name: str, value: object, known: Iterable[str]) -> None:
    """Raise InputError for what is none of the known words; ``name`` says what is chosen.

    Example:
        >>> from craftsim.errors import check_choice
        >>> check_choice("engine", "local", ("local", "ray"))
    """
    words = list(known)
    if value not in words:
        raise InputError(
            f"unknown {name} '{value}'{suggestion(str(value), words)}; there are {', '.join(words)}"
        )


def is_interrupt(error: BaseException) -> bool:
    """Return whether an error is a Ctrl-C, also one that the import of an extension module such as MuJoCo's hides."""
    cause: BaseException | None = error
    while isinstance(cause, ImportError):
        cause = cause.__cause__ or cause.__context__
    return isinstance(cause, KeyboardInterrupt)


def shortage(error: BaseException) -> str:
    """Return what this machine or its limits have too little of, if that is the reason of an error; empty if not."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in FEW_FILES:
            return "too many files are open; raise the limit, which 'ulimit -n' shows, or take fewer --workers"
        text = str(cause).lower()
        if isinstance(cause, MemoryError) or (
            isinstance(cause, OSError) and cause.errno == errno.ENOMEM
        ):
            return _MEMORY
        if any(words in text for words in LITTLE_MEMORY):
            return _MEMORY
        cause = cause.__cause__ or cause.__context__
    return ""


REFUSING: Final = {
    "matplotlib": ("MPL",),
    "mujoco": ("MUJOCO_", "PYOPENGL_"),
    "numba": ("NUMBA_",),
    "OpenGL": ("PYOPENGL_",),
}
"""Packages that read variables of the environment when they are imported, and how the names of these begin."""


def refused_variables(error: BaseException) -> list[str]:
    """Return the variables of the environment for which the import of a package may have failed; empty if none."""
    packages = set[str]()
    for frame, _ in walk_tb(error.__traceback__):
        if frame.f_code.co_name == "<module>":
            packages.add(str(frame.f_globals.get("__name__")).partition(".")[0])
    beginnings = tuple(
        begins for package in REFUSING if package in packages for begins in REFUSING[package]
    )
    return [name for name in sorted(os.environ) if name.startswith(beginnings)]


def refusal(error: BaseException) -> str:
    """Return which package refuses what of the environment, if that may be the reason of an error; empty if not."""
    names = refused_variables(error)
    if not names:
        return ""
    values = ", ".join(f"{name}={os.environ[name]}" for name in names)
    return f"a package cannot be imported where {values}: {error}; to leave that out: unset {' '.join(names)}"


_MEMORY: Final = (
    "too little memory, or room for processes; craftsim takes some gigabytes of addresses: raise the limits, which "
    "'ulimit -v' and 'ulimit -u' show, or take fewer --workers"
)
