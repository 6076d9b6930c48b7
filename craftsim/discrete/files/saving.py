"""Writing worlds as blueprints, such that reading one back gives the same world, and buildings as goal files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from craftsim.discrete.files.blueprint import LOADS, NO_CELL, OBJECT_KEYS, parse_blueprint
from craftsim.discrete.files.blueprint_checks import check_blueprint
from craftsim.discrete.files.design import TARGET_KEYS, Design
from craftsim.discrete.grid import KINDS_WITH_YAW, SECOND_PART, CarField, Cell, Grid, Kind, beside
from craftsim.errors import BlueprintError
from craftsim.storage.writing import write_whole

_LOAD_NAMES: Final = {kind: name for name, kind in LOADS.items()}
_UNNAMED: Final = Path("saved world")


def _entry(**values: int | str) -> str:
    return "{" + ", ".join(f"{key}: {value}" for key, value in values.items()) + "}"


def _list(key: str, entries: list[str], indent: str = "") -> list[str]:
    return [f"{indent}{key}:", *(f"{indent}  - {entry}" for entry in entries)] if entries else []


def _objects(grid: Grid, kind: Kind) -> list[str]:
    """Return the entries of all complete objects of a kind; a slope without its second part is none."""
    entries: list[str] = []
    for x, y, z in np.argwhere(grid.kind == kind):
        cell, yaw = (int(x), int(y), int(z)), int(grid.yaw[x, y, z])
        place = {"id": len(entries), "x": cell[0], "y": cell[1], "z": cell[2]}
        if kind in KINDS_WITH_YAW:
            second = beside(cell, yaw)
            inside = all(0 <= c < n for c, n in zip(second, grid.kind.shape, strict=True))
            if not inside or grid.kind[second] != SECOND_PART[kind]:
                continue
            place["yaw"] = yaw
        entries.append(_entry(**place))
    return entries


def _car(car: int, row: list[int]) -> str:
    place = dict(zip(("x", "y", "z", "yaw"), row, strict=False))
    extra: dict[str, int | str] = {}
    if row[CarField.LOAD] != Kind.AIR:
        extra["load"] = _LOAD_NAMES[Kind(row[CarField.LOAD])]
    if row[CarField.LOAD] == Kind.FSLOPE:
        extra["load_yaw"] = row[CarField.LOAD_YAW]
    if row[CarField.SLOPE]:
        extra["slope"] = row[CarField.SLOPE]
    return _entry(id=car, **place, **extra)


def _snapshot(grid: Grid, listed: Grid) -> list[str]:
    """Return the section for what the listed things do not account for, empty if they do for all."""

    def odd(differs: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> list[Cell]:
        return [(int(x), int(y), int(z)) for x, y, z in np.argwhere(differs)]

    def at(cell: Cell, **values: int | str) -> str:
        return _entry(x=cell[0], y=cell[1], z=cell[2], **values)

    cells = odd((grid.kind != listed.kind) | (grid.yaw != listed.yaw))
    entries = [at(cell, kind=Kind(grid.kind[cell]).name.lower(), yaw=int(grid.yaw[cell])) for cell in cells]
    # An odd cell is put in place with blank marks.
    for cell in cells:
        listed.occupant[cell], listed.landing[cell] = -1, False
    top = [at(cell, mark=int(grid.occupant[cell])) for cell in odd(grid.occupant != listed.occupant)]
    back = [at(cell, mark=int(grid.landing[cell])) for cell in odd(grid.landing != listed.landing)]
    lines = [*_list("cells", entries, "  "), *_list("top", top, "  "), *_list("back", back, "  ")]
    return ["snapshot:", *lines] if lines else []


def _text(grid: Grid, goal: Cell | None, n_blocks: int, n_slopes: int, snapshot: list[str]) -> str:
    length, width, height = grid.size
    x, y, z = goal or NO_CELL
    lines = [
        f"area_length: {length}",
        f"area_width: {width}",
        f"area_height: {height}",
        f"block_num: {n_blocks}",
        f"slope_num: {n_slopes}",
        f"smartcar_num: {grid.n_cars}",
        *(line for key, kind in OBJECT_KEYS.items() for line in _list(key, _objects(grid, kind))),
        *_list("smartcar", [_car(car, row) for car, row in enumerate(grid.cars.tolist())]),
        *_list("goal", [_entry(id=0, x=x, y=y, z=z)]),
        *snapshot,
    ]
    return "\n".join(lines) + "\n"


def blueprint_text(grid: Grid, goal: Cell | None = None) -> str:
    """Return a world as the text of a blueprint.

    A world that play has led to may hold what no drawing lists: half slopes, marks of past events. Such
    things go into a ``snapshot`` section, which is written only where it is needed.
    """
    loads = grid.cars[:, CarField.LOAD]
    carried = int((loads == Kind.BLOCK).sum()), int((loads == Kind.FSLOPE).sum())
    listed_blocks = len(_objects(grid, Kind.BLOCK)) + carried[0]
    listed_slopes = sum(len(_objects(grid, kind)) for kind in (Kind.FSLOPE, Kind.BODY)) + carried[1]
    bare_text = _text(grid, goal, listed_blocks, listed_slopes, ["snapshot: {}"])
    blueprint = parse_blueprint(bare_text, _UNNAMED)
    bare = blueprint.grid(np.random.default_rng(0))
    odd = grid.kind[(grid.kind != bare.kind) | (grid.yaw != bare.yaw)]
    snapshot = _snapshot(grid, bare)
    if not snapshot:
        try:
            check_blueprint(replace(blueprint, snapshot=None))
        except BlueprintError:
            return bare_text
        return _text(grid, goal, listed_blocks, listed_slopes, [])
    # Counts cover all that is given, also what is both listed and odd, such as a block with a yaw.
    n_blocks = listed_blocks + int((odd == Kind.BLOCK).sum())
    n_slopes = listed_slopes + int(np.isin(odd, (Kind.FSLOPE, Kind.BODY)).sum())
    return _text(grid, goal, n_blocks, n_slopes, snapshot)


def write_blueprint(grid: Grid, path: str | Path, goal: Cell | None = None) -> None:
    """Write a world into a blueprint file that reads back as the same world; it is whole or not there.

    Raises InputError if it cannot be written.

    Example:
        >>> import craftsim
        >>> craftsim.write_blueprint(craftsim.Grid.empty((3, 3, 1), n_cars=1), folder / "mine.yaml")
        >>> craftsim.read_blueprint(folder / "mine.yaml").size
        (3, 3, 1)
    """
    write_whole(path, blueprint_text(grid, goal))


def design_text(design: Design) -> str:
    """Return the text of a design's goal file."""
    return "".join(
        f"{line}\n"
        for key, kind in TARGET_KEYS.items()
        for line in _list(
            key, [_entry(id=i, x=x, y=y, z=z) for i, (x, y, z) in enumerate(design.of_kind(kind))]
        )
    )


def write_design(design: Design, path: str | Path) -> None:
    """Write a design into a goal file that reads back as the same cells; it is whole or not there.

    Raises InputError if it cannot be written.
    """
    write_whole(path, design_text(design))
