"""Processes that craftsim starts: none hears of a Ctrl-C, and none imports what merely lies in the working folder.

Python lets a process that runs ``-c``, as all of multiprocessing do, look for modules in the working folder first: a
``multiprocessing.py`` there would run before anything of ours does.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Final

from craftsim.compiling import is_told, tell
from craftsim.modules import REGISTERING, SAFE_PATH, import_registering, safe_path, set_safe_path

_starting: Final = threading.Lock()


def spawn_context() -> SpawnContext:
    """Return what starts processes, and makes their queues and locks, in place of ``get_context("spawn")``.

    They find the modules that this process finds at that moment. Whoever started them decides when they end.
    """
    # The first queue or lock would start it, as any process of Python is started.
    with _safe_path():
        resource_tracker.ensure_running()
    return _Context()


class _Process(SpawnProcess):
    def start(self) -> None:
        self._inherited = os.environ.get(SAFE_PATH)
        self._tells = is_told()
        self._registering = tuple(REGISTERING)
        with _safe_path():
            # Its first start would undo the block.
            resource_tracker.ensure_running()
            usual = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                super().start()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, usual)

    def run(self) -> None:
        # What code of the user's starts from here looks for its modules as it does elsewhere.
        set_safe_path(self._inherited)
        if self._tells:
            tell()
        for module in self._registering:
            import_registering(module)
        super().run()


class _Context(SpawnContext):
    Process = _Process


@contextmanager
def _safe_path() -> Iterator[None]:
    with _starting, safe_path():
        yield
