"""Buildings that grow at random, block by block and ramp by ramp, each step one that a car could make just then.

A building is a map of heights, since nothing floats, and ramps. What a loaded car can reach is told level by level: it
goes between columns of the same height, and up a ramp from the column before its foot to the block behind its body. It
is on the floor that it begins, and the floor that stays free is in one piece all the time. An unloaded car also drives
under blocks, so that who has set down a block, or unfolded a slope, gets away below what stands there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.designs.spreading import Column
from craftsim.discrete.geometry import DIRECTIONS
from craftsim.discrete.grid import Cell

Mask = NDArray[np.bool_]
"""(L, W)."""


class Ramp(NamedTuple):
    """An unfolded slope: the cell of its body, and its yaw, downhill."""

    body: Cell
    yaw: int

    def column(self, steps: int) -> Column:
        """Return the column so many steps downhill of the body: 1 foot, 2 where a car comes from, -1 the landing."""
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


_SPREAD: Final = 0.15
"""How often a block of the floor begins a piece of its own."""


@dataclass
class Growth:
    """A building in the making."""

    heights: NDArray[np.int64]
    """(L, W): blocks in each column."""
    ramps: list[Ramp] = field(default_factory=list)
    steps: list[Cell | Ramp] = field(default_factory=list)
    """The blocks and ramps in the order in which they were put there."""

    @classmethod
    def on(cls, length: int, width: int) -> Growth:
        """Begin with a bare floor."""
        return cls(np.zeros((length, width), np.int64))

    def busy(self) -> Mask:
        """Return (L, W): the columns that end in a ramp's body or foot."""
        found = np.zeros(self.heights.shape, np.bool_)
        for ramp in self.ramps:
            found[ramp.column(0)] = found[ramp.column(1)] = True
        return found

    def reach(self, level: int) -> Mask:
        """Return (L, W): where a loaded car can stand on a level."""
        busy = self.busy()
        reached: Mask = (self.heights == 0) & ~busy
        for z in range(2, level + 1):
            pieces, _ = pieces_of((self.heights == z - 1) & ~busy)
            landings = [r.column(-1) for r in self.ramps if r.body[2] == z - 1 and reached[r.column(2)]]
            reached = np.isin(pieces, [pieces[column] for column in landings if pieces[column]])
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

    def _places(self, level: int) -> Mask:
        """Return (L, W): the columns that can take a block, none of which a ramp needs or borders of the area."""
        places = self.reach(level) & (self.heights == level - 1)
        for ramp in self.ramps:
            # The block behind a body is landed on, so that it bears none but the last of its level.
            for column in (*ramp.columns, ramp.column(-1)):
                places[column] = False
        if level == 1:
            places[[0, -1]] = places[:, [0, -1]] = False
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

    def add_ramp(self, level: int, rng: np.random.Generator) -> bool:
        """Unfold a slope from a level to the next at random; return whether there was a place for it."""
        landings = np.argwhere(self.heights >= level)
        ways = [(x, y, yaw) for x, y in landings.tolist() for yaw in range(4)]
        for i in rng.permutation(len(ways)).tolist():
            x, y, yaw = ways[i]
            dx, dy = DIRECTIONS[yaw].tolist()
            ramp = Ramp((x + dx, y + dy, level), yaw)
            if self._has_room(ramp):
                self.ramps.append(ramp)
                if self._can_leave(ramp):
                    self.steps.append(ramp)
                    return True
                self.ramps.pop()
        return False

    def _has_room(self, ramp: Ramp) -> bool:
        """Return whether a car can bring a slope there, and no other ramp is in its way or mistaken for it."""
        level, reached = ramp.body[2], self.reach(ramp.body[2])
        if not all(0 <= c < n for column in ramp.columns for c, n in zip(column, reached.shape, strict=True)):
            return False
        if not all(reached[column] for column in ramp.columns):
            return False
        for other in self.ramps:
            # A slope is not unfolded onto a landing, and no block or ramp blocks the way to another.
            if {*ramp.columns[:2]} & {*other.columns, other.column(-1)} or ramp.column(2) in other.columns[:2]:
                return False
            # A goal file tells a slope's yaw by the foot beside its body.
            if other.body[2] == level and (
                _beside(ramp.column(0), other.column(1)) or _beside(ramp.column(1), other.column(0))
            ):
                return False
        return True

    def _can_leave(self, ramp: Ramp) -> bool:
        """Return whether the floor stays in one piece, and the car under the landing gets to where loads come by."""
        level = ramp.body[2]
        if level == 1 and not self._floor_is_whole():
            return False
        pieces, _ = pieces_of((self.heights >= level - 1) & ~(self.busy() & (self.heights == level - 1)))
        here = pieces[ramp.column(-1)]
        return bool(np.any((pieces == here) & self.reach(level)))

    def _floor_is_whole(self) -> bool:
        return pieces_of((self.heights == 0) & ~self.busy())[1] == 1


def _beside(one: Column, other: Column) -> bool:
    return abs(one[0] - other[0]) + abs(one[1] - other[1]) == 1
