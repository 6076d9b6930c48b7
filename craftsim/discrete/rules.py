"""The two rule sets on single worlds: what is legal, why not, what follows; and the action helper."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Final, get_args

import numpy as np
from numpy.typing import NDArray

from craftsim.choices import RuleSet as RuleSet
from craftsim.discrete.actions import act_own, as_own, carry_out, is_own, own_columns, own_reason
from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel import batch
from craftsim.discrete.kernel.batch import NO_HELPER
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kernel.jit import seldom
from craftsim.discrete.kernel.search import search_buffers
from craftsim.discrete.kinds import MOVE_DIRECTION, Action, Correction
from craftsim.discrete.reasons import Explanation, explain
from craftsim.errors import InputError, suggestion

RULE_SETS: Final[dict[RuleSet, Correction]] = {"published": Correction(0), "physical": ~Correction(0)}
"""The corrections of each rule set. What physics shows to be wrong is one more correction, read in its rule."""

DEFAULT_DEPTH: Final = 10
"""Search depth of CraftEnv's environment; its published training settings use 20."""

Joint = Sequence[tuple[int, int]]
"""(car, action) in acting order; a car that is not listed does nothing."""

_search_buffers: Final = lru_cache(maxsize=2)(search_buffers)
"""They may take 20 MB for each map size."""
_NO_SPACE: Final = search_buffers((1, 1, 1))
_masks, _step = seldom(batch.masks), seldom(batch.step)


