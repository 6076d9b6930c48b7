"""Packages that only some commands need: the extras of pyproject.toml."""

from __future__ import annotations

import re
import sys
from importlib.metadata import requires
from importlib.util import find_spec

from craftsim.errors import InputError


def need(extra: str, what: str, *modules: str, remark: str = "") -> None:
    """Raise InputError with the command that installs an extra, where ``what`` ("tuning needs") lacks a module."""
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        raise InputError(f"{what} {', '.join(missing)}, not installed here; try: {install(extra)}{remark}")


def install(extra: str) -> str:
    """Return the command that installs what an extra brings, and leaves craftsim as it is installed.

    ``pip install '.[extra]'`` would put a copy in the place of a checkout that is installed as it stands.
    """
    mark = re.compile(rf"(.*?)\s*;\s*extra == ['\"]{extra}['\"]")
    wanted = [found[1] for line in requires("craftsim") or [] if (found := mark.fullmatch(line))]
    named = " ".join(f"'{requirement}'" for requirement in wanted)
    return f"{sys.executable} -m pip install {named}"
