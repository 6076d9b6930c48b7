"""What every car does in every tick, and the world before each: a plan as it grows, held to the rules throughout.

The path of one car among others is found by A* over its states and ticks. A step counts as possible in a tick if the
rules allow it both before and after what the others do in that tick, so that the order in which they act does not
matter.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kernel.codes import LAST_MOVE, ROTATE_LEFT
from craftsim.discrete.kernel.effects import after
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.rules import act, legal_actions
from craftsim.discrete.kernel.search import SUCCESSORS, node_of
from craftsim.discrete.kernel.state import DERIVED_MARKS, World, car_in, derive_marks
from craftsim.discrete.kinds import Action, Kind
from craftsim.discrete.move_graph import N_STEPS, UNREACHABLE, Distances, node_number, pose_at_node
from craftsim.discrete.rules import Rules

WAIT: Final = -1
"""In place of an action: nothing is done."""
_LEFT_OUT: Final = (-9, -9, -9, 0, Kind.AIR, 0, 0)
"""A car that is left out, fields as CarField: far from all cells, so that no rule sees it."""
_FIRST_TICKS: Final = 64
_MAX_TICKS: Final = 320
"""A path is no longer than this."""


class Timeline:
    """The actions of all cars by tick, (T, n), and the worlds that follow from them by the rules."""

    def __init__(self, grid: Grid, rules: Rules) -> None:
        self.n_cars = grid.n_cars
        self.actions = np.full((_FIRST_TICKS, grid.n_cars), WAIT, np.int8)
        self.end = 0
        """The first tick in which nothing is done any more."""
        self._corrections = rules.corrections
        self._grids = Grid.stack([grid] * _FIRST_TICKS)
        self._others = self._grids.copy()
        self._size, self._n_nodes = grid.size, node_number(grid.size, (grid.size[0], 0, 0), 0)
        self._searches = 0
        self._heads = np.empty(2 * _MAX_TICKS + 2, np.int32)
        self._make_states(0)

    @property
    def worlds(self) -> World:
        """Those before tick 0, 1, 2, ...; arrays have a leading dimension over ticks."""
        return self._grids.world(self._corrections)

    def grid(self, tick: int) -> Grid:
        """Return the world before a tick."""
        return self._grids[tick].copy()

    def node(self, car: int, tick: int) -> int:
        """Return a car's state before a tick."""
        x, y, z, yaw = self._grids.cars[tick, car, :4].tolist()
        return node_number(self._size, (x, y, z), yaw)

    def reserve(self, n_ticks: int) -> None:
        """Make room for actions in the ticks before this one."""
        while len(self.actions) <= n_ticks:
            self.actions = np.concatenate([self.actions, np.full_like(self.actions, WAIT)])
        while len(self._grids) <= n_ticks + 1:
            self._grids, self._others = (
                Grid(np.concatenate([some.cells] * 2), np.concatenate([some.cars] * 2))
                for some in (self._grids, self._others)
            )

    def shorten(self) -> None:
        """Set the end anew after actions were taken out."""
        acting = np.flatnonzero((self.actions != WAIT).any(1))
        self.end = int(acting[-1]) + 1 if len(acting) else 0

    def write(self, car: int, tick: int, actions: list[int]) -> None:
        """Let a car do these actions from a tick on, and nothing after them."""
        self.reserve(max(self.end, tick + len(actions)))
        self.actions[tick:, car] = WAIT
        self.actions[tick : tick + len(actions), car] = actions
        self.end = max(self.end, tick + len(actions))
        self.shorten()

    def replay(self, tick: int) -> tuple[int, int] | None:
        """Work out the worlds after a tick; return the first (tick, car) whose action is forbidden, or None."""
        bad = int(_replay(self.worlds, self.actions, tick, self.end, -1))
        return None if bad < 0 else divmod(bad, self.n_cars)

    def without(self, car: int, tick: int) -> World:
        """Return the worlds as they are from a tick on if a car does not exist any more; valid until the next call."""
        self._others.cells[tick], self._others.cars[tick] = self._grids.cells[tick], self._grids.cars[tick]
        self._others.cars[tick, car] = _LEFT_OUT
        others = self._others.world(self._corrections)
        _replay(others, self.actions, tick, self.end, car)
        return others

    def trim(self, reached: Callable[[Grid], bool]) -> None:
        """Take the last actions of each car away as long as a goal is reached without them."""
        for car in range(self.n_cars):
            for tick in np.flatnonzero(self.actions[:, car] != WAIT)[::-1].tolist():
                action = self.actions[tick, car]
                self.actions[tick, car] = WAIT
                if self.replay(tick) is None and reached(self.grid(self.end)):
                    continue
                self.actions[tick, car] = action
                self.replay(tick)
                break
        self.shorten()

    def ticks(self) -> tuple[tuple[tuple[int, Action], ...], ...]:
        """Return the plan: for each tick the (car, action) pairs in acting order."""
        return tuple(
            tuple((car, Action(action)) for car, action in enumerate(joint) if action != WAIT)
            for joint in self.actions[: self.end].tolist()
        )

    def find_path(
        self,
        car: int,
        tick: int,
        load: Kind,
        distances: Distances,
        last: int,
        not_before: int,
        avoid: list[tuple[int, Cell]],
    ) -> list[int] | None:
        """Return the actions, WAIT among them, that bring a car to a goal from a tick on, or None.

        Args:
            car: its number; it does nothing from the tick on.
            tick: in which it begins.
            load: that it carries.
            distances: (nodes,) to the goals, where they are 0; states with UNREACHABLE are not looked at.
            last: the action that must be legal there in the tick after; -1 for none.
            not_before: the first tick in which that may be.
            avoid: ticks before which the car must not be in a cell.
        """
        worlds, start, end = self.without(car, tick), self.node(car, tick), max(self.end, tick)
        nearest = int(distances[start])
        if nearest >= UNREACHABLE:
            return None
        span = min(_MAX_TICKS, max(end, not_before) - tick + nearest + 24)
        if len(self._parents) < span * self._n_nodes:
            self._make_states(span * self._n_nodes)
        self._searches += 1
        self._heads[:] = -1
        for at, cell in avoid:
            state = (at - tick) * self._n_nodes + node_number(self._size, cell, 0)
            if tick < at < tick + span:
                # What counts as seen is not looked at.
                self._seen[state : state + 4] = self._searches
        state = _find(
            *(worlds, car, start, tick, end, int(load), distances, int(last), not_before, span),
            *(self._searches, self._parents, self._steps, self._seen, self._next, self._heads),
        )
        if state < 0:
            return None
        actions = []
        while self._parents[state] >= 0:
            actions.append(int(self._steps[state]))
            state = self._parents[state]
        return actions[::-1]

    def _make_states(self, n: int) -> None:
        """Make scratch arrays for a search through so many states, a node in a tick each."""
        self._parents, self._steps = np.empty(n, np.int32), np.empty(n, np.int8)
        self._seen, self._next = np.zeros(n, np.int32), np.empty(n, np.int32)


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


