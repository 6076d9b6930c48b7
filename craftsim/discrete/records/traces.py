"""Recordings of CraftEnv: gzip-compressed JSON lines of ticks or of plans, read one by one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from craftsim.discrete.grid import Cell, Grid, Kind
from craftsim.discrete.grid_checks import check_size, check_values
from craftsim.discrete.records.schema import KIND_NAMES, Record, parse_record
from craftsim.errors import InputError
from craftsim.storage.limits import RECORDED_CELLS, RECORDING, RECORDS
from craftsim.storage.reading import read_lines


def read_records(path: Path) -> Iterator[tuple[int, Record]]:
    """Yield line number and content of each record; raise InputError with file and line if there is none."""
    number = cells = 0
    for number, line in read_lines(path, RECORDING, packed=True):
        try:
            record = parse_record(line)
            check_size(record["size"], len(record["before"]["cars"]))
        except InputError as error:
            raise InputError(f"{path}:{number}: {error}") from None
        length, width, height = record["size"]
        cells += length * width * height
        if number > RECORDS or cells > RECORDED_CELLS:
            raise InputError(
                f"{path}:{number}: more than the {RECORDS} records, with {RECORDED_CELLS} cells together, that are "
                "allowed in a recording; split it"
            )
        yield number, record
    if not number:
        raise InputError(f"{path}: holds no records")


def recorded_grid(size: Cell, state: Record) -> Grid:
    """Return the world of a recorded state, with its marks; raise InputError for one that cannot be."""
    length, width, height = size
    grid = Grid.empty((length, width, height), len(state["cars"]))
    kinds, yaws = grid.kind, grid.yaw
    for name, x, y, z, *yaw in state["objs"]:
        if not (0 <= x < length and 0 <= y < width and 1 <= z <= height):
            raise _outside("objs", (x, y, z), size)
        kinds[x, y, z] = KIND_NAMES[name]
        yaws[x, y, z] = yaw[0] if yaw else 0
    for row, car in zip(grid.cars, state["cars"], strict=True):
        load = KIND_NAMES[car["load"]] if car["load"] else Kind.AIR
        row[:] = (car["x"], car["y"], car["z"], car["yaw"], load, car["load_yaw"] or 0, car["slope"])
    check_values(grid)
    grid.derive_marks()
    for x, y, z, mark in state["dev"]["on"]:
        if not (0 <= x < length and 0 <= y < width and 0 <= z <= height and mark < grid.n_cars):
            raise _outside("dev.on", (x, y, z), size, f" or names a car that is not there: {mark}")
        grid.occupant[x, y, z] = mark
    for x, y, z, flag in state["dev"]["back"]:
        if not (0 <= x < length and 0 <= y < width and 0 <= z <= height) or kinds[x, y, z] != Kind.BLOCK:
            raise _outside("dev.back", (x, y, z), size, " or holds no block")
        grid.landing[x, y, z] = bool(flag)
    return grid


def _outside(key: str, cell: Cell, size: Cell, otherwise: str = "") -> InputError:
    return InputError(f"key '{key}': the cell {cell} is outside the map of size {tuple(size)}{otherwise}")
