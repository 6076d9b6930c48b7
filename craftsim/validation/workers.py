"""Spreading independent pieces of work over processes, with results in order and equal at any number of workers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_order(
    work: Callable[[Item], Result], items: Sequence[Item], workers: int, batch: int = 1
) -> Iterator[Result]:
    """Yield the results of a picklable function of each item, in the order of the items, as soon as each is known.

    One worker is this process; more are spawned, so that nothing of this process leaks into their results.
    ``batch`` items go to a worker at once.
    """
    if workers <= 1:
        yield from map(work, items)
        return
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        yield from pool.map(work, items, chunksize=batch)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
