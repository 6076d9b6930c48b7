"""Handing out items to workers, and doing again what a dead one left behind."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import islice
from typing import Final, Protocol

from craftsim.validation.campaign.items import Answer, Failure, Item

MAX_DEATHS: Final = 2
"""How many workers an item alone may kill before it counts as failed: one death may be somebody else's doing."""


class WorkerDiedError(Exception):
    """The process that did the work is gone."""


class Worker(Protocol):
    """A process somewhere, as it looks from the thread here that waits for it."""

    def run(self, items: Sequence[Item], timeout_s: float) -> list[Answer]:
        """Do several items and return their answers.

        Afterwards the worker can take more, even where this raises WorkerDiedError, or TimeoutError when it took
        longer than the time given.
        """

    def close(self) -> None:
        """End the process; a :meth:`run` under way raises."""


@dataclass(frozen=True)
class _Batch:
    items: tuple[tuple[int, Item], ...]
    """With their numbers."""
    deaths: int = 0
    """How many workers have died over it since it is a single item."""

    def split(self) -> list[_Batch]:
        return [_Batch((item,)) for item in self.items]


class _Queue:
    """What is to be done; a batch is made when it is asked for."""

    def __init__(self, items: Iterable[tuple[int, Item]], batch: int) -> None:
        rest = iter(items)
        self._again: deque[_Batch] = deque()
        self._batches = map(_Batch, iter(lambda: tuple(islice(rest, batch)), ()))

    def __bool__(self) -> bool:
        if not self._again and (one := next(self._batches, None)) is not None:
            self._again.append(one)
        return bool(self._again)

    def pop(self) -> _Batch:
        return self._again.popleft()

    def again(self, batches: Sequence[_Batch]) -> None:
        """Put batches before all others."""
        self._again.extendleft(reversed(batches))


def distribute(
    workers: Sequence[Worker], items: Iterable[tuple[int, Item]], timeout_s: float, batch: int
) -> Iterator[tuple[int, Answer]]:
    """Yield each item's number with its answer once, as soon as it is known; the workers are closed at the end.

    Args:
        workers: what to distribute the items over.
        items: what to do, numbered, in the order in which it is begun.
        timeout_s: for each item.
        batch: how many items a worker takes at once. When one of them is not answered, each is run again alone.
    """
    queue = _Queue(items, batch)
    idle = list(workers)
    running: dict[Future[list[Answer]], tuple[Worker, _Batch]] = {}
    with ThreadPoolExecutor(len(workers), thread_name_prefix="campaign") as threads:
        try:
            while queue or running:
                _begin(threads, idle, queue, running, timeout_s)
                ended, _ = wait(running, return_when=FIRST_COMPLETED)
                settled = []
                for future in ended:
                    worker, done = running.pop(future)
                    idle.append(worker)
                    answers, again = _settle(future, done, timeout_s)
                    settled += answers
                    queue.again(again)
                # The workers go on while their answers are written down.
                _begin(threads, idle, queue, running, timeout_s)
                yield from settled
        finally:
            for worker in workers:
                worker.close()


def _begin(
    threads: ThreadPoolExecutor,
    idle: list[Worker],
    queue: _Queue,
    running: dict[Future[list[Answer]], tuple[Worker, _Batch]],
    timeout_s: float,
) -> None:
    while queue and idle:
        worker, batch = idle.pop(), queue.pop()
        items = [item for _, item in batch.items]
        future = threads.submit(worker.run, items, timeout_s * len(items))
        running[future] = worker, batch


def _settle(
    future: Future[list[Answer]], batch: _Batch, timeout_s: float
) -> tuple[list[tuple[int, Answer]], list[_Batch]]:
    """Return what is known of a batch, and what must be run again."""
    first, _ = batch.items[0]
    try:
        return [
            (number, answer) for (number, _), answer in zip(batch.items, future.result(), strict=True)
        ], []
    except (TimeoutError, WorkerDiedError) as error:
        if len(batch.items) > 1:
            return [], batch.split()
        if isinstance(error, TimeoutError):
            return [(first, Failure(f"no answer within {timeout_s:g} s"))], []
    if batch.deaths + 1 < MAX_DEATHS:
        return [], [_Batch(batch.items, batch.deaths + 1)]
    return [(first, Failure(f"its worker process died, {MAX_DEATHS} times"))], []
