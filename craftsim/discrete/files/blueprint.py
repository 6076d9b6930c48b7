"""Blueprints: the start of a world as drawn in a YAML file, in CraftEnv's format with a few additions.

docs/reference/world-files.md describes the keys.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator, ValidationInfo

from craftsim.discrete.files.placement import (
    Placement,
    check_sense,
    draw_place,
    outside,
    put_objects,
)
from craftsim.discrete.files.shipped import find_file
from craftsim.discrete.grid import (
    MAX_CARS,
    MAX_CELLS,
    MAX_SIDE,
    SECOND_PART,
    CarField,
    CarRow,
    Cell,
    Grid,
    Kind,
    Piece,
)
from craftsim.discrete.kinds import CARRIED
from craftsim.errors import BlueprintError, check_choice
from craftsim.storage.limits import YAML_VALUES, Range
from craftsim.storage.records import Loc, Mistake, described, key_words, record
from craftsim.storage.writing import write_whole
from craftsim.storage.yaml import Document, dump, parse_document, read_document

NO_CELL: Final[Cell] = (-1, -2, 1)
"""The coordinates with which CraftEnv's files say that there is no flag or no goal."""

_OBJECT_KEYS: Final = {
    "block": Kind.BLOCK,
    "fold_slope": Kind.FSLOPE,
    "unfold_slope": Kind.BODY,
    "flag": Kind.FLAG,
    "wall": Kind.WALL,
}
"""Lists of objects, in the order in which they are placed."""

_KIND_NAMES: Final = np.array([kind.name.lower() for kind in Kind])
_LOADS: Final = {key: kind for key, kind in _OBJECT_KEYS.items() if kind in CARRIED}
"""Loads by their names in a car's line."""

_SIDE: Final = Range(1, MAX_SIDE)
_CARS: Final = Range(0, MAX_CARS)


def _in(name: str) -> PlainValidator:
    """Hold an integer to a range that follows from the area and the number of cars of its file."""

    def held(value: Any, info: ValidationInfo) -> int:
        ranges: dict[str, Range] = info.context or {}
        allowed = ranges[name]
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
            load = _LOADS[self.load]
        behind_car = 0
        if load == Kind.FSLOPE:
            behind_car = (self.yaw + 2) % 4
        load_yaw = self.load_yaw
        if load_yaw is None:
            load_yaw = behind_car
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
    """The state of a world saved while it runs beyond its listed objects: odd cells and marks that differ."""

    cells: tuple[_OddCell, ...] = ()
    top: tuple[_Mark, ...] = ()
    back: tuple[_Landing, ...] = ()

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """The odd cells, whatever they hold."""
        return tuple(Piece(Kind[odd.kind.upper()], odd.cell, odd.yaw) for odd in self.cells)


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
        """Return the content of a document, held to the area and the number of cars that it gives."""
        plain = {**document.plain}

        def count_of(key: str, allowed: Range) -> int:
            number = plain.get(key)
            if type(number) is int and number in allowed:
                return number
            return int(allowed.high)

        length = count_of("area_length", _SIDE)
        width = count_of("area_width", _SIDE)
        height = count_of("area_height", _SIDE)
        n_cars = count_of("smartcar_num", _CARS)
        ranges = {
            "x": Range(0, length - 1),
            "y": Range(0, width - 1),
            "z": Range(1, height),
            "z_of_car": Range(1, height + 1),
            "z_of_mark": Range(0, height),
            "car": Range(0, max(n_cars - 1, 0)),
            "mark": Range(-2, n_cars - 1),
            "count": Range(0, length * width * height),
        }
        for key in (*_OBJECT_KEYS, "smartcar", "goal"):
            if plain.get(key, ()) is None:
                del plain[key]
        for key in ("flag", "goal"):
            entries = plain.get(key)
            if isinstance(entries, list):
                plain[key] = [_without_no_cell(entry) for entry in entries]
        return replace(document, plain=plain).to(cls, **ranges)

    def objects(self) -> Iterator[tuple[Loc, Piece]]:
        """Yield the objects, each with its place in the file."""
        for key, kind in _OBJECT_KEYS.items():
            for i, entry in enumerate(getattr(self, key)):
                if entry is not None:
                    yield (key, i), Piece(kind, entry.cell, getattr(entry, "yaw", 0))

    def repeated_ids(self, document: Document) -> Iterator[Mistake]:
        """Yield the entries whose id an entry of the same list before has."""
        for key in (*_OBJECT_KEYS, "smartcar", "goal"):
            first: dict[int, int] = {}
            for i, entry in enumerate(getattr(self, key)):
                if (
                    entry is not None
                    and entry.id is not None
                    and first.setdefault(entry.id, i) != i
                ):
                    line = document.lines.get((key, first[entry.id]))
                    yield (
                        (key, i),
                        f"{key_words((key, i, 'id'))}: {entry.id} is taken, see line {line}",
                    )


