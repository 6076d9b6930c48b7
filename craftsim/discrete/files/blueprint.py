"""Blueprints: the start of a world as drawn in a YAML file, in CraftEnv's format with a few additions.

docs/reference/world-files.md describes the keys.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator, ValidationInfo

from craftsim.discrete.files.placement import CarRow, Placement, build_grid, check_sense, outside
from craftsim.discrete.files.shipped import find
from craftsim.discrete.grid import (
    MAX_CARS,
    MAX_CELLS,
    MAX_SIDE,
    SECOND_PART,
    CarField,
    Cell,
    Grid,
    Kind,
    Piece,
)
from craftsim.discrete.kinds import CARRIED
from craftsim.errors import BlueprintError
from craftsim.storage.limits import YAML_VALUES, Range
from craftsim.storage.records import Loc, Mistake, described, key_words, record
from craftsim.storage.writing import write_whole
from craftsim.storage.yaml import Document, dump, parse_document, read_document

NO_CELL: Final[Cell] = (-1, -2, 1)
"""The coordinates with which CraftEnv's files say that there is no flag or no goal."""

OBJECT_KEYS: Final = {
    "block": Kind.BLOCK,
    "fold_slope": Kind.FSLOPE,
    "unfold_slope": Kind.BODY,
    "flag": Kind.FLAG,
    "wall": Kind.WALL,
}
"""Lists of objects, in the order in which they are placed."""

_KIND_NAMES: Final = np.array([kind.name.lower() for kind in Kind])
LOADS: Final = {key: kind for key, kind in OBJECT_KEYS.items() if kind in CARRIED}
"""What a car's line names as its load."""

_SIDE: Final = Range(1, MAX_SIDE)
_CARS: Final = Range(0, MAX_CARS)


def _in(what: str) -> PlainValidator:
    """Hold an integer to a range that follows from the area and the number of cars of its file."""

    def held(value: Any, info: ValidationInfo) -> int:
        ranges: dict[str, Range] = info.context or {}
        allowed = ranges[what]
        if type(value) is not int:
            raise ValueError(f"must be an integer {allowed.words}, not {described(value)}")
        if value not in allowed:
            raise ValueError(allowed.out(value))
        return value

    return PlainValidator(held)


_Count = Annotated[int, _in("count")]
_Yaw = Annotated[int, Range(0, 3)]


@record(kw_only=True)
class _Place:
    id: Annotated[int, Range(0, MAX_CELLS)] | None = None
    x: Annotated[int, _in("x")]
    y: Annotated[int, _in("y")]
    z: Annotated[int, _in("z")]

    @property
    def cell(self) -> Cell:
        return self.x, self.y, self.z


@record(kw_only=True)
class _Slope(_Place):
    yaw: _Yaw


@record(kw_only=True)
class _Car(_Slope):
    id: Annotated[int, _in("car")] = field()  # An object may leave its id out, a car not.
    z: Annotated[int, _in("z_of_car")]
    load: Literal["block", "flag", "fold_slope"] | None = None
    load_yaw: _Yaw | None = None
    slope: Annotated[int, Range(0, 2)] = 0

    def __post_init__(self) -> None:
        if self.load_yaw is not None and self.load != "fold_slope":
            raise ValueError("load_yaw has an effect with 'load: fold_slope' alone; leave it out")

    @property
    def row(self) -> CarRow:
        if self.load is None:
            load = Kind.AIR
        else:
            load = LOADS[self.load]
        behind = 0
        if load == Kind.FSLOPE:
            behind = (self.yaw + 2) % 4
        load_yaw = behind if self.load_yaw is None else self.load_yaw
        return *self.cell, self.yaw, load, load_yaw, self.slope


@record(kw_only=True)
class _OddCell(_Slope):
    kind: Literal["air", "ground", "wall", "block", "flag", "fslope", "gear", "body", "foot"]


@record(kw_only=True)
class _Mark(_Place):
    z: Annotated[int, _in("z_of_mark")]
    mark: Annotated[int, _in("mark")]


