"""Buildings that grow at random, block by block and ramp by ramp, each step one that a car could make just then.

A building is a map of heights, since nothing floats, and ramps. Loads come from the floor, and the floor that stays
free is in one piece all the time. An unloaded car also drives under blocks, so that who has set down a block, or
unfolded a slope, gets away below what stands there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.designs.spreading import Column
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import Cell, Grid, Kind
from craftsim.discrete.move_graph import UNREACHABLE, MoveGraph
from craftsim.discrete.rules import Rules

Mask = NDArray[np.bool_]
"""(L, W)."""


MAX_LEVELS: Final = 3
"""Of a building."""


class Ramp(NamedTuple):
    """An unfolded slope: the cell of its body, and its yaw, downhill."""

    body: Cell
    yaw: int

    def column(self, steps: int) -> Column:
        """Return the column so many steps downhill of the body: 1 foot, 2 where a car comes from, 3 where the gear of a
        slope that it carries is then; -1 the landing."""
        dx, dy = DIRECTIONS[self.yaw].tolist()
        return self.body[0] + steps * dx, self.body[1] + steps * dy

    @property
    def columns(self) -> tuple[Column, Column, Column]:
        """Body, foot and the column before the foot."""
        return self.column(0), self.column(1), self.column(2)


def pieces_of(mask: Mask) -> tuple[NDArray[np.int32], int]:
    """Return (L, W): the number, from 1, of the piece that a cell is in, and how many pieces there are."""
    from scipy.ndimage import label

    found: tuple[NDArray[np.int32], int] = label(mask)
    return found


PHYSICAL: Final = Rules("physical")
_SPREAD: Final = 0.15
"""How often a block of the floor begins a piece of its own."""


@dataclass
class Growth:
    """A building in the making."""

    heights: NDArray[np.int64]
    """(L, W): blocks in each column."""
    site: Mask
    """(L, W): where blocks are put on the floor."""
    ramps: list[Ramp] = field(default_factory=list)
    steps: list[Cell | Ramp] = field(default_factory=list)
    """The blocks and ramps in the order in which they were put there."""
    lanes: set[Cell] = field(default_factory=set)
    """Cells that stay free, since gears of carried slopes pass there."""

    @classmethod
    def on(cls, length: int, width: int, rng: np.random.Generator) -> Growth:
        """Begin with a bare floor; a border of it, and a strip on one side, stay so."""
        site = np.zeros((length, width), np.bool_)
        begin, end = [1, 1], [length - 1, width - 1]
        axis, strip = int(rng.integers(2)), 1 + min(2, min(length, width) - 5)
        if rng.random() < 0.5:
            begin[axis] = strip
        else:
            end[axis] -= strip - 1
        site[begin[0] : end[0], begin[1] : end[1]] = True
        return cls(np.zeros((length, width), np.int64), site)

    def solid(self) -> NDArray[np.bool_]:
        """Return (MAX_LEVELS + 2, L, W): the cells of bodies and feet by level."""
        found = np.zeros((MAX_LEVELS + 2, *self.heights.shape), np.bool_)
        for ramp in self.ramps:
            for x, y in ramp.columns[:2]:
                found[ramp.body[2], x, y] = True
        return found

    def world(self, obstacles: Mask | None = None) -> Grid:
        """Return the building in an area of its own; ``obstacles`` (L, W) stand on the floor and bear nothing."""
        grid = Grid.empty((*self.heights.shape, MAX_LEVELS))
        grid.kind[:, :, 1:][self.heights[:, :, None] >= np.arange(1, MAX_LEVELS + 1)] = Kind.BLOCK
        for ramp in self.ramps:
            foot = (*ramp.column(1), ramp.body[2])
            grid.kind[ramp.body], grid.kind[foot] = Kind.BODY, Kind.FOOT
            grid.yaw[ramp.body] = grid.yaw[foot] = ramp.yaw
        if obstacles is not None:
            grid.kind[:, :, 1][obstacles] = Kind.WALL
        return grid

    def from_floor(self, load: Kind) -> NDArray[np.bool_]:
        """Return (L, W, MAX_LEVELS + 2, 4): the cells and headings to which a load comes from the free floor."""
        graph = MoveGraph(self.world(), PHYSICAL, load)
        distances = graph.distances_from(graph.floor_nodes(self.free_floor()))
        reached: NDArray[np.bool_] = np.less(distances, UNREACHABLE).reshape(graph.numbers.shape)
        return reached

    def free_floor(self) -> Mask:
        """Return (L, W): the columns with neither a block nor a part of a ramp."""
        free: Mask = (self.heights == 0) & ~self.solid()[1]
        return free

    def reach(self, level: int) -> Mask:
        """Return (L, W): where a car with a block can stand on a level."""
        reached: Mask = np.any(self.from_floor(Kind.BLOCK)[:, :, level], axis=-1)
        return reached

    def add_block(self, level: int, rng: np.random.Generator, compact: float) -> bool:
        """Put a block on a level at random; return whether there was a place for it.

        ``compact`` is how often it goes where most blocks are beside it; else it goes beside any, or of the floor's now
        and then somewhere else.
        """
        places, near = self._places(level), np.zeros(self.heights.shape, np.int64)
        for dx, dy in DIRECTIONS.tolist():
            near += np.roll(self.heights >= level, (dx, dy), (0, 1))
        near[~places] = -1
        if rng.random() < compact:
            places &= near == near.max()
        elif near.max() > 0 and (level > 1 or rng.random() > _SPREAD):
            places &= near > 0
        for x, y in rng.permutation(np.argwhere(places)).tolist():
            self.heights[x, y] += 1
            if level > 1 or self._floor_is_whole():
                self.steps.append((x, y, level))
                return True
            self.heights[x, y] -= 1
        return False

    def approaches(self, rng: np.random.Generator) -> set[Column]:
        """Return columns of the floor to be kept free: beside each block of the floor is one to bring it from."""
        final, built, found = self.heights > 0, np.zeros(self.heights.shape, np.bool_), set[Column]()
        for x, y, z in (step for step in self.steps if not isinstance(step, Ramp)):
            built[x, y] = True
            if z > 1:
                continue
            beside = [(x + dx, y + dy) for dx, dy in DIRECTIONS.tolist()]
            free = [column for column in beside if not built[column]]
            # Those that are built on later are free of things anyway.
            if not any(final[column] or column in found for column in free):
                found.add(free[rng.integers(len(free))])
        return found

    def _places(self, level: int) -> Mask:
        """Return (L, W): the columns that can take a block, and that no ramp needs."""
        places = self.reach(level) & (self.heights == level - 1)
        for ramp in self.ramps:
            # The block behind a body is landed on, so that it bears none but the last of its level.
            for column in (*ramp.columns, ramp.column(-1)):
                places[column] = False
        for x, y, z in self.lanes:
            places[x, y] &= level < z
        if level == 1:
            places &= self.site
        return places

    def cap_landing(self, level: int, rng: np.random.Generator) -> bool:
        """Put a block onto a landing, which ends its ramp's use for loads; return whether there was one for it."""
        reached, needed = self.reach(level), {column for ramp in self.ramps for column in ramp.columns}
        landings = {ramp.column(-1) for ramp in self.ramps if ramp.body[2] == level - 1}
        free = sorted(column for column in landings - needed if reached[column])
        if not free:
            return False
        x, y = free[rng.integers(len(free))]
        self.heights[x, y] += 1
        self.steps.append((x, y, level))
        return True

    def add_ramp(self, level: int, rng: np.random.Generator, for_slopes: bool = False) -> bool:
        """Unfold a slope from a level to the next at random; return whether there was a place for it.

        ``for_slopes`` leaves room for slopes to be carried up.
        """
        landings, slopes = np.argwhere(self.heights >= level), self.from_floor(Kind.FSLOPE)
        ways = [(x, y, yaw) for x, y in landings.tolist() for yaw in range(4)]
        for i in rng.permutation(len(ways)).tolist():
            x, y, yaw = ways[i]
            dx, dy = DIRECTIONS[yaw].tolist()
            ramp = Ramp((x + dx, y + dy, level), yaw)
            lane = (*ramp.column(3), level)
            if self._has_room(ramp, slopes) and (not for_slopes or self._is_air(lane)):
                self.ramps.append(ramp)
                if self._can_leave(ramp):
                    self.steps.append(ramp)
                    self.lanes |= {lane} if for_slopes else set()
                    return True
                self.ramps.pop()
        return False

    def _has_room(self, ramp: Ramp, slopes: NDArray[np.bool_]) -> bool:
        """Return whether a car can bring a slope there, and no other ramp is in its way or mistaken for it."""
        level = ramp.body[2]
        for column in ramp.columns:
            # A gear needs no floor, but a foot, and a car before it, do.
            if not self._is_air((*column, level)) or self.heights[column] != level - 1:
                return False
        if not slopes[(*ramp.body, (ramp.yaw + 2) % 4)]:
            return False
        if self.lanes & {(*column, level) for column in ramp.columns[:2]}:
            return False
        for other in self.ramps:
            # A slope is not unfolded onto a landing, and no block or ramp blocks the way to another.
            if {*ramp.columns[:2]} & {*other.columns, other.column(-1)} or ramp.column(2) in other.columns[
                :2
            ]:
                return False
            # A goal file tells a slope's yaw by the foot beside its body.
            if other.body[2] == level and (
                _beside(ramp.column(0), other.column(1)) or _beside(ramp.column(1), other.column(0))
            ):
                return False
        return True

    def _is_air(self, cell: Cell) -> bool:
        """Return whether a cell is in the area, and nothing in it."""
        x, y, z = cell
        if not all(0 <= c < n for c, n in zip((x, y), self.heights.shape, strict=True)):
            return False
        return bool(self.heights[x, y] < z and not self.solid()[z, x, y])

    def _can_leave(self, ramp: Ramp) -> bool:
        """Return whether the floor stays in one piece, and the car under the landing gets to where loads come by."""
        level = ramp.body[2]
        if level == 1 and not self._floor_is_whole():
            return False
        pieces, _ = pieces_of((self.heights >= level - 1) & ~self.solid()[level])
        here = pieces[ramp.column(-1)]
        return bool(np.any((pieces == here) & self.reach(level)))

    def _floor_is_whole(self) -> bool:
        return pieces_of(self.free_floor())[1] == 1


def _beside(one: Column, other: Column) -> bool:
    return abs(one[0] - other[0]) + abs(one[1] - other[1]) == 1