def _without_no_cell(entry: Any) -> Any:
    """Return an entry of a file, or None for coordinates that say that there is no flag or no goal."""
    if isinstance(entry, dict) and (entry.get("x"), entry.get("y"), entry.get("z")) == NO_CELL:
        return None
    return entry


KEYS: Final = [item.name for item in fields(_File)]


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
    """Rows as in :attr:`Grid.cars`, by number."""
    goal: Cell | None = None
    notes: tuple[str, ...] = ()
    """Content of the file that is accepted and ignored, in plain words."""
    snapshot: Snapshot | None = None

    @property
    def is_fixed(self) -> bool:
        """Whether it has no random parts."""
        numbers = (self.n_blocks, self.n_slopes, self.n_cars)
        return numbers == (
            self.listed(Kind.BLOCK),
            self.listed(Kind.FSLOPE, Kind.BODY),
            len(self.cars),
        )

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
        content = {
            name: getattr(self, name) for name in ("size", "n_blocks", "n_slopes", "n_cars", "goal")
        }
        content |= {"objects": plain(self.objects), "cars": cars, "snapshot": None}
        if self.snapshot:
            content["snapshot"] = {
                "cells": plain(self.snapshot.pieces),
                "top": [(mark.cell, mark.mark) for mark in self.snapshot.top],
                "back": [(mark.cell, mark.mark) for mark in self.snapshot.back],
            }
        return content

    def listed(self, *kinds: Kind) -> int:
        """Return how many objects of some kinds are listed, carried and odd ones included."""
        present = [piece.kind for piece in self.objects]
        if self.snapshot:
            present += [piece.kind for piece in self.snapshot.pieces]
        loads = [row[CarField.LOAD] for row in self.cars.values()]
        return sum(kind in kinds for kind in [*present, *loads])

    def grid(self, rng: np.random.Generator, placement: Placement = "sane") -> Grid:
        """Return a new world; unlisted objects and cars are drawn from ``rng``.

        Marks start as events leave them (docs/rules.md#marks). Raises BlueprintError if there is no room.
        """
        check_choice("placement", placement, get_args(Placement))
        grid = Grid.empty(self.size, self.n_cars)
        put_objects(grid, self.objects)
        if self.snapshot:
            for piece in self.snapshot.pieces:
                grid.cells[piece.cell] = (piece.kind, piece.yaw, -1, 0)
        cars = np.zeros(grid.size[:2], np.bool_)
        for x, y, z, *_ in self.cars.values():
            cars[x, y] |= z == 1

        def place(item: Kind | Literal["car"], noun: str) -> tuple[Cell, int]:
            chosen = draw_place(grid, cars, rng, placement, item)
            if chosen is None:
                raise BlueprintError(f"{self.path}: no room left for {noun}")
            return chosen

        for _ in range(self.n_slopes - self.listed(Kind.FSLOPE, Kind.BODY)):
            cell, yaw = place(Kind.FSLOPE, "a random folded slope")
            grid.put(Piece(Kind.FSLOPE, cell, yaw))
        for _ in range(self.n_blocks - self.listed(Kind.BLOCK)):
            cell, _ = place(Kind.BLOCK, "a random block")
            grid.put(Piece(Kind.BLOCK, cell))
        for car in range(self.n_cars):
            row = self.cars.get(car)
            if row is None:
                cell, yaw = place("car", f"car {car}")
                row = (*cell, yaw, Kind.AIR, 0, 0)
                cars[cell[:2]] = True
            grid.cars[car] = row
            grid.occupant[row[0], row[1], row[2] - 1] = car
        if self.snapshot:
            for entry in self.snapshot.top:
                grid.occupant[entry.cell] = entry.mark
            for entry in self.snapshot.back:
                grid.landing[entry.cell] = entry.mark
        return grid

    def with_counts(self, n_cars: int | None = None, n_blocks: int | None = None) -> Blueprint:
        """Return the same start with other numbers of cars and blocks; those that are not listed are drawn at random.

        Raises BlueprintError for fewer than the file lists, and for more than there is room for.
        """
        cells = self.size[0] * self.size[1] * self.size[2]
        for noun, number, listed, highest in (
            ("cars", n_cars, len(self.cars), MAX_CARS),
            ("blocks", n_blocks, self.listed(Kind.BLOCK), cells),
        ):
            if number is not None and not listed <= number <= highest:
                raise BlueprintError(
                    f"{self.path}: {number} {noun} asked for; it lists {listed}, allowed: {listed} to {highest}"
                )
        counts: dict[str, Any] = {"n_cars": n_cars, "n_blocks": n_blocks}
        counted = replace(
            self, **{name: count for name, count in counts.items() if count is not None}
        )
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
    return blueprint_of(read_world(find_file(path, "blueprints")))


