"""What commands say while the rules and controllers are being compiled, which the first of them waits for."""

from __future__ import annotations

import logging
import sys
import time
from typing import Final

LOG: Final = logging.getLogger("craftsim.compiling")
"""Says at level INFO how far compiling is: its arguments are how many functions are done, and how many there are."""
_LINE_EVERY_S: Final = 5.0
"""Where lines cannot be written again one follows the other after so long, the first after a second."""


class CompilingHandler(logging.Handler):
    """Says on standard error how far compiling is: in one line of a terminal, in a few lines elsewhere."""

    def __init__(self) -> None:
        """Have nothing said yet."""
        super().__init__()
        self._next_s: float | None = None

    def emit(self, record: logging.LogRecord) -> None:
        """Show a message, if it is time for one."""
        error = sys.stderr
        if error is None:
            return
        text = f"craftsim: {record.getMessage()}"
        if record.levelno > logging.INFO:
            print(text, file=error)
        elif error.isatty() and error is sys.__stderr__:
            done, total = record.args if isinstance(record.args, tuple) else (0, 1)
            # The line is removed in the end.
            print(f"\r\x1b[K{text}" if done != total else "\r\x1b[K", end="", file=error, flush=True)
        else:
            # A file, a pipe, or a terminal on which a progress bar is, above which lines go.
            now = time.monotonic()
            self._next_s = now + 1 if self._next_s is None else self._next_s
            if now >= self._next_s:
                self._next_s = now + _LINE_EVERY_S
                print(text, file=error, flush=True)


def report_compiling() -> None:
    """Say from now on how far compiling is, in this process and in those that it starts."""
    if not reports_compiling():
        LOG.addHandler(CompilingHandler())
        LOG.setLevel(logging.INFO)
        LOG.propagate = False


def reports_compiling() -> bool:
    """Return whether this process says it."""
    return any(isinstance(handler, CompilingHandler) for handler in LOG.handlers)
