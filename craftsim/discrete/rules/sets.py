"""The two rule sets: which actions are legal, and what follows from a tick of all cars."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import DERIVED_MARKS, Correction, World, derive_marks, pose_of
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules.explain import Explanation, explain
from craftsim.discrete.rules.legality import N_ACTIONS
from craftsim.discrete.rules.table import apply, legal
from craftsim.errors import InputError, suggestion

RuleSet = Literal["published", "physical"]

RULE_SETS: Final[dict[RuleSet, Correction]] = {"published": Correction(0), "physical": ~Correction(0)}
"""The corrections of each rule set. What physics shows to be wrong is one more correction, read in its rule."""


@compiled
def fill_mask(w: World, out: NDArray[np.bool_]) -> None:
    """Write the legality of every action of every car, all judged on the same state, into out (n, 15)."""
    for car in range(w.cars.shape[0]):
        pose = pose_of(w, car)
        for action in range(N_ACTIONS):
            out[car, action] = legal(w, car, pose, action)


@compiled
def act(w: World, car: int, action: int) -> bool:
    """Carry out an action if it is legal now, else leave the world as it is; return whether it was."""
    if not legal(w, car, pose_of(w, car), action):
        return False
    apply(w, car, action)
    return True


@compiled
def run_tick(
    w: World, cars: NDArray[np.int64], actions: NDArray[np.int64], applied: NDArray[np.bool_]
) -> None:
    """Let cars act in the order given; applied[i] is whether the action of cars[i] was legal."""
    for turn in range(cars.shape[0]):
        applied[turn] = act(w, cars[turn], actions[turn])
    if w.corrections & DERIVED_MARKS:
        derive_marks(w)


def check_car(grid: Grid, car: int) -> None:
    """Raise ValueError if a world has no such car: compiled code would read past its arrays."""
    if not 0 <= car < grid.n_cars:
        raise ValueError(f"no car {car}; the world has {grid.n_cars}, counted from 0")


def acting_order(grid: Grid, joint: Sequence[tuple[int, int]]) -> NDArray[np.int64]:
    """Return (2, len(joint)): the cars as they act, and what each does. Raises ValueError for a car there is not."""
    for car, _ in joint:
        check_car(grid, car)
    return np.array([(car, int(action)) for car, action in joint], np.int64).reshape(-1, 2).T.copy()


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

    def __init__(self, rule_set: RuleSet, corrections: Correction | None = None) -> None:
        """Make a rule set; ``corrections`` gives others than its own, to see what a single one changes."""
        if rule_set not in RULE_SETS:
            known = ", ".join(get_args(RuleSet))
            raise InputError(
                f"unknown rule set '{rule_set}'; there are {known}{suggestion(rule_set, RULE_SETS)}"
            )
        self.rule_set: RuleSet = rule_set
        self.corrections = RULE_SETS[rule_set] if corrections is None else corrections

    def mask(self, grid: Grid) -> NDArray[np.bool_]:
        """Return the legality of the 15 actions of each car, shape (n_cars, 15), all judged on this state."""
        out = np.empty((grid.n_cars, N_ACTIONS), np.bool_)
        fill_mask(grid.world(self.corrections), out)
        return out

    def legal(self, grid: Grid, car: int, action: int) -> bool:
        """Return whether one car could do one action now."""
        check_car(grid, car)
        world = grid.world(self.corrections)
        return bool(legal(world, car, pose_of(world, car), int(action)))

    def explain(self, grid: Grid, car: int, action: int) -> Explanation:
        """Return which rule forbids an action of a car now, in words, with the cells concerned; or that it is legal.

        ``str()`` of it is one line, such as ``LIFT is forbidden: something stands on (3, 2, 1): a block``. Raises
        ValueError for a car or an action that there is not.
        """
        check_car(grid, car)
        return explain(grid.world(self.corrections), car, Action(action))

    def apply(self, grid: Grid, car: int, action: int) -> Grid:
        """Return the world after one car's action; an illegal action changes nothing."""
        return self.tick(grid, [(car, action)])[0]

    def tick(self, grid: Grid, joint: Sequence[tuple[int, int]]) -> tuple[Grid, NDArray[np.bool_]]:
        """Let cars act one after the other, each judged on what the earlier ones left.

        ``joint`` lists (car, action) in acting order; a car that is not listed does nothing. Returns the
        world after the tick and, parallel to ``joint``, whether each action was legal when its turn came.
        """
        after = grid.copy()
        cars, actions = acting_order(grid, joint)
        applied = np.zeros(len(cars), np.bool_)
        run_tick(after.world(self.corrections), cars, actions, applied)
        return after, applied
