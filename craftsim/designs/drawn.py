"""Random buildings that cars can build, with starts for them, by a difficulty.

They grow block by block and ramp by ramp, each step one that a car could make just then: loads come from the floor, of
which all that stays free is in one piece. An unloaded car also drives under blocks, so that who has set down a block,
or unfolded a slope, gets away below what stands there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.designs.starts import (
    BUILDING_MARGIN,
    DesignStart,
    FloorColumn,
    FloorMask,
    label_pieces,
    spread_things,
)
from craftsim.discrete.files.design import Design
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import Cell, Grid, Kind, Piece, beside
from craftsim.discrete.move_graph import UNREACHABLE, MoveGraph
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError
from craftsim.storage.limits import SHARE

_PHYSICAL: Final = Rules("physical")
_MAX_LEVELS: Final = 3
_SIDE: Final = 8
"""Side of the largest area."""
_TRIES: Final = 12
"""Attempts at one size."""
_GROWTHS: Final = 10
"""Attempts to grow a building without a dead end."""
_COMPACT: Final = {1: 0.2, 2: 0.5, 3: 0.9}
"""Probability that a block goes where most blocks are, by levels of the building: an upper ramp needs a platform."""
_SPREAD: Final = 0.15
"""Probability that a block on the floor may go anywhere."""
_KEPT: Final = 0.5
"""Probability that a ramp belongs to the design; the others serve for building alone."""
_SHARE: Final = 0.62
"""Largest share of the floor that a building and its material take."""
_BLOCKS_OF_THREE_LEVELS: Final = 9
"""Smallest number of blocks of a building of three levels."""
_FILL: Final = 0.1, 0.25
"""Share of its box that a solid building takes."""
_STRUCTURE: Final[tuple[Cell, Cell]] = ((5, 5, 1), (16, 16, 4))
"""Smallest and largest box of a solid building."""
_STRUCTURES: Final = 200
"""Attempts to grow a solid building without a dead end."""


@dataclass(frozen=True)
class Size:
    """Numbers that follow from a difficulty."""

    area: Cell
    blocks: int
    levels: int
    ramps: int
    cars: int


def _size_of(difficulty: float, rng: np.random.Generator) -> Size:
    """Draw what a difficulty from 0 to 1 asks for: up to 8 x 8 x 3 cells, 16 blocks, 4 ramps and 6 cars."""
    SHARE.check("the difficulty", difficulty)

    def about(low: int, high: int, spread_things: float) -> int:
        middle = low + difficulty * (high - low)
        return int(
            np.clip(round(rng.uniform(middle - spread_things, middle + spread_things)), low, high)
        )

    blocks = about(4, 16, 2.0)
    levels = about(1, 3, 0.6)
    if levels == 3 and blocks < _BLOCKS_OF_THREE_LEVELS:
        levels = 2
    ramps = int(np.clip(about(0, 4, 1.0), levels - 1, 4))
    while _cells(blocks, ramps) > _SHARE * _SIDE**2 and (
        ramps >= levels or blocks > _BLOCKS_OF_THREE_LEVELS
    ):
        fewer_ramps = ramps >= levels and (blocks <= _BLOCKS_OF_THREE_LEVELS or rng.random() < 0.4)
        if fewer_ramps:
            ramps = ramps - 1
        else:
            blocks = blocks - 1
    sides = []
    for x in range(6, _SIDE + 1):
        for y in range(6, _SIDE + 1):
            if _cells(blocks, ramps) <= _SHARE * x * y:
                sides.append((x, y))
    length, width = min(
        sides or [(_SIDE, _SIDE)], key=lambda side: (side[0] * side[1], rng.random())
    )
    return Size((length, width, _MAX_LEVELS), blocks, levels, ramps, about(2, 6, 1.0))


def _cells(blocks: int, ramps: int) -> float:
    """Return about how many cells of the floor a building, and its things before, take."""
    return 1.8 * blocks + 5 * ramps


def random_start(
    rng: np.random.Generator, difficulty: float = 0.5, n_cars: int | None = None
) -> DesignStart:
    """Draw a design that can be built, and a start to build it from.

    Each block and ramp is put where a car could bring it, in the order of ``steps``, and each upper level is reached by
    a ramp, of the design or a spare one. The things of the start lie beside the columns that the steps take.

    Args:
        rng: draws all.
        difficulty: 0 to 1, which sets area, blocks, levels, ramps and cars (:func:`_size_of`).
        n_cars: number of cars, if it is to be another.

    Raises InputError for another difficulty, and for cars that have no room.
    """
    size = _size_of(difficulty, rng)
    cars = size.cars if n_cars is None else n_cars
    if cars > _SIDE**2:
        raise InputError(
            f"{cars} cars have no room in a random design; allowed: fewer than {_SIDE**2}"
        )
    while True:
        for _ in range(_TRIES):
            start = start_of(size, cars, rng)
            if start is not None:
                return start
        size = _easier(size, cars, rng)


def random_structure(size: Sequence[int], rng: np.random.Generator) -> Design:
    """Draw a solid building of blocks that is as high as a box of a size (length, width, height) and fits into it.

    It takes 10 to 25 % of the box, about half as many blocks on each level as on the one below. It grows as those of
    :func:`random_start` do, by a ramp to each level, which is no part of it.

    Raises InputError for a size that is not from 5 x 5 x 1 to 16 x 16 x 4 cells, and where nothing so high is found.
    """
    bounds = zip(_STRUCTURE[0], size, _STRUCTURE[1], strict=False)
    if len(size) != 3 or not all(low <= side <= high for low, side, high in bounds):
        allowed = " to ".join(" x ".join(map(str, box)) for box in _STRUCTURE)
        raise InputError(
            f"a random building of {' x '.join(map(str, size))} cells; allowed: length, width and height, {allowed}"
        )
    length, width, levels = size
    site = np.pad(np.ones((length, width), np.bool_), BUILDING_MARGIN)
    weights = 0.5 ** np.arange(levels)
    for _ in range(_STRUCTURES):
        blocks = rng.uniform(*_FILL) * length * width * levels
        numbers = np.maximum(np.rint(blocks * weights / weights.sum()), 1).astype(int).tolist()
        growth = _Growth(np.zeros(site.shape, np.int64), site, height=levels)
        if growth.grow(numbers, 0, rng):
            x, y = np.argwhere(growth.heights).min(axis=0).tolist()
            cells = []
            for step in growth.steps:
                if step.kind == Kind.BLOCK:
                    cells.append((step.cell[0] - x, step.cell[1] - y, step.cell[2]))
            return Design.of("random", cells)
    raise InputError(
        f"no random building of {length} x {width} x {levels} cells is found; try a longer or a lower one"
    )


def start_of(size: Size, n_cars: int, rng: np.random.Generator) -> DesignStart | None:
    """Return a start of a size, or None where the building, or its things beside it, found no room."""
    for _ in range(_GROWTHS):
        growth = _Growth.on(*size.area[:2], rng)
        if growth.grow(_split(size, rng), size.ramps - (size.levels - 1), rng):
            break
    else:
        return None
    design_ramps = [(ramp.cell, ramp.yaw) for ramp in growth.ramps if rng.random() < _KEPT]
    design = Design.of(
        "random", [step.cell for step in growth.steps if step.kind == Kind.BLOCK], design_ramps
    )
    spare = len(growth.ramps) - len(design_ramps)
    reserved = set()
    for ramp in growth.ramps:
        for column in _columns(ramp, 0, 1):
            reserved.add(column)
    clear = growth.approaches(rng)
    for ramp in growth.ramps:
        if ramp.cell[2] == 1:
            clear.add(_column(ramp, 2))
    for x, y, z in growth.lanes:
        if z == 1:
            clear.add((x, y))
    fits = None
    if growth.ramps:
        fits = partial(_slopes_get_there, growth.steps)
    try:
        grid = spread_things(
            design,
            size.area,
            n_cars,
            rng,
            spare_slopes=spare,
            reserved=reserved,
            clear=clear,
            fits=fits,
        )
    except InputError:
        return None
    return DesignStart(grid, design, tuple(growth.steps))


def _slopes_get_there(steps: Sequence[Piece], grid: Grid) -> bool:
    """Return whether each slope on the floor of a start can be carried to each ramp, in the order of steps."""
    growth = _Growth(np.zeros(grid.size[:2], np.int64), np.ones(grid.size[:2], np.bool_))
    obstacles = grid.kind[:, :, 1] != Kind.AIR
    slopes = [slope for slope in grid.pieces(Kind.FSLOPE) if slope.cell[2] == 1]
    for step in steps:
        if step.kind == Kind.BLOCK:
            growth.heights[step.cell[:2]] += 1
            continue
        world = growth.world(obstacles)
        for slope in slopes:
            remaining = world.copy()
            for cell in slope.cells:
                remaining.kind[cell] = Kind.AIR
            graph = MoveGraph(remaining, _PHYSICAL, Kind.FSLOPE)
            if graph.nearest(graph.distances_from(graph.nodes(slope)), step) >= UNREACHABLE:
                return False
        growth.ramps.append(step)
    return True


def _easier(size: Size, n_cars: int, rng: np.random.Generator) -> Size:
    """Return a size that has more room: a larger area, or where there is none, fewer ramps, or fewer blocks."""
    length, width, height = size.area
    if min(length, width) < _SIDE:
        if length < width:
            length = length + 1
        else:
            width = width + 1
        return replace(size, area=(length, width, height))
    if size.ramps >= size.levels and (size.blocks <= _BLOCKS_OF_THREE_LEVELS or rng.random() < 0.5):
        return replace(size, ramps=size.ramps - 1)
    if size.levels == 3 and size.blocks == _BLOCKS_OF_THREE_LEVELS:
        return replace(size, levels=2, ramps=1)
    if size.blocks > 1:
        return replace(size, blocks=size.blocks - 1)
    raise InputError(f"{n_cars} cars have no room in a random design of {size.area}; try fewer")


def _split(size: Size, rng: np.random.Generator) -> list[int]:
    upper = [1] * (size.levels - 1)
    if size.levels == 2:
        most_above = size.blocks // 3
    else:
        most_above = 1 + (size.blocks - _BLOCKS_OF_THREE_LEVELS) // 3
    if upper:
        upper[0] = int(rng.integers(1, max(1, most_above) + 1))
    if size.levels == 3:
        upper[0] += 1
    return [size.blocks - sum(upper), *upper]


@dataclass
class _Growth:
    """A building in the making."""

    heights: NDArray[np.int64]
    """(L, W): number of blocks in each column."""
    site: FloorMask
    """(L, W): cells of the floor that may get blocks."""
    ramps: list[Piece] = field(default_factory=list)
    steps: list[Piece] = field(default_factory=list)
    """The blocks and ramps in the order in which they were put there."""
    lanes: set[Cell] = field(default_factory=set)
    """Cells that stay free, since gears of carried slopes pass there."""
    height: int = _MAX_LEVELS
    """Height of the area in levels."""

    @classmethod
    def on(cls, length: int, width: int, rng: np.random.Generator) -> _Growth:
        """Begin with a bare floor; a border of it, and a strip on one side, stay so."""
        site = np.zeros((length, width), np.bool_)
        begin = [1, 1]
        end = [length - 1, width - 1]
        axis = int(rng.integers(2))
        strip = 1 + min(2, min(length, width) - 5)
        if rng.random() < 0.5:
            begin[axis] = strip
        else:
            end[axis] -= strip - 1
        site[begin[0] : end[0], begin[1] : end[1]] = True
        return cls(np.zeros((length, width), np.int64), site)

    def grow(self, blocks: Sequence[int], spare: int, rng: np.random.Generator) -> bool:
        """Put so many blocks on each level, and ramps to it; return whether there was no dead end.

        ``spare`` is the number of ramps beyond one for each upper level.
        """
        levels = len(blocks)
        compact = _COMPACT[min(levels, _MAX_LEVELS)]
        for level, number in enumerate(blocks, start=1):
            if level > 1 and not self.add_ramp(level - 1, rng, for_slopes=level < levels):
                return False
            # A second way up, where there is a slope for it.
            if level > 1 and spare and rng.random() < 0.5:
                spare -= self.add_ramp(level - 1, rng)
            for _ in range(number):
                added = self.add_block(level, rng, compact)
                if not added and level == levels:
                    added = self.cap_landing(level, rng)
                if not added:
                    return False
        return all(self.add_ramp(1, rng) for _ in range(spare))

    def world(self, obstacles: FloorMask | None = None) -> Grid:
        """Return the building in an area of its own; ``obstacles`` (L, W) stand on the floor and bear nothing."""
        grid = Grid.empty((*self.heights.shape, self.height))
        grid.kind[:, :, 1:][self.heights[:, :, None] >= np.arange(1, self.height + 1)] = Kind.BLOCK
        for ramp in self.ramps:
            grid.put(ramp)
        if obstacles is not None:
            grid.kind[:, :, 1][obstacles] = Kind.WALL
        return grid

    def from_floor(self, load: Kind) -> NDArray[np.bool_]:
        """Return (L, W, H + 2, 4): the cells and headings to which a load comes from the free floor."""
        graph = MoveGraph(self.world(), _PHYSICAL, load)
        distances = graph.distances_from(graph.floor_nodes(self._free_floor()))
        reached: NDArray[np.bool_] = np.less(distances, UNREACHABLE).reshape(graph.numbers.shape)
        return reached

    def add_block(self, level: int, rng: np.random.Generator, compact: float) -> bool:
        """Put a block on a level at random; return whether there was a place for it.

        ``compact`` is how often it goes where most blocks are beside it; else it goes beside any, or of the floor's now
        and then somewhere else.
        """
        places = self._places(level)
        n_neighbours = np.zeros(self.heights.shape, np.int64)
        for dx, dy in DIRECTIONS.tolist():
            n_neighbours += np.roll(self.heights >= level, (dx, dy), (0, 1))
        n_neighbours[~places] = -1
        if rng.random() < compact:
            places &= n_neighbours == n_neighbours.max()
        elif n_neighbours.max() > 0 and (level > 1 or rng.random() > _SPREAD):
            places &= n_neighbours > 0
        for x, y in rng.permutation(np.argwhere(places)).tolist():
            self.heights[x, y] += 1
            if level > 1 or self._floor_is_whole():
                self.steps.append(Piece(Kind.BLOCK, (x, y, level)))
                return True
            self.heights[x, y] -= 1
        return False

    def cap_landing(self, level: int, rng: np.random.Generator) -> bool:
        """Put a block onto a landing, which ends its ramp's use for loads; return whether there was one for it."""
        reached = self._reach(level)
        reserved = set()
        for ramp in self.ramps:
            for column in _columns(ramp, 0, 1, 2):
                reserved.add(column)
        landings = set()
        for ramp in self.ramps:
            landing = _column(ramp, -1)
            if ramp.cell[2] == level - 1 and landing not in reserved and reached[landing]:
                landings.add(landing)
        if not landings:
            return False
        x, y = sorted(landings)[rng.integers(len(landings))]
        self.heights[x, y] += 1
        self.steps.append(Piece(Kind.BLOCK, (x, y, level)))
        return True

    def add_ramp(self, level: int, rng: np.random.Generator, for_slopes: bool = False) -> bool:
        """Unfold a slope from a level to the next at random; return whether there was a place for it.

        ``for_slopes`` leaves room for slopes to be carried up.
        """
        landings = np.argwhere(self.heights >= level)
        slopes = self.from_floor(Kind.FSLOPE)
        for i in rng.permutation(4 * len(landings)).tolist():
            x, y = landings[i // 4].tolist()
            yaw = i % 4
            ramp = Piece(Kind.BODY, beside((x, y, level), yaw), yaw)
            # The gear of a slope that is carried up is there when the car comes to the foot.
            lane = (*_column(ramp, 3), level)
            if self._has_room(ramp, slopes) and (not for_slopes or self._is_air(lane)):
                self.ramps.append(ramp)
                if self._can_leave(ramp):
                    self.steps.append(ramp)
                    if for_slopes:
                        self.lanes |= {lane}
                    return True
                self.ramps.pop()
        return False

    def approaches(self, rng: np.random.Generator) -> set[FloorColumn]:
        """Return columns of the floor to be kept free: beside each block of the floor is one to bring it from."""
        final = self.heights > 0
        built = set[FloorColumn]()
        approaches = set[FloorColumn]()
        for step in self.steps:
            if step.kind == Kind.BODY or step.cell[2] > 1:
                continue
            built.add(step.cell[:2])
            free = []
            is_reached = False
            for yaw in range(4):
                column = beside(step.cell, yaw)[:2]
                if column in built:
                    continue
                free.append(column)
                # Those that are built on later are free of things anyway.
                if final[column] or column in approaches:
                    is_reached = True
            if not is_reached:
                approaches.add(free[rng.integers(len(free))])
        return approaches

    def _solid(self, level: int) -> FloorMask:
        solid = np.zeros(self.heights.shape, np.bool_)
        for ramp in self.ramps:
            if ramp.cell[2] == level:
                solid[tuple(zip(*_columns(ramp, 0, 1), strict=True))] = True
        return solid

    def _free_floor(self) -> FloorMask:
        free: FloorMask = (self.heights == 0) & ~self._solid(1)
        return free

    def _floor_is_whole(self) -> bool:
        return label_pieces(self._free_floor())[1] == 1

    def _reach(self, level: int) -> FloorMask:
        """Return (L, W): where a car with a block can stand on a level."""
        reached: FloorMask = np.any(self.from_floor(Kind.BLOCK)[:, :, level], axis=-1)
        return reached

    def _places(self, level: int) -> FloorMask:
        """Return (L, W): the columns that can take a block, and that no ramp needs."""
        # On the floor a car with a block gets to all that is free, and to ramps, which are left out below.
        if level == 1:
            places = self._free_floor()
        else:
            places = self._reach(level) & (self.heights == level - 1)
        for ramp in self.ramps:
            # The block behind a body is landed on, so that it bears none but the last of its level.
            places[tuple(zip(*_columns(ramp, 0, 1, 2, -1), strict=True))] = False
        for x, y, z in self.lanes:
            places[x, y] &= level < z
        if level == 1:
            places &= self.site
        return places

    def _has_room(self, ramp: Piece, slopes: NDArray[np.bool_]) -> bool:
        """Return whether a car can bring a slope there, and no other ramp is in its way or mistaken for it."""
        level = ramp.cell[2]
        body, foot, before = _columns(ramp, 0, 1, 2)
        # A gear needs no floor, but a foot, and a car before it, do.
        for column in (body, foot, before):
            if not self._is_air((*column, level)) or self.heights[column] != level - 1:
                return False
        if not slopes[(*ramp.cell, ramp.yaws[0])] or not self.lanes.isdisjoint(ramp.cells):
            return False
        for other_ramp in self.ramps:
            other_body, other_foot = _columns(other_ramp, 0, 1)
            # A slope is not unfolded onto a landing, and no block or ramp blocks the way to another.
            if {body, foot} & {*_columns(other_ramp, 0, 1, 2, -1)} or before in (
                other_body,
                other_foot,
            ):
                return False
            # A goal file tells a slope's yaw by the foot beside its body.
            if other_ramp.cell[2] == level and (
                _touch(body, other_foot) or _touch(foot, other_body)
            ):
                return False
        return True

    def _is_air(self, cell: Cell) -> bool:
        x, y, z = cell
        length, width = self.heights.shape
        inside = 0 <= x < length and 0 <= y < width
        return bool(inside and self.heights[x, y] < z and not self._solid(z)[x, y])

    def _can_leave(self, ramp: Piece) -> bool:
        """Return whether the floor stays in one piece, and the car under the landing gets to where loads come by."""
        level = ramp.cell[2]
        if level == 1 and not self._floor_is_whole():
            return False
        pieces, _ = label_pieces((self.heights >= level - 1) & ~self._solid(level))
        return bool(np.any((pieces == pieces[_column(ramp, -1)]) & self._reach(level)))


def _column(ramp: Piece, steps: int) -> FloorColumn:
    """Return the column so many steps downhill of a ramp's body: 1 foot, 2 where a car comes from, -1 the landing."""
    dx, dy = DIRECTIONS[ramp.yaw].tolist()
    return ramp.cell[0] + steps * dx, ramp.cell[1] + steps * dy


def _columns(ramp: Piece, *steps: int) -> list[FloorColumn]:
    return [_column(ramp, distance) for distance in steps]


def _touch(first: FloorColumn, second: FloorColumn) -> bool:
    return abs(first[0] - second[0]) + abs(first[1] - second[1]) == 1
