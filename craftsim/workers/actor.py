"""Spawned processes, which ignore interrupts and do not import modules from the working folder.

A process started with ``python -c``, as by multiprocessing, looks for modules in the working folder first, so that a
``multiprocessing.py`` there would be executed. Nor do they run the user's program again, as those of multiprocessing
do: its functions and classes are pickled by value. Only one with skills, actions or tasks is run, for those.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import textwrap
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing import active_children, connection, current_process, resource_tracker, spawn
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from queue import SimpleQueue
from typing import Any, Final

import cloudpickle

from craftsim.compiled.progress import report_compiling, reports_compiling
from craftsim.errors import CraftsimError, InputError
from craftsim.workers.copying import OfOneProcess
from craftsim.workers.interrupts import INTERRUPT_SIGNALS, withstand_interrupts
from craftsim.workers.modules import (
    MAIN,
    REGISTERING,
    SAFE_PATH,
    import_registering,
    safe_path,
    set_safe_path,
)

RequestHandler = Callable[[Any], Any]
"""A function that answers a request."""

_MODULE: Final = "What functions of a program use is sent along; put such functions into a module, which is imported"
_starting: Final = threading.Lock()
_PROGRAM: Final = ("init_main_from_name", "init_main_from_path")
"""Keys under which multiprocessing tells a process of the program to run again."""


class WorkerDiedError(CraftsimError):
    """The worker process ended; the message says how."""


class Actor(OfOneProcess):
    """A spawned process that answers requests in order, and ends with its parent."""

    _instead = "start another one"

    def __init__(self, make: Callable[[], RequestHandler]) -> None:
        """Start the process without waiting for it.

        ``make`` is called there and returns the handler of requests. It, requests and answers are pickled. Raises
        InputError for one that cannot be.
        """
        program = {}
        if any(name in MAIN for name in REGISTERING):
            program = _program()
        begin = (program, tuple(REGISTERING), _pickled(make))
        context = spawn_context()
        their_requests, self._requests = context.Pipe(duplex=False)
        self._answers, their_answers = context.Pipe(duplex=False)
        arguments = (their_requests, their_answers, *begin)
        self._process = context.Process(
            target=_serve, args=arguments, daemon=True, name="craftsim-worker"
        )
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
        """Send a request without waiting.

        Raises InputError for one that cannot be pickled, and CraftsimError in a process that is forked from this one.
        """
        self.check_process()
        data = _pickled(request)
        with suppress(OSError):  # if the process has died, recv raises
            self._requests.send_bytes(data)
        self.due += 1

    def recv(self) -> Any:
        """Wait for the next answer and return it; raises WorkerDiedError, and the handler's exceptions."""
        self.check_process()
        try:
            good, value = self._answers.recv()
        except (EOFError, OSError) as error:
            raise self._died() from error
        self.due -= 1
        if not good:
            raise value
        return value

    def kill(self) -> None:
        """Kill the process; in a forked process only forget it."""
        if not self.is_forked:
            self._process.kill()
            self._process.join()
            self._process.close()
        self._requests.close()
        self._answers.close()

    @staticmethod
    def wait(actors: Sequence[Actor], timeout_s: float | None) -> list[Actor]:
        """Return the actors with an answer, as soon as there are some, or none after the timeout."""
        by_connection = {actor._answers: actor for actor in actors}
        return [by_connection[ready] for ready in connection.wait(list(by_connection), timeout_s)]  # type: ignore[index]

    def _died(self) -> WorkerDiedError:
        self._process.join(5.0)
        status = self._process.exitcode
        if status is not None and status < 0:
            return WorkerDiedError(
                f"was killed by signal {-status} ({signal.Signals(-status).name}), as for want of memory"
            )
        return WorkerDiedError(f"ended by itself with status {status}; what it printed says why")


