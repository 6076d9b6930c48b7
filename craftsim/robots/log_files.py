"""Logs in files: CSV tables, which docs/reference/reports.md describes, and ROS 2 bags."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from craftsim.errors import InputError, suggestion
from craftsim.robots.log import GROUPS, NEEDED, TIME, Log
from craftsim.robots.ranges import LOGGED_CARS
from craftsim.storage.extras import need
from craftsim.storage.limits import LOG
from craftsim.storage.paths import is_folder, unreadable
from craftsim.storage.reading import read_lines
from craftsim.storage.writing import write_whole

LOG_SUFFIX: Final = ".log.csv"
"""Suffix of the log that a run writes beside its trajectory."""
_SUFFIXES: Final = (".csv", ".mcap")
_CONVERTED: Final = {
    ".db3": "a ROS 2 bag in SQLite, which is not read; 'mcap convert {name} {stem}.mcap' converts it",
    ".zstd": "a compressed file, which is not read; 'zstd -d {name}' unpacks it",
    ".bag": "a bag of ROS 1, which is not read; record with ROS 2, 'ros2 bag record --storage mcap'",
}
"""Endings of recordings that are not read, with what helps."""
_CAR: Final = "car"
COLUMNS: Final = (TIME, _CAR, *(name for names in GROUPS.values() for name in names))
COMMAND_COLUMNS: Final = (TIME, _CAR, *GROUPS["commands"])


def read_logs(path: str | Path, topics: str | Path | None = None) -> dict[int, Log]:
    """Return the logs in a file by car: of a CSV table, or of a ROS 2 bag, whose car is 0.

    A bag is an .mcap file, or a folder with one, as 'ros2 bag record --storage mcap' makes it. ``topics`` is a YAML
    file that says which topics of a bag hold what.

    Raises InputError, naming the file and place, for one that is missing, damaged, too large or no log.
    """
    path = Path(path)
    if is_folder(path):
        path = _file_of_bag(path)
    ending = path.suffix.lower()
    match ending:
        case ".csv":
            if topics is not None:
                raise InputError(
                    f"{path}: a table has no topics; --topics goes with a ROS 2 bag (.mcap)"
                )
            return _read_table(path)
        case ".mcap":
            need("ros2", "reading ROS 2 bags needs", "mcap", "mcap_ros2")
            from craftsim.robots.bags import read_bag

            return {0: read_bag(path, None if topics is None else Path(topics))}
    if ending in _CONVERTED:
        raise InputError(f"{path}: {_CONVERTED[ending].format(name=path.name, stem=path.stem)}")
    raise InputError(
        f"{path}: no log by its ending; allowed: {', '.join(_SUFFIXES)}, or the folder of a ROS 2 bag"
    )


def _file_of_bag(folder: Path) -> Path:
    """Return the one recording in the folder of a bag. Raises InputError if there is none or there are several."""
    try:
        names = sorted(entry.name for entry in os.scandir(folder))
    except OSError as error:
        raise unreadable(folder, error) from error
    parts = [name for name in names if name.lower().endswith(".mcap")]
    if len(parts) > 1:
        raise InputError(
            f"{folder}: a bag of {len(parts)} files; 'mcap merge {parts[0]} {parts[1]} ... -o joined.mcap' joins "
            "them"
        )
    if not parts:
        parts = [name for name in names if Path(name).suffix.lower() in _CONVERTED]
    if not parts:
        raise InputError(f"{folder}: a folder without a recording; allowed: one with an .mcap file")
    return folder / parts[0]


def read_log(path: str | Path, car: int = 0, topics: str | Path | None = None) -> Log:
    """Return the log of one car in a file; raises as :func:`read_logs`, and for a missing car."""
    logs = read_logs(path, topics)
    if car not in logs:
        raise InputError(f"{path}: no car {car}; there are {', '.join(map(str, logs))}")
    return logs[car]


def _read_table(path: Path) -> dict[int, Log]:
    """Return the logs in a CSV file by car; without a column ``car`` it is one log, of car 0."""
    lines = _lines(path)
    line, names = next(lines, (1, []))
    names = [name.strip() for name in names]
    _check_names(f"{path}:{line}", names)
    rows: dict[int, list[list[float]]] = {}
    for line, cells in lines:
        if not cells:
            continue
        position = f"{path}:{line}"
        if len(cells) != len(names):
            raise InputError(
                f"{position}: {len(cells)} values; the header has {len(names)} columns"
            )
        values = [_number(position, name, cell) for name, cell in zip(names, cells, strict=True)]
        row = dict(zip(names, values, strict=True))
        car = row.get(_CAR, 0.0)
        time_s = row[TIME]
        if not (LOGGED_CARS.low <= car <= LOGGED_CARS.high and car.is_integer()):
            raise InputError(f"{position}: {_CAR} is {car:g}; allowed: an integer, {LOGGED_CARS}")
        car_rows = rows.setdefault(int(car), [])
        if car_rows:
            before = car_rows[-1][names.index(TIME)]
        else:
            before = -math.inf
        if not time_s > before:
            raise InputError(
                f"{position}: {TIME} is {time_s:g}; it must be a number above that of the car's row before, {before:g}"
            )
        car_rows.append(values)
    if not rows:
        raise InputError(f"{path}: no rows; a log has a header and two rows or more")
    logs = {}
    for car, car_rows in sorted(rows.items()):
        columns = dict(zip(names, np.array(car_rows).T.copy(), strict=True))
        columns.pop(_CAR, None)
        try:
            logs[car] = Log.of_columns(columns)
        except InputError as error:
            raise InputError(f"{path}: car {car}: {error}") from error
    return logs


def write_table(
    path: str | Path, logs: Mapping[int, Log], names: tuple[str, ...] = COLUMNS
) -> Path:
    """Write logs, or some columns, atomically into a CSV file; return its path. Raises InputError if the disk fails."""
    parts = [np.empty((0, len(names)))]
    for car, log in logs.items():
        columns = log.columns | {_CAR: np.full(len(log), car)}
        parts.append(np.column_stack([columns[name] for name in names]))
    table = np.vstack(parts)
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    form = ",".join(["%.9g"] * len(names)) + "\n"
    text = (
        ",".join(names)
        + "\n"
        + "".join(form % tuple(row) for row in table.tolist()).replace("nan", "")
    )
    return write_whole(path, text)


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    for number, line in read_lines(path, LOG):
        try:
            text = line.decode("utf-8-sig").strip("\r\n")
            yield number, next(csv.reader([text], strict=True), [])
        except UnicodeDecodeError:
            raise InputError(f"{path}:{number}: not UTF-8 text") from None
        except csv.Error as error:
            raise InputError(f"{path}:{number}: not a line of a CSV table: {error}") from None


def _check_names(position: str, names: list[str]) -> None:
    missing = [name for name in NEEDED if name not in names]
    if missing:
        stems = {name.rsplit("_", 1)[0]: name for name in names}
        hints = []
        for name in missing:
            stem = name.rsplit("_", 1)[0]
            if stem in stems:
                hints.append(stems[stem])
        if hints:
            hint = f"; '{hints[0]}' looks like it in another unit"
        else:
            hint = suggestion(missing[0], names)
        raise InputError(
            f"{position}: no column {', '.join(missing)}{hint}; a log needs {', '.join(NEEDED)}"
        )
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{position}: two columns '{twice[:40]}'")
    for name in names:
        if name not in COLUMNS:
            raise InputError(
                f"{position}: unknown column '{name[:40]}'{suggestion(name, COLUMNS)}; there are {', '.join(COLUMNS)}"
            )


def _number(position: str, name: str, cell: str) -> float:
    try:
        if cell.strip():
            value = float(cell)
        else:
            value = math.nan
    except ValueError:
        raise InputError(f"{position}: {name} is '{cell[:40]}', which is no number") from None
    if math.isinf(value):
        raise InputError(
            f"{position}: {name} is infinite; leave the cell empty where nothing was measured"
        )
    return value
