"""Handing out items to the workers of a pool."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any

from craftsim.validation.campaign.items import Answer, Failure, Item, Work, answer_of
from craftsim.workers.pool import NoAnswer, Pool


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
