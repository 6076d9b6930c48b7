"""What the records of a search for margins hold: a margin along one axis, or a row of a map of two."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any

from pydantic import Field

from craftsim.experiments.experiment import TrialRecord
from craftsim.experiments.schema import STRICT

_Count = Annotated[int, Field(ge=0, lt=2**53)]


class End(StrEnum):
    """How a search ended."""

    EDGE = "edge"
    """A trial fails at the level next to the margin."""
    LARGEST = "largest"
    """All trials stand the largest level."""
    NO_EFFECT = "no effect"
    """At the largest level nothing differs from the base."""
    BASE = "base"
    """Not even the base is stood."""


@dataclass(frozen=True)
class Limit:
    """A margin with its interval; values in the figure's own unit."""

    __pydantic_config__ = STRICT
    end: End
    margin: float | None
    """The largest value that all trials stood; None where they did not even stand the base."""
    upper: float | None
    """The value from which on more than 5 % fail; None where too few trials failed to say so."""
    fails_at: float | None
    """The value next to the margin, at which a trial failed; None where none did."""
    trial: int | None
    """Number of that trial, or of the one that failed in the base."""
    reason: str
    """Why it failed."""
    tried: _Count
    """How many times a trial was run."""


@dataclass(frozen=True)
class RowFound:
    """What is found of one row of a map."""

    __pydantic_config__ = STRICT
    stood: tuple[_Count, ...]
    """How many trials stand, by the level to the right."""
    of: _Count
    """Trials of each."""


def limit_of(record: TrialRecord) -> Limit:
    """Return what the record of a search says."""
    extra: dict[str, Any] = record["extra"]
    return Limit(**{**extra, "end": End(extra["end"])})
