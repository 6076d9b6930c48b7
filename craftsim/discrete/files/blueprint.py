"""Blueprints: the start of a world as drawn in a YAML file, in CraftEnv's format with a few additions.

docs/blueprints.md describes the keys.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from craftsim.discrete.files.blueprint_checks import check_blueprint, check_written
from craftsim.discrete.files.documents import Mapping, Scalar, Sequence, Source, parse_keys, read_text
from craftsim.discrete.files.listing import ListedCar, ListedObject, Listing, Override, Snapshot
from craftsim.discrete.files.placement import Placement, build_grid
from craftsim.discrete.files.shipped import find
from craftsim.discrete.grid import KINDS_WITH_YAW, Cell, Grid, Kind
from craftsim.errors import BlueprintError

NO_CELL: Final[Cell] = (-1, -2, 1)
"""The coordinates with which CraftEnv's files say that there is no flag or no goal."""

MAX_SIDE: Final = 128
MAX_CELLS: Final = 131_072
MAX_CARS: Final = 256

OBJECT_KEYS: Final = {
    "block": Kind.BLOCK,
    "fold_slope": Kind.FSLOPE,
    "unfold_slope": Kind.BODY,
    "flag": Kind.FLAG,
    "wall": Kind.WALL,
}
"""Lists of objects, in the order in which they are placed."""

LOADS: Final = {"block": Kind.BLOCK, "flag": Kind.FLAG, "fold_slope": Kind.FSLOPE}

REQUIRED_KEYS: Final = ["area_length", "area_width", "area_height", "block_num", "slope_num", "smartcar_num"]
KEYS: Final = [
    *REQUIRED_KEYS,
    *OBJECT_KEYS,
    *("smartcar", "goal", "legged_robot_num", "legged_robot", "wall_num", "yaml_generated_time", "snapshot"),
]


class Blueprint(Listing):
    """A checked start file.

    Example:
        >>> import craftsim
        >>> blueprint = craftsim.read_blueprint("strip")
        >>> blueprint.size, blueprint.n_cars, blueprint.n_blocks
        ((4, 4, 3), 2, 4)
    """

    def grid(self, rng: np.random.Generator, placement: Placement = "sane") -> Grid:
        """Return a new world; unlisted objects and cars are drawn from ``rng``.

        Marks start as events leave them (docs/rules.md#marks). Raises BlueprintError if there is no room.
        """
        return build_grid(self, rng, placement)

    def with_counts(self, n_cars: int | None = None, n_blocks: int | None = None) -> Blueprint:
        """Return the same start with other numbers of cars and blocks; those that are not listed are drawn at random.

        Raises BlueprintError for fewer than the file lists, and for more than there is room for.
        """
        asked = [
            ("cars", n_cars, len(self.cars), MAX_CARS),
            ("blocks", n_blocks, self.listed(Kind.BLOCK), self.size[0] * self.size[1] * self.size[2]),
        ]
        for what, number, listed, most in asked:
            if number is not None and not listed <= number <= most:
                raise BlueprintError(
                    f"{self.path}: {number} {what} asked for; it lists {listed}, allowed: {listed} to {most}"
                )
        counted = replace(
            self,
            n_cars=self.n_cars if n_cars is None else n_cars,
            n_blocks=self.n_blocks if n_blocks is None else n_blocks,
        )
        check_written(counted)
        return counted


def read_blueprint(path: str | Path) -> Blueprint:
    """Read and check a start file, or a shipped one by its name, such as ``strip``.

    Raises BlueprintError with file, line and key for whatever is wrong.

    Example:
        >>> import craftsim
        >>> import numpy as np
        >>> grid = craftsim.read_blueprint("strip").grid(np.random.default_rng(0))
        >>> grid.n_cars
        2
    """
    found = find(path, "blueprints")
    return parse_blueprint(read_text(found), found)


def parse_blueprint(text: str, path: str | Path) -> Blueprint:
    """Read and check a start file's text; ``path`` is the file that messages speak of."""
    source, keys = parse_keys(Path(path), text, KEYS)
    for key in REQUIRED_KEYS:
        if key not in keys.items:
            source.fail(None, f"key '{key}' is missing; required: {', '.join(REQUIRED_KEYS)}")
    size = (
        source.integer(keys.items["area_length"], "area_length", 1, MAX_SIDE),
        source.integer(keys.items["area_width"], "area_width", 1, MAX_SIDE),
        source.integer(keys.items["area_height"], "area_height", 1, MAX_SIDE),
    )
    cells = size[0] * size[1] * size[2]
    if cells > MAX_CELLS:
        source.fail(keys.items["area_length"].line, f"area of {cells} cells; allowed: at most {MAX_CELLS}")

    def count(key: str, high: int) -> int:
        return source.integer(keys.items[key], key, 0, high) if key in keys.items else 0

    for ignored_count in ("legged_robot_num", "wall_num"):
        count(ignored_count, cells)
    reader = _Reader(source, keys, size)
    blueprint = Blueprint(
        path=Path(path),
        size=size,
        n_blocks=count("block_num", cells),
        n_slopes=count("slope_num", cells),
        n_cars=count("smartcar_num", MAX_CARS),
        objects=tuple(o for key, kind in OBJECT_KEYS.items() for o in reader.objects(key, kind)),
        cars=reader.cars(count("smartcar_num", MAX_CARS)),
        goal=reader.goal(),
        notes=reader.notes(),
        snapshot=reader.snapshot(count("smartcar_num", MAX_CARS)),
    )
    check_blueprint(blueprint)
    return blueprint


