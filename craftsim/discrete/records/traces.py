"""Recordings of CraftEnv: gzip-compressed JSON lines of ticks or of plans, read one by one."""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from craftsim.discrete.grid import Grid, Kind
from craftsim.errors import InputError

KIND_NAMES: Final = {
    "wall": Kind.WALL,
    "block": Kind.BLOCK,
    "flag": Kind.FLAG,
    "fslope": Kind.FSLOPE,
    "gear": Kind.GEAR,
    "body": Kind.BODY,
    "foot": Kind.FOOT,
}

Record = dict[str, Any]


def read_records(path: Path) -> Iterator[tuple[int, Record]]:
    """Yield line number and content of each record; raise InputError with file and line if there is none."""
    number = 0
    try:
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        with gzip.open(path, "rt", encoding="utf-8") as lines:
            for number, line in enumerate(lines, start=1):
                record = json.loads(line)
                if not isinstance(record, dict) or not {"before", "size"} <= record.keys():
                    raise InputError(f"{path}:{number}: not a record; it needs at least 'size' and 'before'")
                yield number, record
        if not number:
            raise InputError(f"{path}: holds no records")
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a gzip file of text: {error}") from error
    except json.JSONDecodeError as error:
        raise InputError(f"{path}:{number}: not JSON: {error.msg}") from error


def recorded_grid(size: list[int], state: Record) -> Grid:
    """Return the world of a recorded state, with its marks."""
    length, width, height = size
    grid = Grid.empty((length, width, height), len(state["cars"]))
    for name, x, y, z, *yaw in state["objs"]:
        grid.kind[x, y, z] = KIND_NAMES[name]
        grid.yaw[x, y, z] = yaw[0] if yaw else 0
    for row, car in zip(grid.cars, state["cars"], strict=True):
        load = KIND_NAMES[car["load"]] if car["load"] else Kind.AIR
        row[:] = (car["x"], car["y"], car["z"], car["yaw"], load, car["load_yaw"] or 0, car["slope"])
    grid.derive_marks()
    for x, y, z, mark in state["dev"]["on"]:
        grid.top[x, y, z] = mark
    for x, y, z, flag in state["dev"]["back"]:
        grid.back[x, y, z] = bool(flag)
    return grid
