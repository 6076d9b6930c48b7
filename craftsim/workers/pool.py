"""A pool of workers for picklable jobs, with time limits, retries, and state kept between jobs."""

from __future__ import annotations

import ctypes
import gc
import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, Final, Literal, Self, TypeAlias, TypeVar, get_args

from craftsim.errors import CraftsimError, check_choice
from craftsim.workers.actor import Actor, RequestHandler, WorkerDiedError
from craftsim.workers.copying import NotCopyable
from craftsim.workers.interrupts import defer_interrupts
from craftsim.workers.ray_actor import RayActor, processors

Engine = Literal["local", "ray"]
"""Local processes, or actors of an existing Ray cluster."""
_Job = TypeVar("_Job")
_Answer = TypeVar("_Answer")

_RELEASE_EVERY: Final = 20


@dataclass(frozen=True)
class Failure:
    """The reason why a job has no result: a timeout, or repeated death of its worker; of a trial also an exception."""

    text: str
    stops: bool = False
    """The run must stop, for instance on a full disk."""
    traceback: str = ""


def answered(answer: _Answer | Failure) -> _Answer:
    """Return an answer; raise CraftsimError where there is none."""
    if isinstance(answer, Failure):
        raise CraftsimError(answer.text)
    return answer


_Batch: TypeAlias = tuple[tuple[Any, ...], int]
"""Jobs sent together, and the number of workers that died on them as a single job."""


@dataclass(eq=False)
class _Worker:
    actor: Any
    function: object = None
    batch: _Batch = ((), 0)
    has_batch: bool = False
    """False while it is still loading the function, which does not count for the time limit."""
    end_s: float = math.inf

    def send(self, timeout_s: float) -> None:
        jobs, _ = self.batch
        self.has_batch = True
        self.end_s = time.monotonic() + timeout_s * len(jobs)
        self.actor.send((None, jobs))


class Pool(NotCopyable):
    """Context manager of up to ``n`` worker processes, started on demand and kept until the pool is closed.

    Workers end with this process and ignore interrupts: Ctrl-C, SIGTERM and SIGHUP.
    """

    _instead = "make another one"

    def __init__(self, n: int, engine: Engine = "local") -> None:
        """Start no worker yet; on Ray their number is limited by the processors.

        Raises InputError without a cluster.
        """
        check_choice("engine", engine, get_args(Engine))
        self._kind: Any = Actor
        self._n = n
        if engine == "ray":
            self._kind = RayActor
            self._n = min(n, processors())
        self._idle: list[_Worker] = []
        self._running: dict[Any, _Worker] = {}

    def map_unordered(
        self,
        function: Callable[[_Job], _Answer],
        jobs: Iterable[_Job],
        timeout_s: float = math.inf,
        batch: int = 1,
        retries: int = 1,
    ) -> Iterator[tuple[_Job, _Answer | Failure]]:
        """Yield each job with its answer, as soon as it is known; exceptions of the function are raised here.

        Each worker keeps its own copy of the picklable ``function`` as long as it gets jobs for it. Jobs are started in
        their order and consumed as workers become free, ``batch`` sent together; if one of these fails, each is run
        again alone. A worker is killed after ``timeout_s`` a job; a job whose worker died is repeated ``retries``
        times.

        Raises InputError if a Ray cluster is gone.
        """
        remaining = iter(jobs)
        repeated: deque[_Batch] = deque()

        def begin() -> None:
            while len(self._running) < self._n:
                if repeated:
                    next_batch = repeated.popleft()
                else:
                    next_batch = tuple(islice(remaining, batch)), 0
                if not next_batch[0]:
                    break
                self._begin(function, next_batch, timeout_s)
            # A cluster that has lost a node may never start a worker.
            for worker in list(self._running.values()):
                if self._idle and not worker.has_batch:
                    self._kill(worker)
                    self._begin(function, worker.batch, timeout_s)

        try:
            begin()
            while self._running:
                settled: list[tuple[_Job, _Answer | Failure]] = []
                for worker, is_late in self._wait():
                    (first, *other_jobs), deaths = worker.batch
                    answers = []
                    lost = ""
                    if is_late:
                        lost = f"no answer within {timeout_s:g} s"
                    else:
                        try:
                            answers = worker.actor.recv()
                        except WorkerDiedError:
                            lost = f"its worker process died, {deaths + 1} times"
                    if lost:
                        self._kill(worker)
                        if other_jobs:
                            for job in reversed((first, *other_jobs)):
                                repeated.appendleft(((job,), 0))
                        elif is_late or deaths >= retries:
                            settled.append((first, Failure(lost)))
                        else:
                            repeated.appendleft(((first,), deaths + 1))
                    elif worker.has_batch:
                        settled += zip((first, *other_jobs), answers, strict=True)
                        self._idle.append(self._running.pop(worker.actor))
                    else:
                        worker.send(timeout_s)
                # Workers continue while their answers are used.
                begin()
                yield from settled
        finally:
            for worker in list(self._running.values()):
                self._kill(worker)

    def _begin(self, function: object, batch: _Batch, timeout_s: float) -> None:
        # An interrupt in between would leave an unknown process.
        with defer_interrupts():
            if self._idle:
                worker = self._idle.pop()
            else:
                worker = _Worker(self._kind(partial(_server, self._n)))
            self._running[worker.actor] = worker
        worker.batch = batch
        if worker.function is function:
            worker.send(timeout_s)
        else:
            worker.function = function
            worker.has_batch = False
            worker.end_s = math.inf
            worker.actor.send((function, ()))

    def _wait(self) -> list[tuple[_Worker, bool]]:
        """Return the workers that answered or died, as soon as there are some, and those past their deadline."""
        end_s = min(worker.end_s for worker in self._running.values())
        timeout_s = None
        if not math.isinf(end_s):
            timeout_s = max(0.0, end_s - time.monotonic())
        ready = self._kind.wait(list(self._running), timeout_s)
        now_s = time.monotonic()
        workers = [(self._running[actor], False) for actor in ready]
        for actor, worker in self._running.items():
            if worker.end_s <= now_s and actor not in ready:
                workers.append((worker, True))
        return workers

    def _kill(self, worker: _Worker) -> None:
        with defer_interrupts():
            del self._running[worker.actor]
            worker.actor.kill()

    def close(self) -> None:
        """Kill all workers."""
        with defer_interrupts():
            workers = [*self._idle, *self._running.values()]
            self._idle = []
            self._running = {}
            for worker in workers:
                worker.actor.kill()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _server(n_workers: int) -> RequestHandler:
    """Return the handler in a worker, which applies the last function that it received."""
    # Otherwise Mesa's software renderer uses all processors in each worker.
    os.environ.setdefault("LP_NUM_THREADS", str(max(1, usable_processors() // n_workers)))
    function = None
    done = 0

    def answers(request: tuple[Callable[[Any], Any] | None, Sequence[Any]]) -> Iterator[Any]:
        nonlocal function, done
        function = request[0] or function
        for job in request[1]:
            assert function is not None
            yield function(job)
            done += 1
            if done % _RELEASE_EVERY == 0:
                _release_memory()

    return lambda request: list(answers(request))


def usable_processors() -> int:
    """Return the number of processors that this process may use, or, where that is not known, of the machine."""
    try:
        return len(os.sched_getaffinity(0))
    except (AttributeError, OSError):  # systems other than Linux, and sandboxes
        return os.cpu_count() or 1


def _release_memory() -> None:
    """Return freed memory to the system, since a heap fragmented by many worlds lets a process grow."""
    gc.collect()
    # Only glibc has it.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim:
        trim(0)
