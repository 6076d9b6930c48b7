"""The path of one car through a world in which others act: A* over its states and ticks.

A step counts as possible in a tick if the rules allow it both before and after what the others do in that tick, so that
the order in which they act does not matter.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Cell, Kind
from craftsim.discrete.kernel.codes import LAST_MOVE, ROTATE_LEFT
from craftsim.discrete.kernel.effects import after
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.reach import car_in
from craftsim.discrete.kernel.rules import legal_actions
from craftsim.discrete.kernel.search import SUCCESSORS, node_of
from craftsim.discrete.kernel.state import World
from craftsim.discrete.move_graph import N_STEPS, UNREACHABLE, Distances, node_number, pose_at_node

WAIT: Final = -1
_MAX_TICKS: Final = 320
"""A path is no longer than this."""


class PathFinder:
    """Searches paths in worlds of one size; its scratch arrays are kept."""

    def __init__(self, size: Cell) -> None:
        self._size = size
        self._n_nodes = node_number(size, (size[0], 0, 0), 0)
        self._parents = np.empty(0, np.int32)
        self._steps = np.empty(0, np.int8)
        self._seen = np.zeros(0, np.int32)
        self._next = np.empty(0, np.int32)
        self._heads = np.empty(2 * _MAX_TICKS + 2, np.int32)
        self._number = 0

    def find(
        self,
        worlds: World,
        car: int,
        start: int,
        tick: int,
        end: int,
        load: Kind,
        distances: Distances,
        last: int,
        not_before: int,
        avoid: list[tuple[int, Cell]],
    ) -> list[int] | None:
        """Return the actions, WAIT among them, that bring a car to a goal, or None.

        Args:
            worlds: those before each tick, without this car; after ``end`` nothing changes.
            car: its number.
            start: its state.
            tick: in which it begins.
            end: the first tick in which the others do nothing any more.
            load: that it carries.
            distances: (nodes,) to the goals, where they are 0; states with UNREACHABLE are not looked at.
            last: the action that must be legal there in the tick after; -1 for none.
            not_before: the first tick in which that may be.
            avoid: ticks before which the car must not be in a cell.
        """
        nearest = int(distances[start])
        if nearest >= UNREACHABLE:
            return None
        span = min(_MAX_TICKS, max(end, not_before) - tick + nearest + 24)
        if len(self._parents) < span * self._n_nodes:
            n_states = span * self._n_nodes
            self._parents, self._steps = np.empty(n_states, np.int32), np.empty(n_states, np.int8)
            self._seen, self._next = np.zeros(n_states, np.int32), np.empty(n_states, np.int32)
        self._number += 1
        self._heads[:] = -1
        for at, cell in avoid:
            state = (at - tick) * self._n_nodes + node_number(self._size, cell, 0)
            if tick < at < tick + span:
                # What counts as seen is not looked at.
                self._seen[state : state + 4] = self._number
        state = _find(
            *(worlds, car, start, tick, end, int(load), distances, int(last), not_before),
            *(span, self._number, self._parents, self._steps, self._seen, self._next, self._heads),
        )
        if state < 0:
            return None
        actions = []
        while self._parents[state] >= 0:
            actions.append(int(self._steps[state]))
            state = self._parents[state]
        return actions[::-1]


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
