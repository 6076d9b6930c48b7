"""What an experiment consists of: trials, the result of each and its record, and how all of them are run."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from craftsim.errors import DISK_ERRORS
from craftsim.experiments.schema import ANY, Form
from craftsim.experiments.schema import TrialRecord as TrialRecord
from craftsim.reports.json_file import plain
from craftsim.storage.limits import MAX_ERROR_CHARACTERS, TRIALS, size_text
from craftsim.workers.pool import Engine


@dataclass(frozen=True, slots=True)
class Trial:
    """One thing to try, independent of all others."""

    key: str
    """Stable name, unique in the run."""
    group: str
    """The row that the trial counts in."""
    seed: int
    job: Any
    """What the work function is given; goes to a worker, so it must be picklable."""
    context: str | None = None
    episode: int | None = None


@dataclass(frozen=True)
class Result:
    """The result of an item that was tried; made of what JSON knows, and equal whenever the item is."""

    agrees: bool
    """Whether everything went as the rules predicted."""
    attempts: Sequence[Any] = ()
    """Each action that was tried, a dataclass or a dictionary."""
    bundle: str | None = None
    """Folder of the first disagreement's replay bundle, relative to the run's."""
    extra: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Failure:
    """Why an item has no result."""

    text: str
    stops: bool = False
    """Whether the run cannot go on at all, such as on a full disk."""
    traceback: str = ""
    """Of what the work raised."""


Answer = Result | Failure
Work = Callable[[Any], Result]


Progress = Callable[[int], AbstractContextManager[Callable[[TrialRecord], None]]]
"""Given the number of trials, opens what is called with each one's record."""


@dataclass(frozen=True)
class Experiment:
    """Trials, and all that decides their results."""

    command: str
    seed: int
    config: Mapping[str, Any]
    """What else decides the results, for the report; a run is only resumed by an experiment of an equal one."""
    items: Sequence[Trial]
    work: Work
    """Gives a trial's job its result; a picklable function, called in the workers. What it raises becomes the record's
    error. A trial whose worker dies is tried once more."""
    form: Form = ANY
    """What the records must hold; those of an earlier run are checked before anything is tried."""
    timeout_s: float = 600.0
    """After which a trial's worker is killed and the trial recorded as an error."""
    batch: int = 1
    """Trials that a worker takes at once: more than one where they are short, or share what a worker keeps."""


@dataclass(frozen=True)
class RunOptions:
    """How an experiment is run; its results do not depend on it."""

    workers: int = 1
    """Processes to share the work."""
    engine: Engine = "local"
    """Processes of this machine, or actors of an existing Ray cluster."""
    resume: bool = False
    """Go on with the run in the folder, if there is one; what has an error there is tried again."""
    against: Path | None = None
    """Folder of an earlier run to compare with."""
    progress: Progress = lambda total: nullcontext(lambda record: None)
    """Shows what is done."""


def make_record(item: Trial, index: int, answer: Answer) -> TrialRecord:
    """Return the record of an item; a failure has no attempts and does not agree."""
    failure = answer if isinstance(answer, Failure) else None
    traced = {"traceback": failure.traceback} if failure is not None and failure.traceback else {}
    done = answer if isinstance(answer, Result) else Result(agrees=False, extra=traced)
    return {
        "key": plain(item.key),
        "index": index,
        "group": plain(item.group),
        "seed": item.seed,
        "context": plain(item.context),
        "episode": item.episode,
        "attempts": list(done.attempts),
        "agrees": done.agrees,
        "error": None if failure is None else failure.text,
        "bundle": done.bundle,
        "extra": done.extra,
    }


def text_of(item: Trial, index: int, answer: Answer) -> str:
    """Return the record of an item as JSON; one that is longer than a line may be gives way to one of a failure."""
    text = json.dumps(make_record(item, index, answer), sort_keys=True, allow_nan=False)
    if len(text) < TRIALS.line_bytes:
        return text
    found, allowed = size_text(len(text) + 1), size_text(TRIALS.line_bytes)
    return text_of(item, index, Failure(f"its record has {found}; allowed: at most {allowed}"))


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
