"""How long actions take, by verb, load, level and slope, as a table that a grid planner can use."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from craftsim.errors import InputError
from craftsim.storage.folders import output_directory
from craftsim.storage.limits import TABLE
from craftsim.storage.reading import read_text
from craftsim.storage.writing import write_whole

if TYPE_CHECKING:
    from pandas import DataFrame

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


def kinds_of(attempts: DataFrame) -> Iterable[tuple[Any, DataFrame]]:
    """Return attempts by what has a duration of its own, see :class:`DurationKey`, sorted."""
    return attempts.groupby(list(DurationKey._fields), observed=True)


def duration_table(good: DataFrame) -> list[Duration]:
    """Return the durations of the attempts that did as predicted, by kind, sorted."""
    rows = []
    for (verb, load, level, slope), part in kinds_of(good):
        seconds = part.duration_s.to_numpy()
        quantiles = np.quantile(seconds, (0.05, 0.5, 0.95, 1.0)).tolist()
        mean_s = float(np.mean(seconds))
        rows.append(Duration(str(verb), str(load), int(level), bool(slope), len(part), mean_s, *quantiles))
    return rows


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
