"""Mutated logs, as tables and as ROS 2 bags, read as ``identify`` reads them."""

from functools import cache
from pathlib import Path

import numpy as np
from bags import loose_bag, write_bag

from craftsim.logs.files import read_log, write_table
from craftsim.logs.log import GROUPS, Log
from fuzzing.mutations import mutated_bytes

ROWS = 12


@cache
def _whole(ending: str) -> bytes:
    from tempfile import TemporaryDirectory

    rng = np.random.default_rng(0)
    groups = {name: 0.01 * rng.normal(size=(ROWS, len(columns))) for name, columns in GROUPS.items()}
    log = Log(0.02 * np.arange(ROWS), **groups)
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"log{ending}"
        if ending == ".csv":
            write_table(path, {0: log})
        else:
            write_bag(path, log)
        return path.read_bytes()


def table(rng: np.random.Generator, folder: Path) -> None:
    """Attack a table: its bytes."""
    _read(folder / "log.csv", mutated_bytes(_whole(".csv"), rng))


def bag(rng: np.random.Generator, folder: Path) -> None:
    """Attack a bag: its bytes, within its packed chunks or around them, or those of its messages without either."""
    whole = _whole(".mcap")
    _read(folder / "log.mcap", mutated_bytes(whole if rng.random() < 0.3 else loose_bag(whole), rng))


def _read(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    read_log(path)


TARGETS = {"log": table, "bag": bag}
