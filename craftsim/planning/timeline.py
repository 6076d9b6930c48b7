"""What every car does in every tick, and the world before each: the plan as it grows, held to the rules throughout."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.rules import act
from craftsim.discrete.kernel.state import DERIVED_MARKS, World, derive_marks
from craftsim.discrete.kinds import Action, Kind
from craftsim.discrete.rules import Rules

NOTHING_DONE: Final = -1
_LEFT_OUT: Final = (-9, -9, -9, 0, Kind.AIR, 0, 0)
"""A car that is left out, fields as CarField: far from all cells, so that no rule sees it."""
_FIRST_TICKS: Final = 64


class Snapshots:
    """The worlds before tick 0, 1, 2, ...; those of a plan that grows."""

    def __init__(self, grid: Grid, rules: Rules) -> None:
        self._corrections = rules.corrections
        self._grids = Grid.stack([grid] * _FIRST_TICKS)

    @property
    def stack(self) -> World:
        """All of them; arrays have a leading dimension over ticks."""
        return self._grids.world(self._corrections)

    def reserve(self, n_ticks: int) -> None:
        """Make room for the world before a tick."""
        while len(self._grids) <= n_ticks:
            cells, cars = self._grids.cells, self._grids.cars
            self._grids = Grid(np.concatenate([cells, cells]), np.concatenate([cars, cars]))

    def copy_from(self, other: Snapshots, tick: int) -> None:
        """Take over the world before a tick."""
        self._grids.cells[tick], self._grids.cars[tick] = other._grids.cells[tick], other._grids.cars[tick]

    def grid(self, tick: int) -> Grid:
        """Return the world before a tick."""
        return self._grids[tick].copy()


class Timeline:
    """The actions of all cars by tick, (T, n), and the worlds that follow from them by the rules."""

    def __init__(self, grid: Grid, rules: Rules) -> None:
        self.n_cars = grid.n_cars
        self.actions = np.full((_FIRST_TICKS, grid.n_cars), NOTHING_DONE, np.int8)
        self.worlds = Snapshots(grid, rules)
        self._others = Snapshots(grid, rules)
        self.end = 0
        """The first tick in which nothing is done any more."""

    def reserve(self, n_ticks: int) -> None:
        """Make room for actions in the ticks before this one."""
        while len(self.actions) <= n_ticks:
            self.actions = np.concatenate([self.actions, np.full_like(self.actions, NOTHING_DONE)])
        self.worlds.reserve(n_ticks + 1)
        self._others.reserve(n_ticks + 1)

    def shorten(self) -> None:
        """Set the end anew after actions were taken out."""
        acting = np.flatnonzero((self.actions != NOTHING_DONE).any(1))
        self.end = int(acting[-1]) + 1 if len(acting) else 0

    def write(self, car: int, tick: int, actions: list[int]) -> None:
        """Let a car do these actions from a tick on, and nothing after them."""
        self.reserve(max(self.end, tick + len(actions)))
        self.actions[tick:, car] = NOTHING_DONE
        self.actions[tick : tick + len(actions), car] = actions
        self.end = max(self.end, tick + len(actions))
        self.shorten()

    def replay(self, tick: int) -> tuple[int, int] | None:
        """Work out the worlds after a tick; return the first (tick, car) whose action is forbidden, or None."""
        bad = int(_replay(self.worlds.stack, self.actions, tick, self.end, -1))
        return None if bad < 0 else divmod(bad, self.n_cars)

    def without(self, car: int, tick: int) -> World:
        """Return the worlds as they are from a tick on if a car does not exist any more; valid until the next call."""
        self._others.copy_from(self.worlds, tick)
        stack = self._others.stack
        stack.cars[tick, car] = _LEFT_OUT
        _replay(stack, self.actions, tick, self.end, car)
        return stack

    def trim(self, reached: Callable[[Grid], bool]) -> None:
        """Take the last actions of each car away as long as a goal is reached without them."""
        for car in range(self.n_cars):
            for tick in np.flatnonzero(self.actions[:, car] != NOTHING_DONE)[::-1].tolist():
                action = self.actions[tick, car]
                self.actions[tick, car] = NOTHING_DONE
                if self.replay(tick) is None and reached(self.worlds.grid(self.end)):
                    continue
                self.actions[tick, car] = action
                self.replay(tick)
                break
        self.shorten()

    def ticks(self) -> tuple[tuple[tuple[int, Action], ...], ...]:
        """Return the plan: for each tick the (car, action) pairs in acting order."""
        return tuple(
            tuple((car, Action(action)) for car, action in enumerate(joint) if action != NOTHING_DONE)
            for joint in self.actions[: self.end].tolist()
        )


@compiled
def _replay(worlds: World, actions: NDArray[np.int8], first: int, end: int, left_out: int) -> int:
    """Write the worlds after each tick; return tick * n + car of the first action that is forbidden, or -1.

    A car that is left out does nothing; -1 for none.
    """
    _, length, width, layers, cell_fields = worlds.cells.shape
    _, n_cars, car_fields = worlds.cars.shape
    bad = -1
    for tick in range(first, end):
        for x in range(length):
            for y in range(width):
                for z in range(layers):
                    for field in range(cell_fields):
                        worlds.cells[tick + 1, x, y, z, field] = worlds.cells[tick, x, y, z, field]
        for car in range(n_cars):
            for field in range(car_fields):
                worlds.cars[tick + 1, car, field] = worlds.cars[tick, car, field]
        w = World(worlds.cells[tick + 1], worlds.cars[tick + 1], worlds.corrections)
        for car in range(n_cars):
            if car == left_out or actions[tick, car] < 0:
                continue
            if not act(w, car, int(np.int64(actions[tick, car]))) and bad < 0:
                bad = tick * n_cars + car
        if w.corrections & DERIVED_MARKS:
            derive_marks(w)
    return bad