@record(kw_only=True)
class _Landing(_Mark):
    mark: Annotated[int, Range(0, 1)]


@record(kw_only=True)
class Snapshot:
    """What a world saved while it runs has beyond its listed objects: odd cells and marks that differ."""

    cells: tuple[_OddCell, ...] = ()
    top: tuple[_Mark, ...] = ()
    back: tuple[_Landing, ...] = ()

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """The odd cells, whatever they hold."""
        return tuple(Piece(Kind[one.kind.upper()], one.cell, one.yaw) for one in self.cells)


@record(kw_only=True)
class _File:
    area_length: Annotated[int, _SIDE]
    area_width: Annotated[int, _SIDE]
    area_height: Annotated[int, _SIDE]
    block_num: _Count
    slope_num: _Count
    smartcar_num: Annotated[int, _CARS]
    block: tuple[_Place, ...] = ()
    fold_slope: tuple[_Slope, ...] = ()
    unfold_slope: tuple[_Slope, ...] = ()
    flag: tuple[_Place | None, ...] = ()
    wall: tuple[_Place, ...] = ()
    smartcar: tuple[_Car, ...] = ()
    goal: tuple[_Place | None, ...] = ()
    legged_robot_num: _Count | None = None
    legged_robot: Any = None
    wall_num: _Count | None = None
    yaml_generated_time: Any = None
    snapshot: Snapshot | None = None

    @classmethod
    def of(cls, document: Document) -> _File:
        """Return what a document says, held to the area and the number of cars that it gives."""
        plain = {**document.plain}

        def given(key: str, allowed: Range) -> int:
            number = plain.get(key)
            if type(number) is int and number in allowed:
                return number
            return int(allowed.high)

        length, width, height = (given(key, _SIDE) for key in KEYS[:3])
        n_cars = given("smartcar_num", _CARS)
        ranges = {"x": Range(0, length - 1), "y": Range(0, width - 1), "z": Range(1, height)}
        ranges |= {"z_of_car": Range(1, height + 1), "z_of_mark": Range(0, height)}
        ranges |= {"car": Range(0, max(n_cars - 1, 0)), "mark": Range(-2, n_cars - 1)}
        for key in (*OBJECT_KEYS, "smartcar", "goal"):
            if plain.get(key, ()) is None:
                del plain[key]
            elif key in ("flag", "goal") and isinstance(entries := plain.get(key), list):
                cells = ([e.get(axis) for axis in "xyz"] if isinstance(e, dict) else () for e in entries)
                plain[key] = [None if (*at,) == NO_CELL else e for e, at in zip(entries, cells, strict=True)]
        return replace(document, plain=plain).to(cls, count=Range(0, length * width * height), **ranges)

    def objects(self) -> Iterator[tuple[Loc, Piece]]:
        """Yield the objects, each with its place in the file."""
        for key, kind in OBJECT_KEYS.items():
            for i, entry in enumerate(getattr(self, key)):
                if entry is not None:
                    yield (key, i), Piece(kind, entry.cell, getattr(entry, "yaw", 0))

    def repeated_ids(self, document: Document) -> Iterator[Mistake]:
        """Yield the entries whose id an entry of the same list before has."""
        for key in (*OBJECT_KEYS, "smartcar", "goal"):
            first: dict[int, int] = {}
            for i, entry in enumerate(getattr(self, key)):
                if entry is not None and entry.id is not None and first.setdefault(entry.id, i) != i:
                    line = document.lines.get((key, first[entry.id]))
                    yield (key, i), f"{key_words((key, i, 'id'))}: {entry.id} is taken, see line {line}"


KEYS: Final = [one.name for one in fields(_File)]