class _Reader:
    """Reads the lists of one start file."""

    def __init__(self, source: Source, keys: Mapping, size: Cell) -> None:
        self.source = source
        self.keys = keys
        self.size = size

    def entries(self, key: str, known: list[str], required: list[str]) -> list[Mapping]:
        """Return the entries of a list, which may be absent; ids, where given, must differ."""
        if key not in self.keys.items:
            return []
        entries = self.source.entries(self.keys.items[key], key, ["id", *known], required)
        lines: dict[int, int] = {}
        for i, entry in enumerate(entries):
            if "id" in entry.items:
                name = self.source.integer(entry.items["id"], f"{key}[{i}].id", 0, MAX_CELLS)
                if name in lines:
                    taken = f"{name} is taken, see line {lines[name]}"
                    self.source.fail(entry.line, f"key '{key}[{i}].id': {taken}")
                lines[name] = entry.line
        return entries

    def field(self, entry: Mapping, where: str, name: str, low: int, high: int, default: int = 0) -> int:
        """Return one integer of an entry, or the default when it is absent."""
        if name not in entry.items:
            return default
        return self.source.integer(entry.items[name], f"{where}.{name}", low, high)

    def cell(self, entry: Mapping, where: str, low_z: int = 1, high_z: int | None = None) -> Cell:
        """Return the cell of an entry, which must lie in the area."""
        length, width, height = self.size
        return (
            self.field(entry, where, "x", 0, length - 1),
            self.field(entry, where, "y", 0, width - 1),
            self.field(entry, where, "z", low_z, height if high_z is None else high_z),
        )

    def is_no_cell(self, entry: Mapping) -> bool:
        """Return whether an entry has the coordinates that stand for "none"."""
        texts = [node.text for name in "xyz" if isinstance(node := entry.items[name], Scalar)]
        return texts == [str(value) for value in NO_CELL]

    def objects(self, key: str, kind: Kind) -> list[ListedObject]:
        """Return the objects of one list."""
        yawed = kind in KINDS_WITH_YAW
        names = ["x", "y", "z", "yaw"] if yawed else ["x", "y", "z"]
        found = []
        for i, entry in enumerate(self.entries(key, names, names)):
            if kind == Kind.FLAG and self.is_no_cell(entry):
                continue
            where = f"{key}[{i}]"
            yaw = self.field(entry, where, "yaw", 0, 3)
            found.append(ListedObject(kind, self.cell(entry, where), yaw, entry.line))
        return found

    def cars(self, n_cars: int) -> tuple[ListedCar, ...]:
        """Return the listed cars by id."""
        known = ["x", "y", "z", "yaw", "load", "load_yaw", "slope"]
        found = []
        for i, entry in enumerate(self.entries("smartcar", known, ["id", "x", "y", "z", "yaw"])):
            where = f"smartcar[{i}]"
            car = self.source.integer(entry.items["id"], f"{where}.id", 0, max(n_cars - 1, 0))
            load = Kind.AIR
            if "load" in entry.items:
                load = LOADS[self.source.word(entry.items["load"], f"{where}.load", list(LOADS))]
            yaw = self.field(entry, where, "yaw", 0, 3)
            load_yaw = self.field(entry, where, "load_yaw", 0, 3, (yaw + 2) % 4 if load == Kind.FSLOPE else 0)
            slope = self.field(entry, where, "slope", 0, 2)
            cell = self.cell(entry, where, high_z=self.size[2] + 1)
            found.append(ListedCar(car, cell, yaw, load, load_yaw, slope, entry.line))
        return tuple(sorted(found, key=lambda listed: listed.car))

    def goal(self) -> Cell | None:
        """Return the goal cell, the first entry of its list."""
        entries = self.entries("goal", ["x", "y", "z"], ["x", "y", "z"])
        if not entries or self.is_no_cell(entries[0]):
            return None
        return self.cell(entries[0], "goal[0]")

    def notes(self) -> tuple[str, ...]:
        """Return remarks on what the file has that we do not use."""
        notes = []
        if "legged_robot" in self.keys.items or "legged_robot_num" in self.keys.items:
            notes.append("legged robots are ignored: there are none in this world")
        if len(self.entries("goal", ["x", "y", "z"], ["x", "y", "z"])) > 1:
            notes.append("only the first goal is used")
        return tuple(notes)

    def snapshot(self, n_cars: int) -> Snapshot | None:
        """Return the part that only worlds saved while they run have."""
        if "snapshot" not in self.keys.items:
            return None
        lists = self.source.mapping(self.keys.items["snapshot"], "snapshot", ["cells", "top", "back"])

        def entries(name: str, *names: str) -> list[tuple[str, Mapping]]:
            node = lists.items.get(name, Sequence(lists.line))
            known = ["x", "y", "z", *names]
            found = self.source.entries(node, f"snapshot.{name}", known, known)
            return [(f"snapshot.{name}[{i}]", entry) for i, entry in enumerate(found)]

        kinds = {kind.name.lower(): kind for kind in Kind}
        cells = []
        for where, entry in entries("cells", "kind", "yaw"):
            kind = kinds[self.source.word(entry.items["kind"], f"{where}.kind", list(kinds))]
            cells.append(Override(self.cell(entry, where), kind, self.field(entry, where, "yaw", 0, 3)))
        top = [
            (self.cell(entry, where, low_z=0), self.field(entry, where, "mark", -2, n_cars - 1))
            for where, entry in entries("top", "mark")
        ]
        back = [
            (self.cell(entry, where, low_z=0), self.field(entry, where, "mark", 0, 1))
            for where, entry in entries("back", "mark")
        ]
        return Snapshot(tuple(cells), tuple(top), tuple(back))
