"""Ctrl-C: heard between two pieces of work instead of in the midst of one."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def finishing_first() -> Iterator[None]:
    """Let what is inside end before a Ctrl-C is heard; a second Ctrl-C ends it at once.

    Where it is ignored, as by what a shell runs in the background, it stays so.
    """
    usual = signal.getsignal(signal.SIGINT)
    # None is a handler that is not Python's, which could not be put back; only the main thread hears of signals.
    if usual in (signal.SIG_IGN, None) or threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = False

    def note(*_: object) -> None:
        nonlocal heard
        heard = True
        signal.signal(signal.SIGINT, usual)

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
    if heard:
        raise KeyboardInterrupt
