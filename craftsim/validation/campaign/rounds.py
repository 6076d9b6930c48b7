"""Campaigns in rounds: how many items there are is known, what each does follows from the results of earlier ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from craftsim.errors import InputError
from craftsim.validation.campaign.campaign import check_room, interruptible
from craftsim.validation.campaign.distribute import distribute
from craftsim.validation.campaign.header import Header
from craftsim.validation.campaign.items import Item, TrialRecord, Work, make_record
from craftsim.validation.campaign.records import Records
from craftsim.validation.campaign.schema import ANY, Form
from craftsim.validation.campaign.store import Store
from craftsim.workers.pool import Pool


class Rounds:
    """A campaign that is done round by round; made by :func:`open_rounds`."""

    def __init__(
        self,
        store: Store,
        items: Sequence[Item],
        work: Work,
        pool: Pool,
        timeout_s: float,
        on_record: Callable[[TrialRecord], None],
    ) -> None:
        """Go on with what a store has kept."""
        self._store, self._items, self._work = store, items, work
        self._pool, self._timeout_s, self._on_record = pool, timeout_s, on_record
        self._kept = {record["index"]: record for record in store.kept()}

    def do(self, jobs: Mapping[int, Any]) -> list[TrialRecord]:
        """Return the records of items, by their numbers, each with its job, in their order; what is kept is not done
        again.

        Raises InputError for an item without a result, and where the disk is full.
        """
        for number in jobs:
            if number in self._kept:
                self._on_record(self._kept[number])
        missing = [(n, replace(self._items[n], job=job)) for n, job in jobs.items() if n not in self._kept]
        for number, answer in distribute(self._pool, self._work, missing, self._timeout_s, batch=1):
            check_room(answer, self._store.out)
            record = self._store.append(make_record(self._items[number], number, answer))
            if record["error"] is not None:
                raise InputError(f"{record['key']}: {record['error']}; --resume tries it again")
            self._kept[number] = record
            self._on_record(record)
        return [self._kept[number] for number in jobs]

    def finish(self) -> Records:
        """Return all records in the order of the items, once all are done, and leave them on disk in that order."""
        return self._store.finish()


@contextmanager
def open_rounds(
    items: Sequence[Item],
    work: Work,
    out: Path,
    header: Header,
    *,
    workers: int = 1,
    timeout_s: float = 600.0,
    resume: bool = False,
    on_record: Callable[[TrialRecord], None] = lambda record: None,
    form: Form = ANY,
) -> Iterator[Rounds]:
    """Begin a campaign in rounds, or go on with it; the arguments are those of
    :func:`~craftsim.validation.campaign.campaign.run_campaign`, and jobs of items come later.

    The same workers do all rounds.
    """
    store = Store(out, header, items, resume, form)
    try:
        with (
            interruptible(lambda: f"{store.n_kept} of {len(items)} evaluations are kept in {out}"),
            Pool(workers) as pool,
        ):
            yield Rounds(store, items, work, pool, timeout_s, on_record)
    finally:
        store.close()
