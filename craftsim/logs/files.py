"""Logs in files: CSV tables, which docs/reference/reports.md describes, and ROS 2 bags."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from craftsim.errors import InputError, suggestion
from craftsim.logs.log import GROUPS, NEEDED, TIME, Floats, Log
from craftsim.storage.limits import LOG, LOGGED_CARS
from craftsim.storage.reading import read_lines
from craftsim.storage.writing import write_whole

LOG_SUFFIX: Final = ".log.csv"
"""Suffix of the log that a run writes beside its trajectory."""
SUFFIXES: Final = (".csv", ".mcap")
CAR: Final = "car"
COLUMNS: Final = (TIME, CAR, *(name for names in GROUPS.values() for name in names))
COMMANDS: Final = (TIME, CAR, *GROUPS["commands"])


def read_logs(path: str | Path, topics: str | Path | None = None) -> dict[int, Log]:
    """Return the logs in a file by car: of a CSV table, or of a ROS 2 bag (.mcap), whose car is 0.

    ``topics`` is a YAML file that says which topics of a bag hold what.

    Raises InputError, naming the file and place, for one that is missing, damaged, too large or no log.
    """
    path = Path(path)
    match path.suffix:
        case ".csv":
            if topics is not None:
                raise InputError(f"{path}: a table has no topics; --topics goes with a ROS 2 bag (.mcap)")
            return _read_table(path)
        case ".mcap":
            from craftsim.logs.bags import read_bag

            return {0: read_bag(path, None if topics is None else Path(topics))}
    raise InputError(f"{path}: no log by its ending; allowed: {', '.join(SUFFIXES)}")


def read_log(path: str | Path, car: int = 0, topics: str | Path | None = None) -> Log:
    """Return the log of one car in a file; raises as :func:`read_logs`, and for a missing car."""
    logs = read_logs(path, topics)
    if car not in logs:
        raise InputError(f"{path}: no car {car}; there are {', '.join(map(str, logs))}")
    return logs[car]


def _read_table(path: Path) -> dict[int, Log]:
    """Return the logs in a CSV file by car; without a column ``car`` it is one log, of car 0.

    Raises InputError, naming file, line and column, for what is no log.
    """
    lines = _lines(path)
    line, names = next(lines, (1, []))
    names = [name.strip() for name in names]
    _check_names(f"{path}:{line}", names)
    rows: dict[int, list[list[float]]] = {}
    ends: dict[int, float] = {}
    time, car_column = names.index(TIME), names.index(CAR) if CAR in names else None
    for line, cells in lines:
        if not cells:
            continue
        where = f"{path}:{line}"
        if len(cells) != len(names):
            raise InputError(f"{where}: {len(cells)} values; the header has {len(names)} columns")
        values = [_number(where, name, cell) for name, cell in zip(names, cells, strict=True)]
        car = 0 if car_column is None else _car(where, values[car_column])
        now = values[time]
        if not now > ends.get(car, -math.inf):
            raise InputError(
                f"{where}: {TIME} is {now:g}; it must be a number above that of the car's row before, "
                f"{ends.get(car, -math.inf):g}"
            )
        ends[car] = now
        rows.setdefault(car, []).append(values)
    if not rows:
        raise InputError(f"{path}: no rows; a log has a header and two rows or more")
    return {car: _log(f"{path}: car {car}", names, np.array(rows[car])) for car in sorted(rows)}


def _log(where: str, names: list[str], table: Floats) -> Log:
    try:
        return Log.of_columns(
            {name: table[:, k].copy() for k, name in enumerate(names) if name in COLUMNS and name != CAR}
        )
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def write_table(path: str | Path, logs: Mapping[int, Log]) -> Path:
    """Write logs atomically into a CSV file and return its path. Raises InputError if the disk fails."""
    return write_whole(path, _text(COLUMNS, logs))


def write_commands(path: str | Path, logs: Mapping[int, Log]) -> Path:
    """Write only the commands of logs, to be replayed, as :func:`write_table` does."""
    return write_whole(path, _text(COMMANDS, logs))


def _text(names: tuple[str, ...], logs: Mapping[int, Log]) -> str:
    """Return a table with nine significant digits."""
    parts = [np.empty((0, len(names)))]
    for car, log in logs.items():
        columns = log.columns | {CAR: np.full(len(log), car)}
        parts.append(np.column_stack([columns[name] for name in names]))
    table = np.vstack(parts)
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    form = ",".join(["%.9g"] * len(names)) + "\n"
    return ",".join(names) + "\n" + "".join(form % tuple(row) for row in table.tolist()).replace("nan", "")


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the number and the cells of each line of a CSV file."""
    for number, line in read_lines(path, LOG):
        try:
            text = line.decode("utf-8-sig").strip("\r\n")
            yield number, next(csv.reader([text], strict=True), [])
        except UnicodeDecodeError:
            raise InputError(f"{path}:{number}: not UTF-8 text") from None
        except csv.Error as error:
            raise InputError(f"{path}:{number}: not a line of a CSV table: {error}") from None


def _check_names(where: str, names: list[str]) -> None:
    """Raise InputError for a header that is none; columns of other names than ours may only be what is no unit slip."""
    if missing := [name for name in NEEDED if name not in names]:
        stems = {name.rsplit("_", 1)[0]: name for name in names}
        hints = [stems[stem] for name in missing if (stem := name.rsplit("_", 1)[0]) in stems]
        hint = f"; '{hints[0]}' looks like it in another unit" if hints else suggestion(missing[0], names)
        raise InputError(f"{where}: no column {', '.join(missing)}{hint}; a log needs {', '.join(NEEDED)}")
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{where}: two columns '{twice[:40]}'")
    for name in names:
        if name not in COLUMNS:
            raise InputError(
                f"{where}: unknown column '{name[:40]}'{suggestion(name, COLUMNS)}; there are {', '.join(COLUMNS)}"
            )


def _number(where: str, name: str, cell: str) -> float:
    try:
        value = float(cell) if cell.strip() else math.nan
    except ValueError:
        raise InputError(f"{where}: {name} is '{cell[:40]}', which is no number") from None
    if math.isinf(value):
        raise InputError(f"{where}: {name} is infinite; leave the cell empty where nothing was measured")
    return value


def _car(where: str, value: float) -> int:
    if not (value == value and value == int(value) and LOGGED_CARS.low <= value <= LOGGED_CARS.high):
        raise InputError(f"{where}: {CAR} is {value:g}; allowed: an integer, {LOGGED_CARS}")
    return int(value)