@dataclass(frozen=True)
class Blueprint:
    """A checked start file; what its numbers have beyond the listed objects and cars is drawn at random.

    Example:
        >>> import craftsim
        >>> blueprint = craftsim.read_blueprint("strip")
        >>> blueprint.size, blueprint.n_cars, blueprint.n_blocks
        ((4, 4, 3), 2, 4)
    """

    path: Path
    size: Cell
    """(L, W, H) in cells."""
    n_blocks: int
    n_slopes: int
    n_cars: int
    objects: tuple[Piece, ...] = ()
    cars: Mapping[int, CarRow] = field(default_factory=dict, hash=False)
    """By number: a row as in :attr:`Grid.cars`."""
    goal: Cell | None = None
    notes: tuple[str, ...] = ()
    """What the file has that is accepted and ignored, in plain words."""
    snapshot: Snapshot | None = None

    @property
    def is_fixed(self) -> bool:
        """Whether it has no random parts."""
        numbers = (self.n_blocks, self.n_slopes, self.n_cars)
        return numbers == (self.listed(Kind.BLOCK), self.listed(Kind.FSLOPE, Kind.BODY), len(self.cars))

    @property
    def content(self) -> dict[str, Any]:
        """Its content as JSON, independent of the file, for digests."""

        def plain(pieces: tuple[Piece, ...]) -> list[dict[str, Any]]:
            return [{"kind": kind.name, "cell": cell, "yaw": yaw} for kind, cell, yaw in pieces]

        names = ("yaw", "load", "load_yaw", "slope")
        cars = []
        for car, row in self.cars.items():
            cars.append(
                {
                    "car": car,
                    "cell": row[:3],
                    **dict(zip(names, row[3:], strict=True)),
                    "load": Kind(row[4]).name,
                }
            )
        found = {name: getattr(self, name) for name in ("size", "n_blocks", "n_slopes", "n_cars", "goal")}
        found |= {"objects": plain(self.objects), "cars": cars, "snapshot": None}
        if self.snapshot:
            top, back = ([(one.cell, one.mark) for one in m] for m in (self.snapshot.top, self.snapshot.back))
            found["snapshot"] = {"cells": plain(self.snapshot.pieces), "top": top, "back": back}
        return found

    def listed(self, *kinds: Kind) -> int:
        """Return how many objects of some kinds are listed, carried and odd ones included."""
        if self.snapshot:
            odd = self.snapshot.pieces
        else:
            odd = ()
        present = [*(piece.kind for piece in (*self.objects, *odd)), *(row[4] for row in self.cars.values())]
        return sum(kind in kinds for kind in present)

    def grid(self, rng: np.random.Generator, placement: Placement = "sane") -> Grid:
        """Return a new world; unlisted objects and cars are drawn from ``rng``.

        Marks start as events leave them (docs/rules.md#marks). Raises BlueprintError if there is no room.
        """
        return build_grid(self, rng, placement)

    def with_counts(self, n_cars: int | None = None, n_blocks: int | None = None) -> Blueprint:
        """Return the same start with other numbers of cars and blocks; those that are not listed are drawn at random.

        Raises BlueprintError for fewer than the file lists, and for more than there is room for.
        """
        cells = self.size[0] * self.size[1] * self.size[2]
        for what, number, listed, most in (
            ("cars", n_cars, len(self.cars), MAX_CARS),
            ("blocks", n_blocks, self.listed(Kind.BLOCK), cells),
        ):
            if number is not None and not listed <= number <= most:
                raise BlueprintError(
                    f"{self.path}: {number} {what} asked for; it lists {listed}, allowed: {listed} to {most}"
                )
        given: dict[str, Any] = {"n_cars": n_cars, "n_blocks": n_blocks}
        counted = replace(self, **{name: count for name, count in given.items() if count is not None})
        _check_values(counted)
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
    return blueprint_of(read_document(find(path, "blueprints"), BlueprintError))


def parse_blueprint(text: str, path: str | Path) -> Blueprint:
    """Read and check a start file's text; ``path`` is the file that messages speak of."""
    return blueprint_of(parse_document(text, Path(path), BlueprintError))


