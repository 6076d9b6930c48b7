"""Spawned processes, which ignore Ctrl-C and do not import modules from the working folder.

A process started with ``python -c``, as by multiprocessing, looks for modules in the working folder first, so that a
``multiprocessing.py`` there would be executed.
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

_starting: Final = threading.Lock()


class WorkerDiedError(CraftsimError):
    """The worker process ended; the message says how."""


class Actor:
    """A spawned process that answers requests in order, and ends with its parent."""

    def __init__(self, make: Callable[[], Handler]) -> None:
        """Start the process without waiting for it.

        ``make`` is called there and returns the handler of requests. It, requests and answers are pickled.
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

    @property
    def pid(self) -> int:
        """Process ID."""
        return self._process.pid or 0

    def send(self, request: Any) -> None:
        """Send a request without waiting."""
        data = pickle.dumps(request)
        with suppress(OSError):  # if the process has died, recv raises
            self._requests.send_bytes(data)
        self.due += 1

    def recv(self) -> Any:
        """Wait for the next answer and return it; raises WorkerDiedError, and the handler's exceptions."""
        try:
            good, value = self._answers.recv()
        except (EOFError, OSError) as error:
            raise self._died() from error
        self.due -= 1
        if not good:
            raise value
        return value

    def kill(self) -> None:
        """Kill the process."""
        self._process.kill()
        self._process.join()
        self._requests.close()
        self._answers.close()
        self._process.close()

    @staticmethod
    def wait(actors: Sequence[Actor], timeout_s: float | None) -> list[Actor]:
        """Return the actors with an answer, as soon as there are some, or none after the timeout."""
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
    """Answer requests in the worker until the parent process ends."""
    waiting: SimpleQueue[bytes] = SimpleQueue()

    def listen() -> None:
        # In a thread, so that the parent never blocks, and the worker of a dead parent ends at once.
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
    """Return the pickled pair of success and answer, or failure and exception."""
    try:
        return pickle.dumps((True, handler(pickle.loads(request))))
    except Exception as error:
        trace = traceback.format_exc()
        try:
            data = pickle.dumps((False, error))
            pickle.loads(data)  # fails for some errors
        except Exception:
            return pickle.dumps((False, CraftsimError(f"what a process raised cannot be sent:\n{trace}")))
        return data


def spawn_context() -> SpawnContext:
    """Return a multiprocessing context that replaces ``get_context("spawn")``.

    Its processes have the module path of this process at that moment.
    """
    # Otherwise the first queue or lock starts it, with the usual path.
    with _starting, safe_path():
        resource_tracker.ensure_running()
    return _Context()


class _Process(SpawnProcess):
    def start(self) -> None:
        self._inherited = os.environ.get(SAFE_PATH)
        self._tells = reports_compiling()
        self._registering = tuple(REGISTERING)
        with _starting, safe_path():
            # Otherwise its first start unblocks the signal.
            resource_tracker.ensure_running()
            usual = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                super().start()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, usual)

    def run(self) -> None:
        # Processes that user code starts have the usual path.
        set_safe_path(self._inherited)
        if self._tells:
            report_compiling()
        for module in self._registering:
            import_registering(module)
        super().run()


class _Context(SpawnContext):
    Process = _Process


@contextmanager
def defer_sigint() -> Iterator[None]:
    """Defer the first Ctrl-C until the block ends; a second one interrupts at once.

    An ignored signal, as in a background job of a shell, stays ignored.
    """
    usual = signal.getsignal(signal.SIGINT)
    # None is a handler of C code, which cannot be restored; only the main thread gets signals.
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
