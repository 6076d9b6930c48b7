"""Experiments: trials, their results and records, and the options of a run."""

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
    """One independent trial."""

    key: str
    """Stable name, unique in the run."""
    group: str
    """Row of the statistics."""
    seed: int
    job: Any
    """Picklable argument of the work function."""
    context: str | None = None
    episode: int | None = None


@dataclass(frozen=True)
class Result:
    """The result of a trial: JSON values, a deterministic function of the trial."""

    agrees: bool
    """Whether everything was as predicted by the rules."""
    attempts: Sequence[Any] = ()
    """The attempts: dataclasses or dictionaries."""
    bundle: str | None = None
    """Replay bundle of the first disagreement, relative to the run's folder."""
    extra: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Failure:
    """The reason why a trial has no result."""

    text: str
    stops: bool = False
    """Whether the run must stop, for instance on a full disk."""
    traceback: str = ""
    """Traceback of the exception."""


Answer = Result | Failure
Work = Callable[[Any], Result]


Progress = Callable[[int], AbstractContextManager[Callable[[TrialRecord], None]]]
"""Given the number of trials, returns a context whose value is called with each record."""


@dataclass(frozen=True)
class Experiment:
    """Trials with everything that determines their results."""

    command: str
    seed: int
    config: Mapping[str, Any]
    """Further configuration, for the report; a run is only resumed with an equal configuration."""
    items: Sequence[Trial]
    work: Work
    """Picklable function from a trial's job to its result, called in the workers. An exception becomes the record's
    error. A trial whose worker dies is repeated once."""
    form: Form = ANY
    """Schema of the records; those of an earlier run are checked before any trial."""
    timeout_s: float = 600.0
    """Time limit after which the worker is killed and the trial recorded as an error."""
    batch: int = 1
    """Trials sent to a worker together, more than one if they are short or share cached data."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a run on which its results do not depend."""

    workers: int = 1
    """Number of processes."""
    engine: Engine = "local"
    """Local processes, or actors of an existing Ray cluster."""
    resume: bool = False
    """Continue the run in the folder; trials with an error are repeated."""
    against: Path | None = None
    """Folder of the baseline run for a paired comparison."""
    progress: Progress = lambda total: nullcontext(lambda record: None)
    """Progress display."""


def make_record(item: Trial, index: int, answer: Answer) -> TrialRecord:
    """Return the record of a trial; one with an error has no attempts and does not agree."""
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
    """Return the record of a trial as JSON; a record above the limit is replaced by an error."""
    text = json.dumps(make_record(item, index, answer), sort_keys=True, allow_nan=False)
    if len(text) < TRIALS.line_bytes:
        return text
    found, allowed = size_text(len(text) + 1), size_text(TRIALS.line_bytes)
    return text_of(item, index, Failure(f"its record has {found}; allowed: at most {allowed}"))


def shortened(text: str) -> str:
    """Return an error message for a record: valid UTF-8, a long one without its middle."""
    half = MAX_ERROR_CHARACTERS // 2
    whole = text if len(text) <= MAX_ERROR_CHARACTERS else f"{text[:half]} [...] {text[-half:]}"
    return str(plain(whole))


def answer_of(work: Work, job: Any, interruptible: bool = False) -> Answer:
    """Run one trial and return its result, or a Failure for an exception; KeyboardInterrupt passes if
    ``interruptible``."""
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