def blueprint_of(document: Document) -> Blueprint:
    """Check a start file that has been read. Worlds saved while they run need not make sense: play led to them."""
    file = _File.of(document)
    size = (file.area_length, file.area_width, file.area_height)
    cells = size[0] * size[1] * size[2]
    if cells > MAX_CELLS:
        document.fail((KEYS[0],), f"area of {cells} cells; allowed: at most {MAX_CELLS}")
    document.refuse(file.repeated_ids(document))
    things = list(file.objects())
    cars = sorted((entry.id, ("smartcar", i), entry.row) for i, entry in enumerate(file.smartcar))
    goal = None
    if file.goal:
        goal = file.goal[0]
    legged = file.legged_robot is not None or file.legged_robot_num is not None
    notes = ["legged robots are ignored: there are none in this world"] * legged
    notes += ["only the first goal is used"] * (len(file.goal) > 1)
    blueprint = Blueprint(
        path=document.path,
        size=size,
        n_blocks=file.block_num,
        n_slopes=file.slope_num,
        n_cars=file.smartcar_num,
        objects=tuple(piece for _, piece in things),
        cars={car: row for car, _, row in cars},
        goal=None if goal is None else goal.cell,
        notes=tuple(notes),
        snapshot=file.snapshot,
    )
    document.refuse(_counts(blueprint))
    _check_values(blueprint)
    document.refuse(outside(size, things))
    if file.snapshot is None:
        check_sense(document, size, things, cars, blueprint.goal)
    return blueprint


def _counts(blueprint: Blueprint) -> Iterator[Mistake]:
    """Yield the counts that are less than what is listed."""
    for key, number, found in (
        ("block_num", blueprint.n_blocks, blueprint.listed(Kind.BLOCK)),
        ("slope_num", blueprint.n_slopes, blueprint.listed(Kind.FSLOPE, Kind.BODY)),
        ("smartcar_num", blueprint.n_cars, len(blueprint.cars)),
    ):
        if found > number:
            yield (), f"key '{key}': {number}, but {found} are listed; allowed: at least {found}"


def _check_values(blueprint: Blueprint) -> None:
    """Raise BlueprintError for a world that may make more values than allowed when it is written as a blueprint.

    Everything is listed then, and what was drawn at random leaves marks that are listed, too.
    """
    # A mapping with its keys and values; 50 are in no list.
    entry = 9
    slope = 11
    car = 18
    n_slopes = blueprint.listed(Kind.FSLOPE, Kind.BODY)
    values = 50 + car * blueprint.n_cars + entry * (blueprint.n_cars - len(blueprint.cars))
    values += sum(slope if piece.kind in SECOND_PART else entry for piece in blueprint.objects)
    values += 3 * entry * (blueprint.n_blocks - blueprint.listed(Kind.BLOCK))
    values += (slope + 2 * entry) * (blueprint.n_slopes - n_slopes)
    snapshot = blueprint.snapshot
    if snapshot:
        # A cell that the objects do not account for makes what it breaks, and the marks left behind.
        cells = []
        for piece in blueprint.objects:
            for cell in piece.cells:
                cells.append(cell)
        odd = len(snapshot.cells) + len(cells) - len({*cells})
        values += (entry + 3 * slope) * odd + entry * (len(snapshot.top) + len(snapshot.back))
    if values > YAML_VALUES:
        numbers = f"{blueprint.n_blocks} blocks, {blueprint.n_slopes} slopes and {blueprint.n_cars} cars"
        listed = YAML_VALUES // entry // 100 * 100
        drawn = YAML_VALUES // (3 * entry) // 100 * 100
        raise BlueprintError(
            f"{blueprint.path}: a world of {numbers} makes {values} values when all is written down; allowed: at "
            f"most {YAML_VALUES}, which are about {listed} listed blocks, or {drawn} that are drawn"
        )


