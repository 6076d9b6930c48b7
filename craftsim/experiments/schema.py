"""What a run's folder may say: each value of its manifest and of its records is checked when it is read."""

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
"""A number is a number and no text, and finite."""


def _bundle(folder: str) -> str:
    parts = PurePosixPath(folder).parts
    if len(parts) != 2 or parts[0] != "bundles" or parts[1] == ".." or "\0" in folder:
        raise ValueError("must be a folder in bundles/")
    return folder


@with_config(STRICT)
class TrialRecord(TypedDict):
    """A line of ``trials.jsonl``, with the conditions that hold for all commands."""

    key: str
    index: Annotated[int, Field(ge=0)]
    """Place of the item in the run."""
    group: str
    seed: int
    context: str | None
    episode: int | None
    attempts: list[dict[str, Any]]
    agrees: bool
    error: str | None
    """Why there is no result: what the work raised, that it took too long, or that its worker died twice."""
    bundle: Annotated[str, AfterValidator(_bundle)] | None
    extra: dict[str, Any]
    """What the work has to tell besides; ``traceback`` where it raised something."""


@with_config(STRICT)
class Manifest(TypedDict):
    """What a run is."""

    schema_version: int
    command: str
    seed: int
    versions: dict[str, str]
    config: dict[str, Any]
    items: Annotated[int, Field(ge=0, le=int(RUNS.high))]
    keys: str
    """Digest of the items' keys."""


_RECORD: Final = TypeAdapter(TrialRecord)
_MANIFEST: Final = TypeAdapter(Manifest)


@dataclass(frozen=True)
class Form:
    """What the trials of a command leave in its records, besides what those of all have in common."""

    attempt: Any = dict[str, Any]
    """Type of an attempt, which pydantic knows how to check."""
    extra: Any = dict[str, Any]

    @cached_property
    def _outcome(self) -> TypeAdapter[Any]:
        """Return what only a trial without an error must hold."""
        attempts, extra = list[self.attempt], self.extra  # type: ignore[name-defined]
        made = create_model("Outcome", __config__=STRICT, attempts=(attempts, ...), extra=(extra, ...))
        return TypeAdapter(made)

    def record(self, line: bytes, where: str) -> TrialRecord:
        """Return the record that a line holds; raise InputError, beginning with ``where``, for one that is none."""
        record: TrialRecord = _read(_RECORD, line, where)
        if record["error"] is None:
            _read(self._outcome, line, where)
        elif record["attempts"] or record["agrees"]:
            raise InputError(f"{where}: a trial with an error has no attempts and does not agree")
        return record


ANY: Final = Form()
"""Of trials of which nothing more is known."""


def manifest_of(data: bytes, where: str) -> Manifest:
    """Return what a run is; raise InputError, beginning with ``where``, for what is no manifest."""
    manifest: Manifest = _read(_MANIFEST, data, where)
    return manifest


def _read(wanted: TypeAdapter[Any], data: bytes, where: str) -> Any:
    parse_json(data, where)
    try:
        return wanted.validate_json(data)
    except ValidationError as error:
        # What is in a file may be long, and steer a terminal.
        raise InputError(f"{where}: {first_mistake(error)}") from None
