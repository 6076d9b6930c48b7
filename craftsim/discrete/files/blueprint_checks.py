"""Does a drawing make sense: counts against lists, one thing in a cell, everything stands on something."""

from __future__ import annotations

from collections import Counter
from typing import Final

from craftsim.discrete.files.documents import Source
from craftsim.discrete.files.listing import ListedCar, ListedObject, Listing
from craftsim.discrete.grid import SECOND_PART, Cell, Kind, beside
from craftsim.discrete.kinds import NAMES
from craftsim.storage.limits import YAML_VALUES

_ENTRY: Final = 9
"""Values that an object, or a mark, makes in a file: its mapping, and four keys with theirs."""
_SLOPE: Final = _ENTRY + 2
_CAR: Final = 2 * _ENTRY
_BASE: Final = 50
"""Values of a file beside its entries."""
_ODD: Final = _ENTRY + 3 * _SLOPE
"""The most that a cell which the listed objects do not account for makes: what it breaks, and the marks left behind."""


def parts(item: ListedObject) -> list[tuple[Cell, Kind]]:
    """Return the one or two cells that a listed object takes, and what is in each."""
    taken = [(item.cell, item.kind)]
    if item.kind in SECOND_PART:
        taken.append((beside(item.cell, item.yaw), SECOND_PART[item.kind]))
    return taken


class _Checker:
    def __init__(self, blueprint: Listing) -> None:
        self.blueprint = blueprint
        self.source = Source(blueprint.path)
        self.kinds: dict[Cell, Kind] = {}
        self.lines: dict[Cell, int] = {}
        self.yaws: dict[Cell, int] = {}

    def inside(self, cell: Cell) -> bool:
        """Return whether a cell is in the area, ground layer excluded."""
        length, width, height = self.blueprint.size
        return 0 <= cell[0] < length and 0 <= cell[1] < width and 1 <= cell[2] <= height

    def stands(self, cell: Cell) -> bool:
        """Return whether there is ground or a block below a cell."""
        x, y, z = cell
        return z == 1 or self.kinds.get((x, y, z - 1)) == Kind.BLOCK

    def counts(self) -> None:
        """Check that the counts cover the lists."""
        blueprint = self.blueprint
        listed = [
            ("block_num", blueprint.n_blocks, blueprint.listed(Kind.BLOCK)),
            ("slope_num", blueprint.n_slopes, blueprint.listed(Kind.FSLOPE, Kind.BODY)),
            ("smartcar_num", blueprint.n_cars, len(blueprint.cars)),
        ]
        for key, number, found in listed:
            if found > number:
                allowed = f"{found} are listed; allowed: at least {found}"
                self.source.fail(None, f"key '{key}': {number}, but {allowed}")

    def within(self, item: ListedObject) -> None:
        """Check that an object's cells lie in the area."""
        for cell, kind in parts(item):
            if not self.inside(cell):
                area = f"the area of {self.blueprint.size} cells"
                self.source.fail(item.line, f"{NAMES[kind]} would be at {cell}, outside {area}")

    def place(self, item: ListedObject) -> None:
        """Check that an object's cells are free, and remember them."""
        for cell, kind in parts(item):
            there = self.kinds.get(cell)
            # Two folded slopes may face each other with their gears in one cell: play leads there.
            shared = there == kind == Kind.GEAR and self.yaws[cell] == (item.yaw + 2) % 4
            if there is not None and not shared:
                other = f"{NAMES[there]} is already (line {self.lines[cell]})"
                self.source.fail(
                    item.line, f"{NAMES[kind]} would be at {cell}, where {other}; allowed: one thing a cell"
                )
            self.kinds[cell], self.lines[cell], self.yaws[cell] = kind, item.line, item.yaw

    def support(self, item: ListedObject) -> None:
        """Check that nothing floats; walls and gears may."""
        for cell, kind in parts(item):
            if kind not in (Kind.WALL, Kind.GEAR) and not self.stands(cell):
                allowed = "on the ground or on a block"
                self.source.fail(item.line, f"{NAMES[kind]} at {cell} floats; allowed: {allowed}")

    def car(self, car: ListedCar) -> None:
        """Check that a car stands on something, and that it fits a slope or load in its cell."""
        own = self.kinds.get(car.cell, Kind.AIR)
        where = f"car {car.car} at {car.cell}"
        if own == Kind.WALL:
            self.source.fail(car.line, f"{where} is inside a wall")
        along = self.yaws.get(car.cell, 0)
        if car.slope == 2:
            body = (car.cell[0], car.cell[1], car.cell[2] - 1)
            along = self.yaws.get(body, 0)
            if self.kinds.get(body) != Kind.BODY:
                self.source.fail(car.line, f"{where}: slope 2 needs the body of a slope below the car")
        elif not self.stands(car.cell):
            self.source.fail(car.line, f"{where} stands in the air; allowed: on the ground or on a block")
        if (car.slope == 1) != (own == Kind.FOOT):
            self.source.fail(car.line, f"{where}: slope 1 and a slope's foot in its cell need each other")
        if car.slope and (car.yaw - along) % 2:
            allowed = f"{along}, {(along + 2) % 4}"
            self.source.fail(car.line, f"{where}: yaw {car.yaw} is across the slope; allowed: {allowed}")
        if own in (Kind.FSLOPE, Kind.BODY) and car.yaw != (along + 2) % 4:
            allowed = f"{(along + 2) % 4}, away from its gear or foot"
            self.source.fail(car.line, f"{where}: yaw {car.yaw} under a slope; allowed: {allowed}")
        if car.load != Kind.AIR and own not in (Kind.AIR, Kind.GEAR, Kind.FOOT):
            self.source.fail(car.line, f"{where}: carries a load, but {NAMES[own]} is in its cell")
        if car.load == Kind.FSLOPE and car.load_yaw != (car.yaw + 2) % 4:
            allowed = f"{(car.yaw + 2) % 4}, behind the car"
            self.source.fail(car.line, f"{where}: load_yaw {car.load_yaw}; allowed: {allowed}")
        gear = beside(car.cell, car.load_yaw)
        if car.load == Kind.FSLOPE and not self.inside((gear[0], gear[1], 1)):
            area = f"the area of {self.blueprint.size} cells"
            self.source.fail(car.line, f"{where}: the gear of its slope would be at {gear}, outside {area}")

    def cars(self) -> None:
        """Check the cars one by one and against each other."""
        taken: dict[Cell, ListedCar] = {}
        for car in self.blueprint.cars:
            self.car(car)
            other = taken.setdefault(car.cell, car)
            if other is not car:
                there = f"where car {other.car} is (line {other.line})"
                self.source.fail(car.line, f"car {car.car} is at {car.cell}, {there}")

    def goal(self) -> None:
        """Check that the goal can be reached at all."""
        goal = self.blueprint.goal
        if goal is not None and self.kinds.get(goal) == Kind.WALL:
            self.source.fail(self.lines[goal], f"the goal {goal} is inside a wall")