def read_world(path: Path) -> Document:
    """Read what a start file or a task file holds; raises BlueprintError as :func:`read_document`, and for a plan."""
    if path.suffix == ".plan":
        raise BlueprintError(f"{path} is a plan; give the world first, then --plan {path.name}")
    return read_document(path, BlueprintError)


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
    objects = list(file.objects())
    cars = sorted((entry.id, ("smartcar", i), entry.row) for i, entry in enumerate(file.smartcar))
    goal = None
    if file.goal and file.goal[0] is not None:
        goal = file.goal[0].cell
    legged = file.legged_robot is not None or file.legged_robot_num is not None
    notes = ["legged robots are ignored: there are none in this world"] * legged
    notes += ["only the first goal is used"] * (len(file.goal) > 1)
    blueprint = Blueprint(
        path=document.path,
        size=size,
        n_blocks=file.block_num,
        n_slopes=file.slope_num,
        n_cars=file.smartcar_num,
        objects=tuple(piece for _, piece in objects),
        cars={car: row for car, _, row in cars},
        goal=goal,
        notes=tuple(notes),
        snapshot=file.snapshot,
    )
    document.refuse(_counts(blueprint))
    _check_values(blueprint)
    document.refuse(outside(size, objects))
    if file.snapshot is None:
        check_sense(document, size, objects, cars, blueprint.goal)
    return blueprint