@compiled
def _find(
    worlds: World,
    me: int,
    start: int,
    first: int,
    end: int,
    load: int,
    distances: Distances,
    last: int,
    not_before: int,
    span: int,
    number: int,
    parents: NDArray[np.int32],
    steps: NDArray[np.int8],
    seen: NDArray[np.int32],
    following: NDArray[np.int32],
    heads: NDArray[np.int32],
) -> int:
    """Return the last state of a path, or -1; a state is a node in a tick. Buckets hold states of equal rank."""
    n_nodes = distances.shape[0]
    parents[start] = -1
    seen[start] = number
    following[start] = -1
    rank = distances[start]
    heads[rank] = start
    while rank < heads.shape[0]:
        state = heads[rank]
        if state < 0:
            rank += 1
            continue
        heads[rank] = following[state]
        since, node = state // n_nodes, state % n_nodes
        tick = first + since
        before, behind = min(tick, end), min(tick + 1, end)
        now = World(worlds.cells[before], worlds.cars[before], worlds.corrections)
        then = World(worlds.cells[behind], worlds.cars[behind], worlds.corrections)
        car = pose_at_node(now, node, load)
        arrived = distances[node] == 0 and tick >= not_before
        if arrived and last < 0:
            return int(state)
        if since + 1 >= span:
            continue
        # The action at the goal comes first, then staying, then the steps.
        if arrived:
            legal = legal_actions(now, me, car, last, last) & legal_actions(then, me, car, last, last)
            if legal & (1 << last):
                return int(state)
        legal = legal_actions(now, me, car, ROTATE_LEFT, LAST_MOVE)
        legal &= legal_actions(then, me, car, ROTATE_LEFT, LAST_MOVE)
        for i in range(-1, N_STEPS):
            action = WAIT if i == -1 else SUCCESSORS[i]
            if i >= 0 and not legal & (1 << action):
                continue
            new = car if i == -1 else after(now, car, action)
            new_node = node if i == -1 else node_of(now, new)
            if distances[new_node] >= UNREACHABLE or car_in(then, me, new.x, new.y, new.z, False) >= 0:
                continue
            new_state = (since + 1) * n_nodes + new_node
            new_rank = since + 1 + distances[new_node]
            if seen[new_state] == number or new_rank >= heads.shape[0]:
                continue
            seen[new_state] = number
            parents[new_state] = state
            steps[new_state] = action
            following[new_state] = heads[new_rank]
            heads[new_rank] = new_state
            rank = min(rank, new_rank)
    return -1
