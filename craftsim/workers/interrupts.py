"""Signals that interrupt a command: Ctrl-C, and those that ask a process to end, which are treated alike.

SIGTERM comes from ``kill``, Slurm, systemd and ``docker stop``, SIGHUP from a terminal that closes.
"""

from __future__ import annotations

import ctypes
import math
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

_ENDING: Final = (signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a process to end."""
INTERRUPT_SIGNALS: Final = (signal.SIGINT, *_ENDING)
"""All signals that interrupt a command."""
_SAME_S: Final = 0.5
"""Signals within this time of the first are one request: ``timeout`` and a terminal that closes send theirs twice."""
_AGAIN_S: Final = 0.05
"""Time after which a signal is raised again, for which no interrupt could be raised."""


class _Interrupt:
    """A signal handler that raises KeyboardInterrupt, once for signals that come together."""

    def __init__(self) -> None:
        self._last_s = -math.inf
        self._number: int = signal.SIGINT
        self._again: threading.Timer | None = None

    def __call__(self, number: int, _: object) -> None:
        self._number = number
        if self.is_new_request():
            raise KeyboardInterrupt

    def raise_again(self) -> None:
        """Raise the last signal again in a moment, as a new request."""
        self.cancel()
        self._last_s = -math.inf
        self._again = threading.Timer(_AGAIN_S, signal.raise_signal, [self._number])
        self._again.daemon = True
        self._again.start()

    def cancel(self) -> None:
        """Raise nothing again."""
        if self._again is not None:
            self._again.cancel()

    def is_new_request(self) -> bool:
        """Return whether the signal that has just come is not the repetition of one shortly before."""
        now_s = time.monotonic()
        if now_s - self._last_s < _SAME_S:
            return False
        self._last_s = now_s
        return True


@contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C, SIGTERM and SIGHUP raise KeyboardInterrupt within the block.

    A signal that is ignored, as SIGHUP under ``nohup``, stays ignored, and a handler of the program itself stays. Where
    Python ignores exceptions, as in callbacks of numba's compiler and in finalizers, it comes a little later.
    """
    # Python lets only the main thread handle signals.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = dict[signal.Signals, Any]()
    for number in INTERRUPT_SIGNALS:
        handler = signal.getsignal(number)
        if handler in (signal.SIG_DFL, signal.default_int_handler):
            usual[number] = handler
    # Within another such block nothing is left to do.
    if not usual:
        yield
        return
    interrupt = _Interrupt()
    usual_hook = sys.unraisablehook

    def hear_again(ignored: UnraisableHookArgs) -> None:
        if issubclass(ignored.exc_type, KeyboardInterrupt):
            interrupt.raise_again()
        else:
            usual_hook(ignored)

    for number in usual:
        signal.signal(number, interrupt)
    sys.unraisablehook = hear_again
    try:
        yield
    finally:
        interrupt.cancel()
        sys.unraisablehook = usual_hook
        for number, handler in usual.items():
            signal.signal(number, handler)


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """Defer the first interrupt until the block ends; a second one interrupts at once.

    An ignored signal, as in a background job of a shell, stays ignored. The import of trimesh needs this: it takes
    whatever is raised while it imports a package for that package's absence, and goes on.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = dict[signal.Signals, Any]()
    for number in INTERRUPT_SIGNALS:
        handler = signal.getsignal(number)
        # SIGTERM and SIGHUP are those of a program's own handler unless a command has taken them over.
        if isinstance(handler, _Interrupt) or (number == signal.SIGINT and callable(handler)):
            usual[number] = handler
    interrupted = False

    def note(number: int, frame: Any) -> None:
        nonlocal interrupted
        handler = usual[signal.Signals(number)]
        if isinstance(handler, _Interrupt) and not handler.is_new_request():
            return
        if interrupted:
            raise KeyboardInterrupt
        interrupted = True

    for number in usual:
        signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in usual.items():
            signal.signal(number, handler)
    if interrupted:
        raise KeyboardInterrupt


def note_answered() -> None:
    """Tell Python that an interrupt has been answered.

    Where one passes through code that an extension module runs as text, Python notes that nobody has handled it, and
    at its end kills this process by SIGINT, whatever the exit status. Running other text takes that back.
    """
    ctypes.pythonapi.PyRun_SimpleString(b"")


def withstand_interrupts() -> None:
    """Let this process, a worker, ignore all interrupts: the process that started it hears them, and ends it.

    Programs that the worker starts do not inherit that.
    """
    for number in INTERRUPT_SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _do_nothing)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, INTERRUPT_SIGNALS)


def _do_nothing(*_: object) -> None:
    pass
