"""Progress messages while the rules and controllers are compiled, on the first run."""

from __future__ import annotations

import logging
import sys
import time
from typing import Final

PROGRESS_LOG: Final = logging.getLogger("craftsim.compiled.progress")
"""Logs progress at level INFO; the arguments are the numbers of compiled and of all functions."""
_LINE_EVERY_S: Final = 5.0
"""Interval of lines without a terminal; the first follows after a second."""


class _CompilingHandler(logging.Handler):
    """Prints the progress on standard error: one updated line on a terminal, a few lines elsewhere."""

    def __init__(self) -> None:
        """Start without output."""
        super().__init__()
        self._next_s: float | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """Print a message, if one is due."""
        error = sys.stderr
        if error is None:
            return
        text = f"craftsim: {record.getMessage()}"
        if record.levelno > logging.INFO:
            print(text, file=error)
        elif error.isatty() and error is sys.__stderr__:
            # The line is removed in the end.
            if isinstance(record.args, tuple) and record.args[0] == record.args[1]:
                text = ""
            print(f"\r\x1b[K{text}", end="", file=error, flush=True)
        else:
            # A file, a pipe, or a terminal on which a progress bar is, above which lines go.
            now_s = time.monotonic()
            if self._next_s is None:
                self._next_s = now_s + 1
            if now_s >= self._next_s:
                self._next_s = now_s + _LINE_EVERY_S
                print(text, file=error, flush=True)


def report_compiling() -> None:
    """Print the progress of compiling from now on, in this process and its children."""
    if not reports_compiling():
        PROGRESS_LOG.addHandler(_CompilingHandler())
        PROGRESS_LOG.setLevel(logging.INFO)
        PROGRESS_LOG.propagate = False


def reports_compiling() -> bool:
    """Return whether this process prints it."""
    return any(isinstance(handler, _CompilingHandler) for handler in PROGRESS_LOG.handlers)
