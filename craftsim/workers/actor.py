"""Processes that craftsim starts: none hears of a Ctrl-C, and none imports what merely lies in the working folder.

Python lets a process that runs ``-c``, as all of multiprocessing do, look for modules in the working folder first: a
``multiprocessing.py`` there would run before anything of ours does.
"""

from __future__ import annotations

import os
import pickle
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import connection, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from queue import SimpleQueue
from typing import Any, Final

from craftsim.compiling import report_compiling, reports_compiling
from craftsim.errors import CraftsimError
from craftsim.modules import REGISTERING, SAFE_PATH, import_registering, safe_path, set_safe_path

Handler = Callable[[Any], Any]
"""From a request to its answer."""

_starting: Final = threading.Lock()


class WorkerDiedError(CraftsimError):
    """The process that did the work is gone; the message says how it ended."""


class Actor:
    """A spawned process that answers requests in their order, and ends when the process that made it does."""

    def __init__(self, make: Callable[[], Handler]) -> None:
        """Start the process, and return while it still starts.

        ``make`` is called there for what answers requests. It, the requests and the answers are pickled.
        """
        context = spawn_context()
        their_requests, self._requests = context.Pipe(duplex=False)
        self._answers, their_answers = context.Pipe(duplex=False)
        arguments = (their_requests, their_answers, make)
        self._process = context.Process(target=_serve, args=arguments, daemon=True, name="craftsim-worker")
        self._process.start()
        # With this end closed here, the death of the process is the end of the file.
        their_requests.close()
        their_answers.close()
        self.due = 0
        """Requests without an answer so far."""

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid or 0

    def send(self, request: Any) -> None:
        """Ask for something, and do not wait for it."""
        data = pickle.dumps(request)
        with suppress(OSError):  # of a process that has died, which recv says
            self._requests.send_bytes(data)
        self.due += 1

    def recv(self) -> Any:
        """Wait for the next answer, and return it; raises WorkerDiedError, and what the handler has raised."""
        try:
            good, value = self._answers.recv()
        except (EOFError, OSError) as error:
            raise self._died() from error
        self.due -= 1
        if not good:
            raise value
        return value

    def kill(self) -> None:
        """End the process at once."""
        self._process.kill()
        self._process.join()
        self._requests.close()
        self._answers.close()
        self._process.close()

    @staticmethod
    def wait(actors: Sequence[Actor], timeout_s: float | None) -> list[Actor]:
        """Return those actors of which :meth:`recv` need not wait, as soon as there are some, or none in that time."""
        by_connection = {actor._answers: actor for actor in actors}
        return [by_connection[found] for found in connection.wait(list(by_connection), timeout_s)]  # type: ignore[index]

    def _died(self) -> WorkerDiedError:
        self._process.join(5.0)
        status = self._process.exitcode
        if status is not None and status < 0:
            return WorkerDiedError(
                f"was killed by signal {-status} ({signal.Signals(-status).name}), as for want of memory"
            )
        return WorkerDiedError(
            f"ended by itself with status {status}; what it printed says why. A program that starts such processes "
            "must do so below \"if __name__ == '__main__':\""
        )


def _serve(requests: Connection, answers: Connection, make: Callable[[], Handler]) -> None:
    """Answer requests, in a process of its own, until the process that asks is gone."""
    waiting: SimpleQueue[bytes] = SimpleQueue()

    def listen() -> None:
        # In a thread of its own, so that nobody waits to be heard, and a process left alone ends in mid-work.
        while True:
            try:
                waiting.put(requests.recv_bytes())
            except (EOFError, OSError):
                os._exit(1)

    threading.Thread(target=listen, daemon=True).start()
    handler = make()
    while True:
        answers.send_bytes(_answer(handler, waiting.get()))


def _answer(handler: Handler, request: bytes) -> bytes:
    """Return whether a request has an answer, and the answer or what was raised, pickled."""
    try:
        return pickle.dumps((True, handler(pickle.loads(request))))
    except Exception as error:
        told = traceback.format_exc()
        try:
            data = pickle.dumps((False, error))
            pickle.loads(data)  # which some errors do not stand
        except Exception:
            return pickle.dumps((False, CraftsimError(f"what a process raised cannot be sent:\n{told}")))
        return data


def spawn_context() -> SpawnContext:
    """Return what starts processes, and makes their pipes, in place of ``get_context("spawn")``.

    They find the modules that this process finds at that moment. Whoever started them decides when they end.
    """
    # The first queue or lock would start it, as any process of Python is started.
    with _safe_path():
        resource_tracker.ensure_running()
    return _Context()


class _Process(SpawnProcess):
    def start(self) -> None:
        self._inherited = os.environ.get(SAFE_PATH)
        self._tells = reports_compiling()
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
            report_compiling()
        for module in self._registering:
            import_registering(module)
        super().run()


class _Context(SpawnContext):
    Process = _Process


@contextmanager
def _safe_path() -> Iterator[None]:
    with _starting, safe_path():
        yield


@contextmanager
def defer_sigint() -> Iterator[None]:
    """Let what is inside end before a Ctrl-C takes effect; a second Ctrl-C ends it at once.

    Where it is ignored, as by what a shell runs in the background, it stays so.
    """
    usual = signal.getsignal(signal.SIGINT)
    # None is a handler that is not Python's, which could not be put back; only the main thread hears of signals.
    if usual in (signal.SIG_IGN, None) or threading.current_thread() is not threading.main_thread():
        yield
        return
    interrupted = False

    def note(*_: object) -> None:
        nonlocal interrupted
        interrupted = True
        signal.signal(signal.SIGINT, usual)

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
    if interrupted:
        raise KeyboardInterrupt
