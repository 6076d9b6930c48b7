"""The command line that asks for the same results again."""

from __future__ import annotations

import shlex
from contextvars import ContextVar
from pathlib import Path
from typing import Final

from craftsim.cli.app import NO_MATTER

ASKED: Final[ContextVar[tuple[str, ...]]] = ContextVar("ASKED", default=())
"""The words of the command line that is being answered, under their present names."""
FOLDER: Final[ContextVar[Path | None]] = ContextVar("FOLDER", default=None)
"""The output folder of a command that names it itself where none is given."""


def command_again() -> str:
    """Return the line that asks for the results of this command again, wherever they go and however many work."""
    kept, leaving = list[str](), False
    for word in ASKED.get():
        option = word.partition("=")[0].removeprefix("--").removeprefix("no-") if word[:2] == "--" else None
        if option is not None:
            leaving = option in NO_MATTER
        if not leaving:
            kept.append(word)
        leaving = leaving and option != "resume" and "=" not in word
    return shlex.join(["craftsim", *kept])
