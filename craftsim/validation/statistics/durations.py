"""How long actions take, by verb, load, level and slope, as a table that a grid planner can use."""

from __future__ import annotations

import csv
import io
import math
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from craftsim.errors import InputError
from craftsim.storage.folders import output_directory
from craftsim.storage.limits import TABLE
from craftsim.storage.reading import read_text
from craftsim.storage.writing import write_whole
from craftsim.validation.statistics.records import AttemptRecord, as_predicted

FILE_NAME: Final = "durations.csv"


class DurationKey(NamedTuple):
    """A kind of action that has a duration of its own."""

    verb: str
    """LIFT, DROP, FOLD, UNFOLD, ROTATE_LEFT, ROTATE_RIGHT, MOVE or STOP."""
    load: str
    """What the car carries before: none, block, flag or fslope."""
    level: int
    """The car's level before."""
    slope: bool
    """Whether the action starts or ends on a slope."""


@dataclass(frozen=True)
class Duration:
    """Durations of one kind of action in seconds, over the attempts that did as predicted."""

    verb: str
    load: str
    level: int
    slope: bool
    n: int
    mean_s: float
    p05_s: float
    median_s: float
    p95_s: float
    max_s: float

    @property
    def key(self) -> DurationKey:
        """The kind of action."""
        return DurationKey(self.verb, self.load, self.level, self.slope)


def _seconds(text: str) -> float:
    value = float(text)
    if not 0 <= value < math.inf:
        raise ValueError(f"{value} is no duration")
    return value


_COLUMNS: Final = tuple(field.name for field in fields(Duration))
_READ: Final[dict[str, Callable[[str], Any]]] = {
    "str": str,
    "int": int,
    "float": _seconds,
    "bool": {"True": True, "False": False}.__getitem__,
}
"""How the columns are read, by the type of their values."""


def duration_table(attempts: Iterable[AttemptRecord]) -> list[Duration]:
    """Return the durations of each kind of action that did as predicted, sorted by kind."""
    durations = Durations()
    for attempt in attempts:
        durations.add(attempt)
    return durations.table()


class Durations:
    """Durations of attempts that did as predicted, by their kind."""

    def __init__(self) -> None:
        """Begin with none."""
        self._kinds: dict[DurationKey, array[float]] = {}

    def add(self, attempt: AttemptRecord) -> None:
        """Take the duration of an attempt, if that did as predicted."""
        if as_predicted(attempt):
            key = DurationKey(attempt["verb"], attempt["load"], attempt["level"], attempt["slope"])
            self._kinds.setdefault(key, array("d")).append(attempt["duration_s"])

    def table(self) -> list[Duration]:
        """Return the durations of each kind, sorted by kind."""
        return [
            Duration(
                *key,
                len(values),
                float(np.mean(values)),
                *np.quantile(values, (0.05, 0.5, 0.95, 1.0)).tolist(),
            )
            for key, values in sorted(self._kinds.items())
        ]

    def deviations(self) -> Iterator[float]:
        """Yield how far each duration is from the median of its kind, in seconds."""
        for values in self._kinds.values():
            yield from np.abs(np.subtract(values, np.median(values)))


def write_durations(out: Path, table: Sequence[Duration]) -> Path:
    """Write a table as ``durations.csv`` into the directory ``out``, made when missing, and return its path."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    writer.writerows([round(v, 4) if isinstance(v, float) else v for v in astuple(row)] for row in table)
    return write_whole(output_directory(out) / FILE_NAME, text.getvalue())


def read_durations(path: Path) -> dict[DurationKey, Duration]:
    """Return the table in a file that :func:`write_durations` wrote, by kind of action.

    Raises:
        InputError: the file cannot be read, has other columns, or a value is not of its column's kind.
    """
    reader = csv.DictReader(io.StringIO(read_text(path, TABLE), newline=""), restval="")
    try:
        if tuple(reader.fieldnames or ()) != _COLUMNS:
            raise InputError(f"{path}: line 1: the columns must be {', '.join(_COLUMNS)}")
        rows = [_duration(path, reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: not a table: {error}") from error
    return {row.key: row for row in rows}


def _duration(path: Path, line: int, row: dict[Any, str]) -> Duration:
    try:
        if None in row:
            raise ValueError("more values than columns")
        return Duration(*(_READ[str(field.type)](row[field.name]) for field in fields(Duration)))
    except (KeyError, ValueError) as error:
        raise InputError(
            f"{path}: line {line}: not a row of durations ({str(error)[:80]}); level and n are whole numbers, "
            "slope is True or False, the others are seconds"
        ) from error
