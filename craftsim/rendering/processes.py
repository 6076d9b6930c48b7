"""Frames of a film, or whole films, from several processes."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import closing
from dataclasses import replace
from multiprocessing.synchronize import Event
from types import TracebackType
from typing import Any, Final, Self, TypeVar

from craftsim.errors import CraftsimError
from craftsim.interrupts import finishing_first
from craftsim.processes import spawn_context
from craftsim.rendering.frames import Frames, Look
from craftsim.rendering.trajectory import Trajectory
from craftsim.rendering.video import Frame

Job = TypeVar("Job")

_BATCH: Final = 8
"""Frames that a process makes at once."""
_AHEAD: Final = 2
"""Batches that each process may be ahead: frames wait in memory until the film has come to them."""

_frames: Frames | None = None
"""Of a worker process."""
_wrong: CraftsimError | None = None
"""Of a worker process: why it has no frames. Raised while a process begins, it would be lost."""
_over: Event | None = None
"""Of a worker process: set when nobody waits for its frames any more."""


def render_frames(trajectory: Trajectory, look: Look, workers: int = 1) -> Iterator[Frame]:
    """Yield the frames of a film, the same for any number of workers."""
    if workers == 1:
        with closing(Frames(trajectory, look)) as frames:
            yield from map(frames.__getitem__, range(len(frames)))
        return
    with FrameProcesses(trajectory, look, workers) as processes:
        yield from processes.frames(range(Frames.count(trajectory, look)))


def spread(function: Callable[[Job], None], jobs: Sequence[Job], workers: int = 1) -> Iterator[None]:
    """Call a function, one that other processes can import, for each job; yield as each is done, in no order."""
    if workers == 1 or len(jobs) < 2:
        yield from map(function, jobs)
        return
    pool = Shielded(min(workers, len(jobs)), spawn_context(), _share, (_threads(workers),))
    try:
        for done in as_completed([pool.submit(function, job) for job in jobs]):
            yield done.result()
    finally:
        pool.shutdown(cancel_futures=True)


class FrameProcesses:
    """Context manager of processes that make the frames of one film."""

    def __init__(self, trajectory: Trajectory, look: Look, workers: int, threads: int | None = None) -> None:
        """Start the processes; each rasterizes in so many threads, its share of the processors unless given."""
        self._workers = workers
        # A copy has no compiled model, which would be sent along.
        copy, context = replace(trajectory), spawn_context()
        self._over = context.Event()
        self._pool = Shielded(
            workers, context, _begin, (threads or _threads(workers), copy, look, self._over)
        )

    def wait(self) -> None:
        """Wait until all have begun."""
        for future in [self._pool.submit(_render, [0]) for _ in range(4 * self._workers)]:
            future.result()

    def frames(self, numbers: Sequence[int]) -> Iterator[Frame]:
        """Yield the frames of these numbers, in their order."""
        batches = deque(numbers[i : i + _BATCH] for i in range(0, len(numbers), _BATCH))
        running: deque[Future[list[Frame]]] = deque()
        while batches or running:
            while batches and len(running) < _AHEAD * self._workers:
                running.append(self._pool.submit(_render, list(batches.popleft())))
            yield from running.popleft().result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._pool.shutdown(cancel_futures=True)


class Shielded(ProcessPoolExecutor):
    """Processes that start as jobs come in; a Ctrl-C is for the process that asked, which ends its workers."""

    def submit(self, *arguments: Any, **named: Any) -> Future[Any]:
        """Have a function called, as with any executor."""
        # In the midst of it, a Ctrl-C would leave a process behind of which nobody knows.
        with finishing_first():
            return super().submit(*arguments, **named)


def _threads(workers: int) -> int:
    """Return how many threads each process may rasterize in."""
    return max(1, (os.cpu_count() or 1) // workers)


def _share(threads: int) -> None:
    # Mesa's software renderer takes all processors otherwise, and the processes would be in each other's way.
    os.environ.setdefault("LP_NUM_THREADS", str(threads))


def _begin(threads: int, trajectory: Trajectory, look: Look, over: Event) -> None:
    global _frames, _wrong, _over
    _share(threads)
    _over = over
    if not over.is_set():
        try:
            _frames = Frames(trajectory, look)
        except CraftsimError as error:
            _wrong = error


def _render(numbers: list[int]) -> list[Frame]:
    assert _over is not None, "a worker begins first"
    if _wrong is not None:
        raise _wrong
    frames: list[Frame] = []
    for number in numbers:
        if _over.is_set():
            break
        assert _frames is not None, "a worker begins with its frames"
        frames.append(_frames[number])
    return frames