def _counts(blueprint: Blueprint) -> Iterator[Mistake]:
    """Yield the counts that are less than what is listed."""
    for key, number, n_listed in (
        ("block_num", blueprint.n_blocks, blueprint.listed(Kind.BLOCK)),
        ("slope_num", blueprint.n_slopes, blueprint.listed(Kind.FSLOPE, Kind.BODY)),
        ("smartcar_num", blueprint.n_cars, len(blueprint.cars)),
    ):
        if n_listed > number:
            yield (
                (),
                f"key '{key}': {number}, but {n_listed} are listed; allowed: at least {n_listed}",
            )


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
        numbers = (
            f"{blueprint.n_blocks} blocks, {blueprint.n_slopes} slopes and {blueprint.n_cars} cars"
        )
        most_listed = YAML_VALUES // entry // 100 * 100
        most_drawn = YAML_VALUES // (3 * entry) // 100 * 100
        raise BlueprintError(
            f"{blueprint.path}: a world of {numbers} makes {values} values when all is written down; allowed: at "
            f"most {YAML_VALUES}, which are about {most_listed} listed blocks, or {most_drawn} that are drawn"
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
    snapshot = _left_over(grid, blueprint_of(saved).grid(np.random.default_rng(0)))
    if snapshot:
        # Counts cover all that is given, also what is both listed and odd, such as a block with a yaw.
        odd = [entry["kind"] for entry in snapshot.get("cells", ())]
        plain["block_num"] += odd.count("block")
        plain["slope_num"] += odd.count("fslope") + odd.count("body")
        return dump(plain | {"snapshot": snapshot})
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
    objects: dict[Kind, list[Piece]] = {kind: [] for kind in _OBJECT_KEYS.values()}
    for piece in grid.pieces(*objects):
        is_inside = all(map(grid.inside, piece.cells))
        if is_inside and tuple(map(grid.kind_at, piece.cells)) == piece.kinds:
            objects[piece.kind].append(piece)
    loads = Counter(grid.cars[:, CarField.LOAD].tolist())
    n_blocks = len(objects[Kind.BLOCK]) + loads[Kind.BLOCK]
    n_slopes = len(objects[Kind.FSLOPE]) + len(objects[Kind.BODY]) + loads[Kind.FSLOPE]
    plain: dict[str, Any] = dict(
        zip(KEYS, (*grid.size, n_blocks, n_slopes, grid.n_cars), strict=False)
    )
    for key, kind in _OBJECT_KEYS.items():
        plain[key] = []
        for i, piece in enumerate(objects[kind]):
            entry = {"id": i} | dict(zip("xyz", piece.cell, strict=True))
            if kind in SECOND_PART:
                entry["yaw"] = piece.yaw
            plain[key].append(entry)
    plain["smartcar"] = [{"id": car} | _car(row) for car, row in enumerate(grid.cars.tolist())]
    plain["goal"] = [{"id": 0} | dict(zip("xyz", goal or NO_CELL, strict=True))]
    return {key: value for key, value in plain.items() if value != []}


def _car(row: list[int]) -> dict[str, Any]:
    entry: dict[str, Any] = dict(zip(("x", "y", "z", "yaw"), row, strict=False))
    load, load_yaw, slope = row[CarField.LOAD :]
    if load != Kind.AIR:
        entry["load"] = next(name for name, kind in _LOADS.items() if kind == load)
    if load == Kind.FSLOPE:
        entry["load_yaw"] = load_yaw
    if slope:
        entry["slope"] = slope
    return entry


def _left_over(grid: Grid, bare: Grid) -> dict[str, Any]:
    """Return the lists of a snapshot: how a world differs from ``bare``, which its objects and cars make."""
    odd = np.any(grid.cells[..., :2] != bare.cells[..., :2], axis=-1)
    # An odd cell is put in place with blank marks.
    bare.occupant[odd] = -1
    bare.landing[odd] = 0

    def entries(
        differs: NDArray[np.bool_], names: tuple[str, ...], *values: Any
    ) -> list[dict[str, Any]]:
        keys = ("x", "y", "z", *names)
        cells = np.argwhere(differs).tolist()
        columns = [array[differs].tolist() for array in values]
        rows = []
        for cell, *fields_there in zip(cells, *columns, strict=True):
            rows.append(dict(zip(keys, (*cell, *fields_there), strict=True)))
        return rows

    lists = {
        "cells": entries(odd, ("kind", "yaw"), _KIND_NAMES[grid.kind], grid.yaw),
        "top": entries(grid.occupant != bare.occupant, ("mark",), grid.occupant),
        "back": entries(grid.landing != bare.landing, ("mark",), grid.landing),
    }
    return {key: listed for key, listed in lists.items() if listed}
