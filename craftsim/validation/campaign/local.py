"""Workers that are processes of this machine."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from concurrent.futures import CancelledError
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import parent_process

from pebble import ProcessExpired, ProcessFuture, ProcessPool

from craftsim.processes import spawn_context
from craftsim.validation.campaign.distribute import WorkerDiedError
from craftsim.validation.campaign.items import Answer, Item, Work, perform


class LocalWorker:
    """A spawned process, so that nothing of this one leaks into its results; made anew when it dies."""

    def __init__(self, work: Work) -> None:
        """Prepare a process for a picklable function; it starts with the first items."""
        self._work = work
        self._lock = threading.Lock()
        self._closed = False
        self._pool: ProcessPool | None = None
        self._running: ProcessFuture[list[Answer]] | None = None

    def run(self, items: Sequence[Item], timeout_s: float) -> list[Answer]:
        """Do several items, see :class:`~craftsim.validation.campaign.distribute.Worker`."""
        try:
            return self._schedule([item.job for item in items], timeout_s).result()
        except (ProcessExpired, BrokenProcessPool, CancelledError) as error:
            # A process that was killed may have held a lock of its pool, which only a new pool is sure to be rid of.
            with self._lock:
                self._stop()
            raise WorkerDiedError from error

    def close(self) -> None:
        """End the process at once."""
        with self._lock:
            self._closed = True
            if self._running is not None:
                self._running.cancel()
            self._stop()

    def _schedule(self, jobs: list[object], timeout_s: float) -> ProcessFuture[list[Answer]]:
        with self._lock:
            if self._closed:
                raise WorkerDiedError
            if self._pool is None:
                # A pool of one: in a larger one all wait for the locks of one that is killed.
                self._pool = ProcessPool(1, initializer=_end_with_parent, context=spawn_context())
            self._running = self._pool.schedule(perform, (self._work, jobs), timeout=timeout_s)
            return self._running

    def _stop(self) -> None:
        if self._pool is not None:
            self._pool.stop()
            self._pool.join()
            self._pool = None


def _end_with_parent() -> None:
    """Let this process end when the one that started it is killed, even in the middle of a trial."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
