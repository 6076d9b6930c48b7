"""Experiments: trials, their results, the schemas of their records, and the options of a run."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Final, Protocol

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    create_model,
    with_config,
)
from typing_extensions import TypedDict

from craftsim.errors import DISK_ERRORS, InputError, shortage
from craftsim.experiments.ranges import RUNS
from craftsim.reports.json_file import json_value
from craftsim.storage.limits import MAX_ERROR_CHARACTERS, RECORD_BYTES, size_text
from craftsim.storage.reading import parse_json
from craftsim.storage.records import first_mistake
from craftsim.workers.pool import Engine
from craftsim.workers.pool import Failure as Failure

STRICT: Final = ConfigDict(strict=True, allow_inf_nan=False)
"""No conversion from text to numbers, and finite numbers only."""


def _bundle(folder: str) -> str:
    parts = PurePosixPath(folder).parts
    if len(parts) != 2 or parts[0] != "bundles" or parts[1] == ".." or "\0" in folder:
        raise ValueError("must be a folder in bundles/")
    return folder


@with_config(STRICT)
class TrialRecord(TypedDict):
    """A line of ``trials.jsonl``: the fields common to all commands."""

    key: str
    index: Annotated[int, Field(ge=0)]
    group: str
    seed: int
    context: str | None
    episode: int | None
    attempts: list[dict[str, Any]]
    agrees: bool
    error: str | None
    """The reason if there is no result: an exception, a timeout, or a worker that died twice."""
    bundle: Annotated[str, AfterValidator(_bundle)] | None
    extra: dict[str, Any]
    """Further results; ``traceback`` after an exception."""


@with_config(STRICT)
class Manifest(TypedDict):
    """Identity of a run."""

    schema_version: int
    command: str
    seed: int
    versions: dict[str, str]
    config: dict[str, Any]
    items: Annotated[int, Field(ge=0, le=int(RUNS.high))]
    keys: str


_RECORD: Final = TypeAdapter(TrialRecord)
MANIFEST: Final = TypeAdapter(Manifest)


@dataclass(frozen=True)
class Form:
    """Schema of what is specific to a command in its records."""

    attempt: Any = dict[str, Any]
    """Type of an attempt, checked by pydantic."""
    extra: Any = dict[str, Any]

    @cached_property
    def _outcome(self) -> TypeAdapter[Any]:
        """Adapter for the fields of a trial without error."""
        attempts = list[self.attempt]  # type: ignore[name-defined]
        extra = self.extra
        model = create_model(
            "Outcome", __config__=STRICT, attempts=(attempts, ...), extra=(extra, ...)
        )
        return TypeAdapter(model)

    def record(self, line: bytes, place: str, remedy: str) -> TrialRecord:
        """Return the record in a line. Raises InputError for an invalid one, with its place and a remedy."""
        record: TrialRecord = read_as(_RECORD, line, place, remedy)
        if record["error"] is None:
            read_as(self._outcome, line, place, remedy)
        elif record["attempts"] or record["agrees"]:
            raise InputError(
                f"{place}: a trial with an error has no attempts and does not agree; {remedy}"
            )
        return record


ANY: Final = Form()


def read_as(adapter: TypeAdapter[Any], data: bytes, place: str, remedy: str) -> Any:
    """Return what is in some JSON. Raises InputError where it is not what is wanted, with its place and a remedy."""
    try:
        parse_json(data, place)
        return adapter.validate_json(data)
    except InputError as error:
        raise InputError(f"{error}; {remedy}") from None
    except ValidationError as error:
        # What is in a file may be long, and steer a terminal.
        raise InputError(f"{place}: {first_mistake(error)}; {remedy}") from None


@dataclass(frozen=True, slots=True)
class Trial:
    """One independent trial."""

    key: str
    """Stable name, unique in the run."""
    group: str
    """Row of the statistics."""
    seed: int
    job: Any
    context: str | None = None
    episode: int | None = None


@dataclass(frozen=True)
class Result:
    """The result of a trial: JSON values, a deterministic function of the trial."""

    agrees: bool
    attempts: Sequence[Any] = ()
    bundle: str | None = None
    """Replay bundle of the first disagreement, relative to the run's folder."""
    extra: dict[str, Any] = field(default_factory=dict)


