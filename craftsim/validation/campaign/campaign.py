"""Running a campaign from its first item, or from where it was cut off, to its last."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from types import FrameType

from craftsim.errors import InputError
from craftsim.validation.campaign.distribute import distribute
from craftsim.validation.campaign.header import Header
from craftsim.validation.campaign.items import (
    Answer,
    Failure,
    Item,
    TrialRecord,
    Work,
    answer_of,
    make_record,
)
from craftsim.validation.campaign.records import Records
from craftsim.validation.campaign.schema import ANY, Form
from craftsim.validation.campaign.store import Store
from craftsim.workers.pool import Engine, Pool


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
    form: Form = ANY,
) -> Records:
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
        form: what the records must hold; those of an earlier run are checked before anything is tried.

    Raises:
        InputError: the folder, the cluster, or what is to be resumed is not as it should be, or the disk is full.
        KeyboardInterrupt: interrupted or terminated; the message says how to go on.
    """
    store = Store(out, header, items, resume, form)
    try:
        for record in store.kept():
            on_record(record)
        with interruptible(lambda: f"{store.n_kept} of {len(items)} trials are kept in {out}"):
            for index, answer in _answers(store.missing(), work, workers, engine, timeout_s, batch):
                check_room(answer, out)
                on_record(store.append(make_record(items[index], index, answer)))
        return store.finish()
    finally:
        store.close()


def do_all(
    items: Sequence[Item],
    work: Work,
    out: Path,
    doing: str,
    *,
    workers: int = 1,
    engine: Engine = "local",
    timeout_s: float = 600.0,
    on_answer: Callable[[int, Answer], None] = lambda number, answer: None,
) -> list[Answer]:
    """Do what a finished campaign still needs, in the same kind of workers, and return the answers to the items.

    Args:
        items: what to do.
        work: does an item's job, as in :func:`run_campaign`.
        out: the campaign's folder.
        doing: what is done, for messages.
        workers: processes to share the work.
        engine: processes of this machine, or actors of an existing Ray cluster.
        timeout_s: after which an item's worker is killed; its answer is a failure.
        on_answer: called with each answer and its item's number, as they come.

    Raises:
        InputError: the disk is full, or the cluster is not as it should be.
        KeyboardInterrupt: interrupted or terminated; the message says how to go on.
    """
    answers: dict[int, Answer] = {}
    with interruptible(lambda: f"while {doing}; all trials are kept in {out}"):
        for number, answer in _answers(enumerate(items), work, workers, engine, timeout_s, 1):
            check_room(answer, out)
            answers[number] = answer
            on_answer(number, answer)
    return [answers[number] for number in range(len(items))]


def check_room(answer: Answer, out: Path) -> None:
    """Raise InputError where the disk was too full for an answer."""
    if isinstance(answer, Failure) and answer.stops:
        raise InputError(f"{answer.text}; what was finished is kept in {out}: make room, then --resume")


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
    items: Iterable[tuple[int, Item]], work: Work, workers: int, engine: Engine, timeout_s: float, batch: int
) -> Iterator[tuple[int, Answer]]:
    """Yield the answers to numbered items; nothing is started where there are none."""
    rest = iter(items)
    for first in rest:
        with Pool(workers, engine) as pool:
            yield from distribute(pool, work, chain([first], rest), timeout_s, batch)


@contextmanager
def interruptible(state: Callable[[], str]) -> Iterator[None]:
    """Let the signal to terminate stop a campaign as an interrupt does, and say how things are and how to go on."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    # Python lets only the main thread handle signals.
    main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, interrupt) if main else None
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted: {state()}; the same command with --resume goes on") from None
    finally:
        if main:
            signal.signal(signal.SIGTERM, before)
