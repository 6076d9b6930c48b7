"""Reading logs from files of any kind that is known."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from craftsim.errors import InputError
from craftsim.logs.log import Log
from craftsim.logs.tables import read_table

SUFFIXES: Final = (".csv", ".mcap")


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
            return read_table(path)
        case ".mcap":
            from craftsim.logs.bags import read_bag

            return {0: read_bag(path, None if topics is None else Path(topics))}
    raise InputError(f"{path}: no log by its ending; allowed: {', '.join(SUFFIXES)}")


def read_log(path: str | Path, car: int = 0, topics: str | Path | None = None) -> Log:
    """Return the log of one car in a file; raises as :func:`read_logs`, and where there is no such car."""
    logs = read_logs(path, topics)
    if car not in logs:
        raise InputError(f"{path}: no car {car}; there are {', '.join(map(str, logs))}")
    return logs[car]