class Rules:
    """A rule set at work on single worlds; grids passed in are never changed.

    Methods raise ValueError for a car that a world does not have.

    Example:
        >>> import craftsim
        >>> rules = craftsim.Rules("physical")
        >>> grid = craftsim.Grid.empty((3, 1, 1), n_cars=1)
        >>> rules.legal(grid, 0, craftsim.Action.MOVE_RIGHT), rules.legal(grid, 0, craftsim.Action.LIFT)
        (True, False)
        >>> rules.apply(grid, 0, craftsim.Action.MOVE_RIGHT).cars[0, :3].tolist()
        [1, 0, 1]
    """

    def __init__(
        self, rule_set: RuleSet, corrections: Correction | None = None, actions: Iterable[Action | str] = ()
    ) -> None:
        """Make a rule set.

        Args:
            rule_set: its name.
            corrections: others than its own, to see what a single one changes.
            actions: registered actions, or their names, that masks have a further column for, in this order. Those that
                are not named are judged and carried out all the same where one asks for them.
        """
        if rule_set not in RULE_SETS:
            known = ", ".join(get_args(RuleSet))
            raise InputError(
                f"unknown rule set '{rule_set}'; there are {known}{suggestion(rule_set, RULE_SETS)}"
            )
        self.rule_set: RuleSet = rule_set
        self.corrections = RULE_SETS[rule_set] if corrections is None else corrections
        self.own = as_own(tuple(actions))
        self.actions = (*Action, *self.own)
        """What the columns of masks stand for."""

    def mask(self, grid: Grid) -> NDArray[np.bool_]:
        """Return the legality of the 15 actions of each car, shape (n_cars, 15), all judged on this state.

        Registered actions that the rules were made with have further columns.
        """
        out = np.empty((1, grid.n_cars, N_ACTIONS), np.bool_)
        _masks(grid.cells[None], grid.cars[None], int(self.corrections), _NO_SPACE, NO_HELPER, out)
        return self._with_own(out, grid)[0]

    def legal(self, grid: Grid, car: int, action: int) -> bool:
        """Return whether one car could do one action now."""
        if is_own(action):
            _check_car(grid, car)
            return not own_reason(grid, self.corrections, car, action)
        return bool(self.tick(grid, [(car, action)])[1][0])

    def explain(self, grid: Grid, car: int, action: int) -> Explanation:
        """Return which rule forbids an action of a car now, in words, with the cells concerned; or that it is legal.

        ``str()`` of it is one line, such as ``LIFT is forbidden: something stands on (3, 2, 1): a block``. Raises
        ValueError for a car or an action that there is not.
        """
        _check_car(grid, car)
        return explain(grid, self.corrections, car, Action(action))

    def apply(self, grid: Grid, car: int, action: int) -> Grid:
        """Return the world after one car's action; an illegal action changes nothing."""
        return self.tick(grid, [(car, action)])[0]

    def enforce(self, grid: Grid, car: int, action: int) -> Grid:
        """Return the world as an action's effect would change it, whether the action is legal or not."""
        _check_car(grid, car)
        after = grid.copy()
        if is_own(action):
            carry_out(after, car, action)
        else:
            batch.enforce(after.cells, after.cars, int(self.corrections), car, int(action))
        return after

    def tick(self, grid: Grid, joint: Joint) -> tuple[Grid, NDArray[np.bool_]]:
        """Let cars act one after the other, each judged on what the earlier ones left.

        Returns the world after the tick and, parallel to ``joint``, whether each action was legal when its turn came.
        """
        for car, _ in joint:
            _check_car(grid, car)
        after, applied = grid.copy(), np.zeros((1, len(joint)), np.bool_)
        if any(is_own(action) for _, action in joint):
            for i, (car, action) in enumerate(joint):
                if is_own(action):
                    applied[0, i] = act_own(after, self.corrections, car, action)
                else:
                    after, applied[0, i : i + 1] = self.tick(after, [(car, action)])
            return after, applied[0]
        turns, acts = np.array(joint, np.int64).reshape(-1, 2).T.copy()[:, None]
        _step(after.cells[None], after.cars[None], int(self.corrections), turns, acts, applied)
        return after, applied[0]

    def reachable(self, grid: Grid, depth: int = DEFAULT_DEPTH) -> NDArray[np.bool_]:
        """Return (n_cars, 15): legal actions, and moves that are not legal but that the action helper has a plan for.

        With the helper a MOVE means "get to the neighbour cell", by whatever moves and turns lead there. ``mask`` says
        what a car can do at once; the two are never mixed.
        """
        out = np.empty((1, grid.n_cars, N_ACTIONS), np.bool_)
        arrays = grid.cells[None], grid.cars[None], int(self.corrections)
        batch.masks(*arrays, _search_buffers(grid.size), depth, out)
        return self._with_own(out, grid)[0]

    def plan_move(
        self, grid: Grid, car: int, action: Action, depth: int = DEFAULT_DEPTH
    ) -> tuple[Action, ...] | None:
        """Return the primitives that a MOVE stands for now, or None if the helper finds no way."""
        if action not in MOVE_DIRECTION:
            raise ValueError(f"{action!r} is not one of the four moves")
        _check_car(grid, car)
        steps = np.empty(depth + 1, np.int8)
        world = grid.world(self.corrections)
        length = batch.plan(world, car, int(action), _search_buffers(grid.size), depth, steps)
        return None if length < 0 else tuple(Action(step) for step in steps[:length].tolist())

    def due(self, grid: Grid, queue: NDArray[np.int8], car: int, action: Action) -> Action:
        """Return the primitive that an action stands for now, and leave in ``queue`` what is to follow it.

        As a batch's steps choose it, for physical execution. ``queue`` is that of :func:`empty_queue`.
        """
        if queue[car, 0] >= 0:
            due, queue[car, :-1], queue[car, -1] = int(queue[car, 0]), queue[car, 1:].copy(), -1
            return Action(due)
        if action not in MOVE_DIRECTION:
            return action
        first, *rest = self.plan_move(grid, car, action, queue.shape[1] - 1) or (Action.STOP,)
        queue[car, : len(rest)] = rest
        return first

    def _with_own(self, mask: NDArray[np.bool_], grid: Grid) -> NDArray[np.bool_]:
        """Return a mask (1, n_cars, 15) with a column for each registered action that is offered."""
        return own_columns(mask, grid[None], self.corrections, self.own) if self.own else mask


def empty_queue(n_cars: int, depth: int) -> NDArray[np.int8]:
    """Return (n_cars, depth + 1): what the action helper still has to do for each car, nothing yet (-1).

    It is there for everybody to see, and a reset empties it.

    Raises ValueError for a negative search depth.
    """
    if depth < 0:
        raise ValueError(f"the search depth is {depth}; allowed: 0 or more")
    return np.full((n_cars, depth + 1), -1, np.int8)


def _check_car(grid: Grid, car: int) -> None:
    """Raise ValueError if a world has no such car: compiled code would read past its arrays."""
    if not 0 <= car < grid.n_cars:
        raise ValueError(f"no car {car}; the world has {grid.n_cars}, counted from 0")


def has_room(grid: Grid) -> bool:
    """Return whether what each car carries is clear of all else by the rules: else no play of them leads there."""
    world = grid.world(RULE_SETS["physical"])
    return all(batch.has_room(world, car) for car in range(grid.n_cars))
