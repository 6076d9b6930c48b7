"""The action helper: a MOVE means "get to the neighbour cell", by whatever moves and turns lead there.

``legal`` (Rules.mask) says what a car can do at once, ``reachable`` what the helper can bring about; they are
never mixed. What is left of a plan is kept in a queue that everybody can see, and that a reset empties.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import DERIVED_MARKS, World, derive_marks
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.discrete.planning.search import (
    Space,
    fill_reachable,
    forget_ways,
    make_space,
    plan_move,
    search,
    write_plan,
)
from craftsim.discrete.rules.legality import FIRST_MOVE, LAST_MOVE, STOP
from craftsim.discrete.rules.sets import Rules, act, acting_order, check_car

DEFAULT_DEPTH = 10
"""Search depth of CraftEnv's environment; its published training settings use 20."""


def empty_queue(n_cars: int, depth: int) -> NDArray[np.int8]:
    """Return queues of n cars, shape (n_cars, depth + 1), with nothing in them (-1).

    Raises ValueError for a negative search depth.
    """
    if depth < 0:
        raise ValueError(f"the search depth is {depth}; allowed: 0 or more")
    return np.full((n_cars, depth + 1), -1, np.int8)


@compiled
def advance(queue: NDArray[np.int8]) -> int:
    """Take the first action from one car's queue."""
    action = int(np.int64(queue[0]))
    for i in range(len(queue) - 1):
        queue[i] = queue[i + 1]
    queue[-1] = -1
    return action


@compiled
def act_with_helper(
    w: World, car: int, action: int, queue: NDArray[np.int8], space: Space, limit: int
) -> bool:
    """Let one car act: by its queue if it has one, else by a new plan for a MOVE, else by the action.

    Returns whether the primitive that was due was legal; if a queued one was not, the queue is thrown away.
    """
    queued = queue[0] >= 0
    due = action
    if queued:
        due = advance(queue)
    elif FIRST_MOVE <= action <= LAST_MOVE:
        forget_ways(space)
        node = plan_move(w, car, space, action, limit)
        due = STOP
        if node >= 0:
            write_plan(space, node, queue)
            due = advance(queue)
    applied = act(w, car, due)
    if queued and not applied:
        queue[:] = -1
    return applied


@compiled
def run_helper_tick(
    w: World,
    cars: NDArray[np.int64],
    actions: NDArray[np.int64],
    applied: NDArray[np.bool_],
    queues: NDArray[np.int8],
    space: Space,
    limit: int,
) -> None:
    """Let cars act in the order given, with the helper on; queues (n, limit + 1) are changed in place."""
    for turn in range(cars.shape[0]):
        car = cars[turn]
        applied[turn] = act_with_helper(w, car, actions[turn], queues[car], space, limit)
    if w.corrections & DERIVED_MARKS:
        derive_marks(w)


class Planner:
    """The action helper with a search depth, for single worlds under a rule set.

    Methods raise ValueError for a car that a world does not have.
    """

    def __init__(self, rules: Rules, depth: int = DEFAULT_DEPTH) -> None:
        self.rules = rules
        self.depth = depth
        self._last: tuple[Cell, Space] | None = None

    def _space(self, grid: Grid) -> Space:
        """Return scratch arrays; those of one map size are kept, and no more: they may take 20 MB each."""
        if self._last is None or self._last[0] != grid.size:
            self._last = grid.size, make_space(grid.size)
        forget_ways(self._last[1])
        return self._last[1]

    def _read(self, space: Space, node: int) -> tuple[Action, ...] | None:
        if node < 0:
            return None
        steps = np.empty(self.depth + 1, np.int8)
        return tuple(Action(step) for step in steps[: write_plan(space, node, steps)])

    def plan_move(self, grid: Grid, car: int, action: Action) -> tuple[Action, ...] | None:
        """Return the primitives that a MOVE stands for now, or None if the helper finds no way."""
        if action not in MOVE_DIRECTION:
            raise ValueError(f"{action!r} is not one of the four moves")
        check_car(grid, car)
        space = self._space(grid)
        world = grid.world(self.rules.corrections)
        return self._read(space, plan_move(world, car, space, int(action), self.depth))

    def due(self, grid: Grid, queue: NDArray[np.int8], car: int, action: Action) -> Action:
        """Return the primitive that an action stands for now, and leave in ``queue`` what is to follow it.

        As :func:`act_with_helper` chooses it, for those who perform it by other means than the rules.
        """
        if queue[car, 0] >= 0:
            return Action(advance(queue[car]))
        if action not in MOVE_DIRECTION:
            return action
        first, *rest = self.plan_move(grid, car, action) or (Action.STOP,)
        queue[car, : len(rest)] = rest
        return first

    def plan_to(self, grid: Grid, car: int, cell: Cell) -> tuple[Action, ...] | None:
        """Return the primitives that bring a car to a cell, or None if the helper finds no way."""
        check_car(grid, car)
        space = self._space(grid)
        return self._read(space, search(grid.world(self.rules.corrections), car, space, *cell, self.depth))

    def reachable(self, grid: Grid) -> NDArray[np.bool_]:
        """Return (n_cars, 15): legal actions, and moves that are not legal but have a plan."""
        mask = self.rules.mask(grid)
        fill_reachable(grid.world(self.rules.corrections), self._space(grid), self.depth, mask)
        return mask

    def tick(
        self, grid: Grid, queue: NDArray[np.int8], joint: Sequence[tuple[int, int]]
    ) -> tuple[Grid, NDArray[np.int8], NDArray[np.bool_]]:
        """Let cars act in the order given, helper on; return world, queues and which primitives applied.

        A car whose queue is not empty ignores the action it is given. ``queue`` has shape (n_cars, depth + 1)
        with -1 where nothing is queued.
        """
        if queue.shape != (grid.n_cars, self.depth + 1):
            raise ValueError(f"queue has shape {queue.shape}; it must be {(grid.n_cars, self.depth + 1)}")
        grid, queue = grid.copy(), queue.copy()
        cars, actions = acting_order(grid, joint)
        applied = np.zeros(len(cars), np.bool_)
        world, space = grid.world(self.rules.corrections), self._space(grid)
        run_helper_tick(world, cars, actions, applied, queue, space, self.depth)
        return grid, queue, applied