Answer = Result | Failure
TrialWork = Callable[[Any], Result]


Progress = Callable[[int | None], AbstractContextManager[Callable[[TrialRecord], None]]]
"""Given the number of trials, or None if it depends on results, returns a context whose value is called with each
record."""


class StoppingRule(Protocol):
    """Decides from the trials so far which need no more of their kind.

    The trials of a subject are run in rounds. A rule starts anew in every run, a resumed one too, and sees the same
    trials again.
    """

    def subject_of(self, trial: Trial) -> str:
        """Return what a trial is one of many for, such as its row of an audit."""

    def order_of(self, trial: Trial) -> Any:
        """Return what orders the trials of a subject, whose order must not depend on results."""

    def round_sizes(self) -> Iterator[int]:
        """Yield the number of trials of each subject in the first round, the second and so on."""

    def is_decided(self, subject: str, records: Sequence[TrialRecord]) -> bool:
        """Take the records of a subject's last round, and return whether it needs no further one."""


@dataclass(frozen=True)
class Experiment:
    """Trials with everything that determines their results."""

    command: str
    seed: int
    config: Mapping[str, Any]
    """Further configuration, for the report; a run is only resumed with an equal configuration."""
    items: Sequence[Trial]
    work: TrialWork
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
    engine: Engine = "local"
    resume: bool = False
    against: Path | None = None
    """Folder of the baseline run for a paired comparison."""
    progress: Progress = lambda total: nullcontext(lambda record: None)


def make_record(item: Trial, index: int, answer: Answer) -> TrialRecord:
    """Return the record of a trial; one with an error has no attempts and does not agree."""
    failure = None
    if isinstance(answer, Failure):
        failure = answer
    traced = {}
    if failure is not None and failure.traceback:
        traced = {"traceback": failure.traceback}
    if isinstance(answer, Result):
        done = answer
    else:
        done = Result(agrees=False, extra=traced)
    return {
        "key": json_value(item.key),
        "index": index,
        "group": json_value(item.group),
        "seed": item.seed,
        "context": json_value(item.context),
        "episode": item.episode,
        "attempts": list(done.attempts),
        "agrees": done.agrees,
        "error": None if failure is None else failure.text,
        "bundle": done.bundle,
        "extra": done.extra,
    }


def record_text(item: Trial, index: int, answer: Answer) -> str:
    """Return the record of a trial as JSON; a record above the limit is replaced by an error."""
    text = json.dumps(make_record(item, index, answer), sort_keys=True, allow_nan=False)
    if len(text) < RECORD_BYTES:
        return text
    length = size_text(len(text) + 1)
    allowed = size_text(RECORD_BYTES)
    return record_text(item, index, Failure(f"its record has {length}; allowed: at most {allowed}"))


def shortened(text: str) -> str:
    """Return an error message for a record: valid UTF-8, a long one without its middle."""
    half = MAX_ERROR_CHARACTERS // 2
    if len(text) <= MAX_ERROR_CHARACTERS:
        whole_or_part = text
    else:
        whole_or_part = f"{text[:half]} [...] {text[-half:]}"
    return str(json_value(whole_or_part))


def answer_of(work: TrialWork, job: Any, interruptible: bool = False) -> Answer:
    """Run one trial and return its result, or a Failure for an exception; KeyboardInterrupt passes if
    ``interruptible``."""
    try:
        done = work(job)
        return replace(done, attempts=json_value(done.attempts), extra=json_value(done.extra))
    except BaseException as error:  # a policy may as well leave by sys.exit
        if interruptible and isinstance(error, KeyboardInterrupt):
            raise
        cause = error.__cause__ or error
        if isinstance(cause, OSError) and cause.errno in DISK_ERRORS:
            return Failure(
                f"{cause.filename or 'the results'}: {cause.strerror}; make room", stops=True
            )
        lacking = shortage(error)
        if lacking:
            # The others would fail, too, and say less of why.
            return Failure(lacking, stops=True)
        last_line = traceback.format_exception_only(error)[-1].strip()
        return Failure(
            shortened(last_line), traceback=shortened("".join(traceback.format_exception(error)))
        )
