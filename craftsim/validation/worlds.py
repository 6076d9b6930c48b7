"""Random legal worlds: terraces, stacks, ramps at every level, flags, walls, and cars wherever a car can be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, Piece, beside
from craftsim.discrete.rules import has_room
from craftsim.errors import BlueprintError, CraftsimError, InputError
from craftsim.tasks import Task, free_play

MAX_RANDOM_CARS: Final = 12
LENGTHS: Final = (4, 12)
HEIGHTS: Final = (1, 5)
_MAX_BLOCKS: Final = 40
"""Limit for the speed of the physics."""
_TRIES: Final = 200
_LEVELLING: Final = 8
_PATCH: Final = 4
_LOADS: Final = (Kind.BLOCK, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE, Kind.FSLOPE)


@dataclass(frozen=True)
class RandomWorlds:
    """A family of worlds, one drawn for every seed. Raises InputError for figures that do not fit.

    Areas measure 4 x 4 to 12 x 12 cells, small ones more often, with 1 to 5 levels; up to 12 cars, at most one for
    three columns. Walls stand on the floor and on stacks, and hang.
    """

    n_cars: int | None = None
    """Drawn unless given."""
    n_blocks: int | None = None
    """Approximate number of blocks in stacks; drawn unless given."""
    max_steps: int = 14
    """An episode has two ticks more (docs/rules.md#episode-length)."""

    def __post_init__(self) -> None:
        if self.n_cars is not None and not 1 <= self.n_cars <= MAX_RANDOM_CARS:
            raise InputError(
                f"{self.n_cars} cars in a random world; allowed: 1 to {MAX_RANDOM_CARS} cars"
            )
        if self.n_blocks is not None and not 0 <= self.n_blocks <= _MAX_BLOCKS:
            raise InputError(
                f"{self.n_blocks} blocks in a random world; allowed: 0 to {_MAX_BLOCKS}"
            )
        if self.max_steps < 1:
            raise InputError(f"max_steps is {self.max_steps}; allowed: 1 or more")

    def task(self, rng: np.random.Generator) -> Task:
        """Return a task without a goal that always starts in the world that a generator draws."""
        return free_play(
            "random", (parse_blueprint(blueprint_text(self.grid(rng)), "random"),), self.max_steps
        )

    def grid(self, rng: np.random.Generator) -> Grid:
        """Return the world that a generator draws: one that a blueprint may hold, with as many cars as asked for."""
        for _ in range(_TRIES):
            grid = _Drawing(self, rng).grid
            if self.n_cars not in (None, grid.n_cars) or not grid.n_cars:
                continue
            try:
                parse_blueprint(blueprint_text(grid), "random")
            except BlueprintError:
                continue
            return grid
        raise CraftsimError(
            f"no random world with {self} was found in {_TRIES} tries; ask for fewer cars"
        )


class _Drawing:
    """The drawing of one world."""

    def __init__(self, family: RandomWorlds, rng: np.random.Generator) -> None:
        self.rng = rng
        length, width = (int(rng.integers(LENGTHS[0], LENGTHS[1] + 1, 2).min()) for _ in range(2))
        height = int(rng.integers(HEIGHTS[0], HEIGHTS[1] + 1))
        n_cars = 1 + int(rng.integers(min(MAX_RANDOM_CARS, length * width // 3)))
        if family.n_cars is not None:
            n_cars = family.n_cars
        self.grid = Grid.empty((length, width, height), n_cars)
        self.tops = np.zeros((length, width), np.int64)
        self.taken: set[tuple[int, int]] = set()
        n_blocks = int(rng.integers(min(length * width, _MAX_BLOCKS) + 1))
        if family.n_blocks is not None:
            n_blocks = family.n_blocks
        self._terraces(n_blocks)
        for limit, draw in (
            (5, self._slope),
            (3, self._flag),
            (3, self._wall),
            (3, self._hang_wall),
        ):
            for _ in range(int(rng.integers(limit))):
                draw()
        self._cars(n_cars)
        self.grid.derive_marks()

    def _column(self) -> tuple[int, int]:
        length, width, _ = self.grid.size
        return int(self.rng.integers(length)), int(self.rng.integers(width))

    def _stack(self, x: int, y: int, n: int) -> None:
        for level in range(int(self.tops[x, y]) + 1, n + 1):
            self.grid.put(Piece(Kind.BLOCK, (x, y, level)))
        self.tops[x, y] = n

    def _terraces(self, budget: int) -> None:
        for _ in range(_TRIES):
            if budget <= 0:
                return
            (x, y), top = self._column(), 1 + int(self.rng.integers(self.grid.size[2]))
            along, across = (int(n) for n in self.rng.integers(1, _PATCH, 2))
            for cell in np.argwhere(self.tops[x : x + along, y : y + across] < top).tolist():
                cx = x + cell[0]
                cy = y + cell[1]
                n_blocks = min(top - int(self.tops[cx, cy]), budget)
                self._stack(cx, cy, int(self.tops[cx, cy]) + n_blocks)
                budget -= n_blocks

    def _slope(self) -> None:
        """Put down a slope on ground made level for it, mostly with a landing and with room before its foot."""
        for _ in range(_TRIES):
            columns = [self._column() for _ in range(2)]
            yaw = int(self.rng.integers(4))
            x, y = max(columns, key=lambda column: int(self.tops[column]))
            dx, dy = (int(d) for d in DIRECTIONS[yaw])
            rooms = self.rng.random(2) < (0.85, 0.9)
            line = [(x, y), (x + dx, y + dy)]
            if rooms[0]:
                line.append((x + 2 * dx, y + 2 * dy))
            back = []
            if rooms[1]:
                back = [(x - dx, y - dy)]
            if not all(self._open(column) for column in (*line, *back)):
                continue
            floor = max(int(self.tops[column]) for column in line)
            heights = {**dict.fromkeys(line, floor), **dict.fromkeys(back, floor + 1)}
            if (
                any(self.tops[column] > n for column, n in heights.items())
                or floor >= self.grid.size[2]
            ):
                continue
            if sum(n - int(self.tops[column]) for column, n in heights.items()) > _LEVELLING:
                continue
            for column, n in heights.items():
                self._stack(*column, n)
            if self.rng.random() < 0.35:
                kind = Kind.FSLOPE
            else:
                kind = Kind.BODY
            self.grid.put(Piece(kind, (x, y, floor + 1), yaw))
            self.taken.update(line[:2])
            return

    def _open(self, column: tuple[int, int]) -> bool:
        """Return whether a column is on the map, with nothing on its blocks."""
        length, width, _ = self.grid.size
        return 0 <= column[0] < length and 0 <= column[1] < width and column not in self.taken

    def _flag(self) -> None:
        self._stand(Kind.FLAG)

    def _wall(self) -> None:
        self._stand(Kind.WALL)

    def _stand(self, kind: Kind) -> None:
        x, y = self._column()
        level = int(self.tops[x, y]) + 1
        if self._open((x, y)) and level <= self.grid.size[2]:
            self.grid.put(Piece(kind, (x, y, level)))
            self.taken.add((x, y))

    def _hang_wall(self) -> None:
        """Hang a wall anywhere in the air; what is below it may be anything."""
        x, y = self._column()
        height = self.grid.size[2]
        cell = (x, y, 1 + int(self.rng.integers(height)))
        if self.grid.kind[cell] == Kind.AIR:
            self.grid.put(Piece(Kind.WALL, cell))
            if cell[2] == self.tops[x, y] + 1:
                self.taken.add((x, y))

    def _cars(self, n_cars: int) -> None:
        """Put all cars down, one after the other, and let some carry something."""
        names = list(_PLACES)
        shares = [share for share, _ in _PLACES.values()]
        drawn_places = [names[i] for i in self.rng.choice(len(names), _TRIES, p=shares).tolist()]
        # Those on ramps come first, while their ways are free.
        candidates = (
            sorted(drawn_places[:n_cars], key=lambda place: "a ramp" in place, reverse=True)
            + drawn_places[n_cars:]
        )
        places: list[str] = []
        for place in candidates:
            if len(places) < n_cars and _put_car(self.grid, len(places), place, self.rng):
                places.append(place)
        self.grid.cars = self.grid.cars[: len(places)].copy()
        for car, place in enumerate(places):
            _put_load(self.grid, car, _PLACES[place][1], self.rng)


_PLACES: Final = {
    "on top": (0.2, 0.4),
    "under": (0.15, 0.0),
    "under a slope": (0.1, 0.0),
    "on a ramp": (0.2, 0.5),
    "before a ramp": (0.35, 0.5),
}
"""Kinds of places where a car starts, with the probabilities that it starts there and that it carries something there.

On top: on the ground or on a stack, the highest included, where it is above the top level; under: under a block or a
flag, in a stack or not; under a slope, folded or not; on the foot or over the body of a ramp, up or down; before the
foot or on the landing of a ramp, about to drive it.
"""


def _put_car(grid: Grid, car: int, place: str, rng: np.random.Generator) -> bool:
    """Put a car into a drawn cell of a kind of places, after those with lower numbers; return whether there is one."""
    occupied = {tuple(row[: CarField.Z + 1]) for row in grid.cars[:car].tolist()}
    columns = {cell[:2] for cell in occupied}
    free = []
    for start in _cells(grid, place):
        cell, _, _, ramp_columns = start
        if cell not in occupied and not ramp_columns & columns:
            free.append(start)
    if not free:
        return False
    cell, yaws, slope, _ = free[int(rng.integers(len(free)))]
    grid.cars[car] = (*cell, yaws[int(rng.integers(len(yaws)))], Kind.AIR, 0, slope)
    return True


def _put_load(grid: Grid, car: int, share: float, rng: np.random.Generator) -> None:
    """Let a car carry something with a probability, if there is room for it."""
    row = grid.cars[car]
    chance = rng.random()
    load = _LOADS[int(rng.integers(len(_LOADS)))]
    cell = (int(row[CarField.X]), int(row[CarField.Y]), int(row[CarField.Z]))
    if chance >= share or grid.kind_at(cell) not in (Kind.AIR, Kind.FOOT):
        return
    back = (int(row[CarField.YAW]) + 2) % 4
    row[CarField.LOAD] = load
    row[CarField.LOAD_YAW] = 0
    if load == Kind.FSLOPE:
        row[CarField.LOAD_YAW] = back
    if not has_room(grid):
        row[CarField.LOAD] = Kind.AIR
        row[CarField.LOAD_YAW] = 0


_Start = tuple[Cell, tuple[int, ...], int, frozenset[tuple[int, int]]]
"""A cell, the headings that a car can have there, and the half of a slope that it is on, as in :class:`CarField`; and
the columns of a ramp, end and landing included, where no other car may be: it would block the way."""
_ANY: Final = (0, 1, 2, 3)


def _cells(grid: Grid, place: str) -> list[_Start]:
    """Return the cells of a kind of places."""
    starts: list[_Start] = []
    length, width, height = grid.size
    for x, y, z in np.ndindex(length, width, height + 1):
        cell = (x, y, z + 1)
        kind = grid.kind_at(cell)
        below = grid.kind_at((x, y, z))
        along = 0
        if z < height:
            along = int(grid.yaw[cell])
        on_top = place == "on top" and kind == Kind.AIR and below in (Kind.GROUND, Kind.BLOCK)
        if on_top or (place == "under" and kind in (Kind.BLOCK, Kind.FLAG)):
            starts.append((cell, _ANY, 0, frozenset()))
        elif place == "under a slope" and kind in (Kind.FSLOPE, Kind.BODY):
            starts.append((cell, ((along + 2) % 4,), 0, frozenset()))
        elif "a ramp" in place and kind == Kind.BODY:
            foot = beside(cell, along)
            up = (along + 2) % 4
            above = (x, y, z + 2)
            columns = frozenset(
                ramp_cell[:2] for ramp_cell in (beside(cell, up), cell, foot, beside(foot, along))
            )
            if place == "on a ramp":
                starts.append((foot, (along, up), 1, columns))
                if grid.kind_at(above) == Kind.AIR:
                    starts.append((above, (along, up), 2, columns))
                continue
            ends = ((beside(foot, along), up), (beside(above, up), along))
            starts += [(end, (yaw,), 0, columns) for end, yaw in ends if _free(grid, end)]
    return starts


def _free(grid: Grid, cell: Cell) -> bool:
    """Return whether a cell is on the map, with something to stand on and nothing in it."""
    x, y, z = cell
    length, width, height = grid.size
    if (
        not (0 <= x < length and 0 <= y < width and z <= height + 1)
        or grid.kind_at(cell) != Kind.AIR
    ):
        return False
    return grid.kind_at((x, y, z - 1)) in (Kind.GROUND, Kind.BLOCK)
