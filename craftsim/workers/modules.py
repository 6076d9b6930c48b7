"""Search for modules: those that ``module:name`` stands for in the working folder too, nothing else there."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any, Final

REGISTERING: Final[list[str]] = []
"""The modules that have registered something, in order, and the program itself if it has skills in use.

Processes that craftsim starts import them, too.
"""

MAIN: Final = ("__main__", "__mp_main__")
"""Names of the program that is run itself: in its process, and in one of multiprocessing that runs it again."""

SAFE_PATH = "PYTHONSAFEPATH"
"""Variable that keeps Python from looking for modules in the working folder first (``python -P``)."""


def import_user_module(name: str) -> ModuleType:
    """Import a module, Python's own first, the working folder's last, here and in processes started later."""
    with suppress(FileNotFoundError):  # a working folder that is gone has no modules
        folder = os.getcwd()
        if folder not in sys.path:
            sys.path.append(folder)
    return importlib.import_module(name)


def names_code(text: str) -> bool:
    """Return whether a text has the form of ``module:name``, for which :func:`find_named` imports a module."""
    name, _, attribute = text.partition(":")
    return all(name_part.isidentifier() for name_part in (*name.split("."), *attribute.split(".")))


def find_named(text: str, subject: str, example: str, allowed: str = "") -> Any:
    """Import a module, and return the object in it that ``module:name`` stands for; the name may have dots.

    ``subject`` names the text in messages; they show an ``example`` of its form, and what else is ``allowed``. Raises
    InputError for another form, a module that cannot be imported, and a name that it does not have.
    """
    from craftsim.errors import (  # not before the working folder is left out: it imports more
        InputError,
        suggestion,
    )

    name, _, attribute = text.partition(":")
    if not names_code(text):
        raise InputError(f"{subject}: must be {example}")
    try:
        module = import_user_module(name)
    except (Exception, SystemExit) as error:
        import textwrap

        reason = textwrap.shorten(f"{type(error).__name__}: {error}", 300, placeholder=" ...")
        if isinstance(error, ModuleNotFoundError):
            reason += "; modules are looked for in this folder too"
            if allowed:
                reason += f"; allowed: {allowed}"
        raise InputError(f"{subject}: module '{name}' cannot be imported: {reason}") from error
    value: Any = module
    for name_part in attribute.split("."):
        if not hasattr(value, name_part):
            hint = suggestion(name_part, [word for word in dir(value) if not word.startswith("_")])
            raise InputError(
                f"{subject}: '{name}' ({_place_of(module)}) has no '{attribute}'{hint}"
            )
        value = getattr(value, name_part)
    return value


PLUG_INS: Final = ("tasks", "skills", "machines")
"""What installed packages may offer by names of their own."""


def plug_ins(kind: str) -> dict[str, str]:
    """Return by name the ``module:name`` of what installed packages offer of a kind, one of ``PLUG_INS``.

    They are entry points of the group ``craftsim.KIND``. Nothing is imported. Raises InputError for a name that two
    packages give to different things.
    """
    from importlib.metadata import entry_points

    offered: dict[str, str] = {}
    for point in entry_points(group=f"craftsim.{kind}"):
        text = f"{point.module}:{point.attr}"
        if offered.setdefault(point.name, text) != text:
            from craftsim.errors import InputError

            raise InputError(
                f"two installed packages offer {kind} '{point.name}', {offered[point.name]} and {text}; "
                "name the one that you mean as module:name, or uninstall the other"
            )
    return offered


def note_registering(depth: int = 2) -> str:
    """Note, and return, the name of the module that registers something, ``depth`` calls from here."""
    return note(str(sys._getframe(depth).f_globals.get("__name__", "__main__")))


def note(name: str) -> str:
    """Note, and return, the name of a module that processes started later have to import."""
    if name not in REGISTERING:
        REGISTERING.append(name)
    return name


def import_registering(name: str) -> None:
    """Import a module for what it registers.

    A program that is run itself has no name to import it by: processes that it starts run it again first if it
    registers something, all but what stands below ``if __name__ == "__main__":``.
    """
    if name not in MAIN:
        import_user_module(name)


def look_for_modules(path: Iterable[str], registering: Iterable[str]) -> None:
    """Find the modules that another process finds on its path, and import what registers something there."""
    sys.path += [place for place in path if place not in sys.path]
    for name in registering:
        import_registering(name)


def _place_of(module: ModuleType) -> str:
    """Return where a module comes from: one of the working folder may have the name of an installed one."""
    return getattr(module, "__file__", None) or "a part of Python"


def leave_out_working_folder() -> None:
    """Forget the working folder, where ``python -m`` looks for modules first, unless craftsim itself is run from it."""
    with suppress(FileNotFoundError):
        if os.getcwd() == sys.path[0] != str(Path(__file__).parents[2]):
            del sys.path[0]


@contextmanager
def safe_path() -> Iterator[None]:
    """Let no process of Python that is started in the block look for modules in the working folder first.

    Packages that we use start some, too: glfw does when MuJoCo is imported, and with ``-c``.
    """
    usual = os.environ.get(SAFE_PATH)
    set_safe_path("1")
    try:
        yield
    finally:
        set_safe_path(usual)


def set_safe_path(value: str | None) -> None:
    """Set the variable of the environment for processes that are started from now on; None removes it."""
    if value is None:
        os.environ.pop(SAFE_PATH, None)
    else:
        os.environ[SAFE_PATH] = value