def check_written(blueprint: Listing) -> None:
    """Raise BlueprintError for a world that makes more values than allowed when it is written as a blueprint.

    Everything is listed then, and what was drawn at random leaves marks that are listed, too.
    """
    slopes = (Kind.FSLOPE, Kind.BODY)
    values = _BASE + _CAR * blueprint.n_cars
    values += sum(_SLOPE if item.kind in slopes else _ENTRY for item in blueprint.objects)
    values += 3 * _ENTRY * (blueprint.n_blocks - blueprint.listed(Kind.BLOCK))
    values += (_SLOPE + 2 * _ENTRY) * (blueprint.n_slopes - blueprint.listed(*slopes))
    values += _ENTRY * (blueprint.n_cars - len(blueprint.cars))
    if blueprint.snapshot is not None:
        taken = Counter(cell for item in blueprint.objects for cell, _ in parts(item))
        odd = len(blueprint.snapshot.cells) + sum(n - 1 for n in taken.values())
        values += _ODD * odd + _ENTRY * (len(blueprint.snapshot.top) + len(blueprint.snapshot.back))
    if values > YAML_VALUES:
        Source(blueprint.path).fail(
            None,
            f"a world of {blueprint.n_blocks} blocks, {blueprint.n_slopes} slopes and {blueprint.n_cars} cars makes "
            f"{values} values when all is written down; allowed: at most {YAML_VALUES}, which are about "
            f"{YAML_VALUES // _ENTRY // 100 * 100} listed blocks, or {YAML_VALUES // (3 * _ENTRY) // 100 * 100} "
            "that are drawn",
        )


def check_blueprint(blueprint: Listing) -> None:
    """Raise BlueprintError if a blueprint contradicts itself.

    Worlds saved while they run are not checked for sense: what play led to is so.
    """
    checker = _Checker(blueprint)
    checker.counts()
    check_written(blueprint)
    for item in blueprint.objects:
        checker.within(item)
    if blueprint.snapshot is not None:
        return
    for item in blueprint.objects:
        checker.place(item)
    for item in blueprint.objects:
        checker.support(item)
    checker.cars()
    checker.goal()
