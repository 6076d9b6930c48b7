"""Handing out items to the workers of a pool."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any

from craftsim.experiments.experiment import Answer, Failure, Item

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
    pool: Pool, work: Work, items: Iterable[tuple[int, Item]], timeout_s: float, batch: int
) -> Iterator[tuple[int, Answer]]:
    """Yield each item's number with its answer once, as soon as it is known.

    The arguments are those of :meth:`craftsim.workers.pool.Pool.map_unordered`; the items have numbers.
    """
    jobs = ((number, item.job) for number, item in items)
    for (number, _), answer in pool.map_unordered(partial(_answer, work), jobs, timeout_s, batch):
        yield number, Failure(answer.reason) if isinstance(answer, NoAnswer) else answer


def _answer(work: Work, numbered: tuple[int, Any]) -> Answer:
    return answer_of(work, numbered[1])
