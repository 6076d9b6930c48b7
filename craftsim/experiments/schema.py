"""What a run's folder may say: each value of its manifest and of its records is checked when it is read."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any, Final

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError, create_model

from craftsim.errors import InputError
from craftsim.storage.limits import RUNS
from craftsim.storage.reading import parse_json
from craftsim.storage.records import first_mistake

if TYPE_CHECKING:
    from craftsim.experiments.experiment import TrialRecord

STRICT: Final = ConfigDict(strict=True, allow_inf_nan=False)
"""A number is a number and no text, and finite."""


def _bundle(folder: str) -> str:
    parts = PurePosixPath(folder).parts
    if len(parts) != 2 or parts[0] != "bundles" or parts[1] == ".." or "\0" in folder:
        raise ValueError("must be a folder in bundles/")
    return folder


@dataclass(frozen=True)
class _Record:
    """A :class:`TrialRecord` with the conditions that hold for all commands."""

    __pydantic_config__ = STRICT
    key: str
    index: Annotated[int, Field(ge=0)]
    group: str
    seed: int
    context: str | None
    episode: int | None
    attempts: list[dict[str, Any]]
    agrees: bool
    error: str | None
    bundle: Annotated[str, AfterValidator(_bundle)] | None
    extra: dict[str, Any]


@dataclass(frozen=True)
class _Manifest:
    """What a run is."""

    __pydantic_config__ = STRICT
    schema_version: int
    command: str
    seed: int
    versions: dict[str, str]
    config: dict[str, Any]
    items: Annotated[int, Field(ge=0, le=int(RUNS.high))]
    keys: str


_RECORD: Final = TypeAdapter(_Record)
_MANIFEST: Final = TypeAdapter(_Manifest)


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
        record: TrialRecord = parse_json(line, where)
        _check(_RECORD, line, where)
        if record["error"] is None:
            _check(self._outcome, line, where)
        elif record["attempts"] or record["agrees"]:
            raise InputError(f"{where}: a trial with an error has no attempts and does not agree")
        return record


ANY: Final = Form()
"""Of trials of which nothing more is known."""


def manifest_of(data: bytes, where: str) -> dict[str, Any]:
    """Return what a run is; raise InputError, beginning with ``where``, for what is no manifest."""
    loaded: dict[str, Any] = parse_json(data, where)
    _check(_MANIFEST, data, where)
    return loaded


def _check(wanted: TypeAdapter[Any], data: bytes, where: str) -> None:
    try:
        wanted.validate_json(data)
    except ValidationError as error:
        # What is in a file may be long, and steer a terminal.
        raise InputError(f"{where}: {first_mistake(error)}") from None