def blueprint_text(grid: Grid, goal: Cell | None = None) -> str:
    """Return a world as the text of a blueprint.

    A world that play has led to may hold what no drawing lists: half slopes, marks of past events. Such
    things go into a ``snapshot`` section, which is written only where it is needed.

    Raises BlueprintError for a world that no blueprint may hold.
    """
    plain = _plain(grid, goal)
    # A snapshot need not make sense; nothing is left to chance.
    saved = Document(Path("saved world"), plain | {"snapshot": {}}, error=BlueprintError)
    left = _left_over(grid, blueprint_of(saved).grid(np.random.default_rng(0)))
    if left:
        # Counts cover all that is given, also what is both listed and odd, such as a block with a yaw.
        odd = [entry["kind"] for entry in left.get("cells", ())]
        plain["block_num"] += odd.count("block")
        plain["slope_num"] += odd.count("fslope") + odd.count("body")
        return dump(plain | {"snapshot": left})
    try:
        blueprint_of(replace(saved, plain=plain))
    except BlueprintError:
        return dump(saved.plain)
    return dump(plain)


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


def _plain(grid: Grid, goal: Cell | None) -> dict[str, Any]:
    """Return the keys of a blueprint, without a snapshot; things that lack a part are not listed."""
    objects = {
        kind: [
            piece
            for piece in grid.pieces(kind)
            if all(map(grid.inside, piece.cells)) and [*map(grid.kind_at, piece.cells)] == [*piece.kinds]
        ]
        for kind in OBJECT_KEYS.values()
    }
    loads = Counter(grid.cars[:, CarField.LOAD].tolist())
    n_blocks = len(objects[Kind.BLOCK]) + loads[Kind.BLOCK]
    n_slopes = len(objects[Kind.FSLOPE]) + len(objects[Kind.BODY]) + loads[Kind.FSLOPE]
    plain: dict[str, Any] = dict(zip(KEYS, (*grid.size, n_blocks, n_slopes, grid.n_cars), strict=False))
    for key, kind in OBJECT_KEYS.items():
        names = ("x", "y", "z", "yaw") if kind in SECOND_PART else ("x", "y", "z")
        places = ((*piece.cell, piece.yaw) for piece in objects[kind])
        plain[key] = [{"id": i} | dict(zip(names, place, strict=False)) for i, place in enumerate(places)]
    plain["smartcar"] = [{"id": car} | _car(row) for car, row in enumerate(grid.cars.tolist())]
    plain["goal"] = [{"id": 0} | dict(zip("xyz", goal or NO_CELL, strict=True))]
    return {key: value for key, value in plain.items() if value != []}


def _car(row: list[int]) -> dict[str, Any]:
    entry: dict[str, Any] = dict(zip(("x", "y", "z", "yaw"), row, strict=False))
    load, load_yaw, slope = row[CarField.LOAD :]
    if load != Kind.AIR:
        entry["load"] = next(name for name, kind in LOADS.items() if kind == load)
    if load == Kind.FSLOPE:
        entry["load_yaw"] = load_yaw
    return entry | ({"slope": slope} if slope else {})


def _left_over(grid: Grid, bare: Grid) -> dict[str, Any]:
    """Return what a world has beyond what its objects and cars make, ``bare``, as a snapshot's lists."""
    odd = np.any(grid.cells[..., :2] != bare.cells[..., :2], axis=-1)
    # An odd cell is put in place with blank marks.
    bare.occupant[odd] = -1
    bare.landing[odd] = 0

    def entries(differs: NDArray[np.bool_], names: tuple[str, ...], *values: Any) -> list[dict[str, Any]]:
        found = zip(np.argwhere(differs).tolist(), *(one[differs].tolist() for one in values), strict=True)
        return [dict(zip(("x", "y", "z", *names), (*cell, *own), strict=True)) for cell, *own in found]

    left = {
        "cells": entries(odd, ("kind", "yaw"), _KIND_NAMES[grid.kind], grid.yaw),
        "top": entries(grid.occupant != bare.occupant, ("mark",), grid.occupant),
        "back": entries(grid.landing != bare.landing, ("mark",), grid.landing),
    }
    return {key: listed for key, listed in left.items() if listed}
