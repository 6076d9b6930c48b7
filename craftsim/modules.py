"""Where modules are looked for: those that ``module:name`` stands for in the working folder too, nothing else there."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType

SAFE_PATH = "PYTHONSAFEPATH"
"""What keeps Python from looking for modules in the working folder first (``python -P``), for ``-c`` and ``-m``."""


def import_own(name: str) -> ModuleType:
    """Import a module by its name: Python's own come first, then installed ones, the working folder last.

    Processes that are started afterwards look for modules there, too. Raises what the import raises.
    """
    with suppress(FileNotFoundError):  # a working folder that is gone has no modules
        if (here := os.getcwd()) not in sys.path:
            sys.path.append(here)
    return importlib.import_module(name)


def place_of(module: ModuleType) -> str:
    """Return where a module comes from: one of the working folder may have the name of an installed one."""
    return getattr(module, "__file__", None) or "a part of Python"


def leave_out_working_folder() -> None:
    """Forget the working folder, where ``python -m`` looks for modules first, unless craftsim itself is run from it."""
    with suppress(FileNotFoundError):
        if os.getcwd() == sys.path[0] != str(Path(__file__).parents[1]):
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
