"""What a campaign consists of: items to try, the result of each, and its record, one line of JSON."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypedDict

from craftsim.errors import DISK_ERRORS
from craftsim.report import plain
from craftsim.storage.limits import MAX_ERROR_CHARACTERS


@dataclass(frozen=True, slots=True)
class Item:
    """One thing to try, independent of all others."""

    key: str
    """Stable name, unique in the campaign."""
    group: str
    """The row that the trial counts in."""
    seed: int
    job: Any
    """What the work function is given; goes to a worker, so it must be picklable."""
    context: str | None = None
    episode: int | None = None


@dataclass(frozen=True)
class Done:
    """The result of an item that was tried; made of what JSON knows, and equal whenever the item is."""

    agrees: bool
    """Whether everything went as the rules predicted."""
    attempts: Sequence[Any] = ()
    """Each action that was tried, a dataclass or a dictionary."""
    bundle: str | None = None
    """Folder of the first disagreement's replay bundle, relative to the campaign's."""
    extra: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Failure:
    """Why an item has no result."""

    text: str
    stops: bool = False
    """Whether the campaign cannot go on at all, such as on a full disk."""
    traceback: str = ""
    """Of what the work raised."""


Answer = Done | Failure
Work = Callable[[Any], Done]


class Identity(TypedDict):
    """What a record says of its item."""

    key: str
    index: int
    """Place of the item in the campaign."""
    group: str
    seed: int
    context: str | None
    episode: int | None


class TrialRecord(Identity):
    """A line of ``trials.jsonl``."""

    attempts: list[dict[str, Any]]
    agrees: bool
    error: str | None
    """Why there is no result: what the work raised, that it took too long, or that its worker died twice."""
    bundle: str | None
    extra: dict[str, Any]
    """What the work has to tell besides; ``traceback`` where it raised something."""


def make_record(item: Item, index: int, answer: Answer) -> TrialRecord:
    """Return the record of an item; a failure has no attempts and does not agree."""
    failure = answer if isinstance(answer, Failure) else None
    traced = {"traceback": failure.traceback} if failure is not None and failure.traceback else {}
    done = answer if isinstance(answer, Done) else Done(agrees=False, extra=traced)
    return {
        **identity(item, index),
        "attempts": list(done.attempts),
        "agrees": done.agrees,
        "error": None if failure is None else failure.text,
        "bundle": done.bundle,
        "extra": done.extra,
    }


def identity(item: Item, index: int) -> Identity:
    """Return what the record of an item says of the item itself."""
    return {
        "key": plain(item.key),
        "index": index,
        "group": plain(item.group),
        "seed": item.seed,
        "context": plain(item.context),
        "episode": item.episode,
    }


def line_of(record: TrialRecord) -> bytes:
    """Return a record as its line of ``trials.jsonl``."""
    return (json.dumps(record, sort_keys=True, allow_nan=False) + "\n").encode()


def shortened(text: str) -> str:
    """Return an error's message as a record may hold it: of a long one the beginning and the end, all in UTF-8."""
    half = MAX_ERROR_CHARACTERS // 2
    whole = text if len(text) <= MAX_ERROR_CHARACTERS else f"{text[:half]} [...] {text[-half:]}"
    return str(plain(whole))


def answer_of(work: Work, job: Any, interruptible: bool = False) -> Answer:
    """Do the work of one item; what it raises is its answer, but an interrupt where that is meant for the caller."""
    try:
        done = work(job)
        return replace(done, attempts=plain(done.attempts), extra=plain(done.extra))
    except BaseException as error:  # a policy may as well leave by sys.exit
        if interruptible and isinstance(error, KeyboardInterrupt):
            raise
        cause = error.__cause__ or error
        if isinstance(cause, OSError) and cause.errno in DISK_ERRORS:
            return Failure(f"{cause.filename or 'the results'}: {cause.strerror}", stops=True)
        last_line = traceback.format_exception_only(error)[-1].strip()
        return Failure(shortened(last_line), traceback=shortened("".join(traceback.format_exception(error))))
