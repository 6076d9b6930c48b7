"""Running a campaign from its first item, or from where it was cut off, to its last."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Literal

from craftsim.errors import InputError
from craftsim.validation.campaign.distribute import Worker, distribute
from craftsim.validation.campaign.items import (
    Answer,
    Failure,
    Item,
    TrialRecord,
    Work,
    answer_of,
    make_record,
)
from craftsim.validation.campaign.store import Header, Store

Engine = Literal["local", "ray"]


def run_campaign(
    items: Sequence[Item],
    work: Work,
    out: Path,
    header: Header,
    *,
    workers: int = 1,
    engine: Engine = "local",
    timeout_s: float = 600.0,
    batch: int = 1,
    resume: bool = False,
    on_record: Callable[[TrialRecord], None] = lambda record: None,
) -> list[TrialRecord]:
    """Try every item and return the records in the order of the items.

    Each record is in ``out/trials.jsonl`` as soon as it is known. The records depend on nothing but the items and
    the work: not on the number of workers, the engine, the batches, or whether the campaign was cut off and resumed.

    Args:
        items: what to try.
        work: gives an item's job its result; a picklable function, called in the workers. What it raises becomes the
            record's error. An item whose worker dies is tried once more.
        out: the campaign's folder.
        header: what the campaign is; a campaign is only resumed by one of an equal header and equal items.
        workers: processes to share the work.
        engine: processes of this machine, or actors of an existing Ray cluster.
        timeout_s: after which an item's worker is killed and the item recorded as an error.
        batch: items that a worker takes at once, one after the other: more than one where items are short, or where
            neighbours share what a worker keeps.
        resume: go on with the campaign in the folder, if there is one; what has an error there is tried again.
        on_record: called with each record, those of an earlier run first.

    Raises:
        InputError: the folder, the cluster, or what is to be resumed is not as it should be, or the disk is full.
        KeyboardInterrupt: interrupted or terminated; the message says how to go on.
    """
    store = Store(out, header, items, resume)
    try:
        index = {item.key: i for i, item in enumerate(items)}
        for record in store.records.values():
            on_record(record)
        rest = [item for item in items if item.key not in store.records]
        answers = _answers(rest, work, workers, engine, timeout_s, batch)
        with _interruptible(store, len(items)):
            for item, answer in answers:
                if isinstance(answer, Failure) and answer.stops:
                    raise InputError(
                        f"{answer.text}; what was finished is kept in {out}: make room, then --resume"
                    )
                store.append([make_record(item, index[item.key], answer)])
                on_record(store.records[item.key])
        return store.finish()
    finally:
        store.close()


def run_here(
    items: Sequence[Item], work: Work, on_record: Callable[[TrialRecord], None] = lambda record: None
) -> list[TrialRecord]:
    """Try every item in this process, one after the other, and return the records that :func:`run_campaign` would."""
    records = []
    for index, item in enumerate(items):
        answer = answer_of(work, item.job, interruptible=True)
        records.append(make_record(item, index, answer))
        on_record(records[-1])
    return records


def _answers(
    items: Sequence[Item], work: Work, workers: int, engine: Engine, timeout_s: float, batch: int
) -> Iterator[tuple[Item, Answer]]:
    if not items:
        return iter(())
    n = min(workers, -(-len(items) // batch))
    return distribute(_start(work, n, engine), items, timeout_s, batch)


def _start(work: Work, n: int, engine: Engine) -> list[Worker]:
    if engine == "ray":
        from craftsim.validation.campaign.ray_cluster import ray_workers

        return ray_workers(work, n)

    from craftsim.validation.campaign.local import LocalWorker

    return [LocalWorker(work) for _ in range(n)]


@contextmanager
def _interruptible(store: Store, n_items: int) -> Iterator[None]:
    """Let the signal to terminate stop a campaign as an interrupt does, and say how to go on with it."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    # Python lets only the main thread handle signals.
    main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, interrupt) if main else None
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted: {store.n_kept} of {n_items} trials are kept in {store.out}; "
            "the same command with --resume goes on"
        ) from None
    finally:
        if main:
            signal.signal(signal.SIGTERM, before)