def _pickled(value: Any) -> bytes:
    try:
        return bytes(cloudpickle.dumps(value))
    except (TypeError, AttributeError, pickle.PicklingError) as error:
        raise InputError(f"a worker process cannot be sent this: {error}. {_MODULE}") from error


def _unpickled(request: bytes) -> Any:
    try:
        return pickle.loads(request)
    except AttributeError as error:  # such as what functools.cache made of a function of a program
        raise InputError(
            f"a worker process has not what it was sent: {error}. {_MODULE}"
        ) from error


def _program() -> dict[str, str]:
    """Return what multiprocessing would tell a process of the user's program: its path or name, if it has one."""
    return {key: value for key, value in spawn.get_preparation_data("").items() if key in _PROGRAM}


def _serve(
    requests: Connection,
    answers: Connection,
    program: dict[str, str],
    registering: Sequence[str],
    make: bytes,
) -> None:
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
    try:
        _import_registering(program, registering)
    except InputError as error:
        handler = partial(_refuse, error)
    else:
        handler = pickle.loads(make)()
    while True:
        answers.send_bytes(_answer(handler, waiting.get()))


def _import_registering(program: dict[str, str], registering: Sequence[str]) -> None:
    """Run the user's program, all but what stands below ``__name__ == "__main__"``, and import modules.

    Raises InputError where one cannot be imported.
    """
    name = "".join(program.values())
    try:
        if program:
            # Multiprocessing, too, lets a program start no process meanwhile.
            current_process()._inheriting = True  # type: ignore[attr-defined]
            try:
                spawn.prepare(program)
            finally:
                del current_process()._inheriting  # type: ignore[attr-defined]
        for name in registering:
            import_registering(name)
    except (Exception, SystemExit) as error:
        reason = textwrap.shorten(f"{type(error).__name__}: {error}", 300, placeholder=" ...")
        raise InputError(
            f"{name}: worker processes import it for its skills, actions or tasks, and could not: {reason}. Of a "
            "program, all else must stand below \"if __name__ == '__main__':\""
        ) from error


def _refuse(error: InputError, request: Any) -> None:
    raise error


def _answer(handler: RequestHandler, request: bytes) -> bytes:
    """Return the pickled pair of success and answer, or failure and exception."""
    try:
        return bytes(cloudpickle.dumps((True, handler(_unpickled(request)))))
    except Exception as error:
        trace = traceback.format_exc()
        try:
            data = bytes(cloudpickle.dumps((False, error)))
            pickle.loads(data)  # fails for some errors
        except Exception:
            return pickle.dumps(
                (False, CraftsimError(f"what a process raised cannot be sent:\n{trace}"))
            )
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
        with _starting, safe_path(), _without_program():
            # Otherwise its first start unblocks the signals.
            resource_tracker.ensure_running()
            usual = signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPT_SIGNALS)
            try:
                super().start()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, usual)

    def run(self) -> None:
        withstand_interrupts()
        # Processes that user code starts have the usual path.
        set_safe_path(self._inherited)
        if self._tells:
            report_compiling()
        super().run()


@contextmanager
def _without_program() -> Iterator[None]:
    """Let multiprocessing tell the process that this thread starts nothing of the user's program."""
    usual = spawn.get_preparation_data
    thread = threading.get_ident()

    def prepared(name: str) -> dict[str, Any]:
        data = usual(name)
        if threading.get_ident() == thread:
            for key in _PROGRAM:
                data.pop(key, None)
        return data

    spawn.get_preparation_data = prepared
    try:
        yield
    finally:
        spawn.get_preparation_data = usual


class _Context(SpawnContext):
    Process = _Process


def _end_workers() -> None:
    """Kill the workers that are left when Python ends, since they ignore the SIGTERM of multiprocessing."""
    for process in active_children():
        if isinstance(process, _Process) and process.daemon:
            process.kill()


# After multiprocessing has registered its own function, so that this one runs before.
atexit.register(_end_workers)
