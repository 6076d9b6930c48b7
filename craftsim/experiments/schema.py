"""The schemas of a run's manifest and records, checked on reading."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import PurePosixPath
from typing import Annotated, Any, Final

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

from craftsim.errors import InputError
from craftsim.storage.limits import RUNS
from craftsim.storage.reading import parse_json
from craftsim.storage.records import first_mistake

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
    """Index of the trial in the run."""
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
    """Digest of the trials' keys."""


_RECORD: Final = TypeAdapter(TrialRecord)
_MANIFEST: Final = TypeAdapter(Manifest)


@dataclass(frozen=True)
class Form:
    """Schema of what is specific to a command in its records."""

    attempt: Any = dict[str, Any]
    """Type of an attempt, checked by pydantic."""
    extra: Any = dict[str, Any]

    @cached_property
    def _outcome(self) -> TypeAdapter[Any]:
        """Adapter for the fields of a trial without error."""
        attempts, extra = list[self.attempt], self.extra  # type: ignore[name-defined]
        made = create_model("Outcome", __config__=STRICT, attempts=(attempts, ...), extra=(extra, ...))
        return TypeAdapter(made)

    def record(self, line: bytes, where: str) -> TrialRecord:
        """Return the record in a line. Raises InputError, beginning with ``where``, for an invalid one."""
        record: TrialRecord = _read(_RECORD, line, where)
        if record["error"] is None:
            _read(self._outcome, line, where)
        elif record["attempts"] or record["agrees"]:
            raise InputError(f"{where}: a trial with an error has no attempts and does not agree")
        return record


ANY: Final = Form()
"""Accepts any attempts and results."""


def manifest_of(data: bytes, where: str) -> Manifest:
    """Return a manifest. Raises InputError, beginning with ``where``, for an invalid one."""
    manifest: Manifest = _read(_MANIFEST, data, where)
    return manifest


def _read(wanted: TypeAdapter[Any], data: bytes, where: str) -> Any:
    parse_json(data, where)
    try:
        return wanted.validate_json(data)
    except ValidationError as error:
        # What is in a file may be long, and steer a terminal.
        raise InputError(f"{where}: {first_mistake(error)}") from None
