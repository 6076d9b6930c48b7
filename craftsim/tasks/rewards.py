"""Potentials, goals and rewards of many worlds at once: functions by name, to which one's own may be added."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.arrays import Flags, Floats
from craftsim.compiled.jit import seldom
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError, suggestion
from craftsim.tasks.kernel import (
    count_stacks,
    flag_distances,
    largest_platforms,
    score_buildings,
    score_complexities,
    score_structures,
)
from craftsim.tasks.observation import Layout
from craftsim.tasks.starts import Targets

_score_building = seldom(score_buildings)
_score_complexity = seldom(score_complexities)
_score_structure = seldom(score_structures)
_count_stacks = seldom(count_stacks)

Potential = Callable[[Grid, Targets, Layout], Floats]
"""(B,): a number for each of B worlds, from the worlds, what is to be built in each, and what the task announces."""
_Goal = Callable[[Grid, Targets, Layout], Flags]
"""(B,): whether the work is done in each of B worlds; arguments as of a potential."""
RewardRule = Callable[[Floats, Floats, NDArray[np.int64], Flags], tuple[Floats, Flags]]
"""The reward of a tick, and whether a one-time bonus counts as given from now on.

All arguments and results have one element a world: the potential before and after the tick, the tick's number from 0,
and whether the bonus was given in an earlier tick.
"""


@dataclass(frozen=True)
class Transition:
    """One tick of one world, as a reward function sees it; arrays and grids are its own to keep, not to change."""

    before: Grid
    after: Grid
    """As it is seen: on the grid by the rules, in physics as read from poses."""
    t: int
    """Number of the tick in its episode, from 0."""
    actions: tuple[Action, ...]
    """Actions by car, as chosen; in asynchronous execution STOP for a car whose decision has not ended."""
    applied: tuple[bool, ...]
    """By car, true if the rules allowed its action when its turn came."""
    durations_s: tuple[float, ...]
    """Durations by car: nominal on the grid, simulated in physics, 0 where nothing was done."""
    duration_s: float
    """Duration of the tick."""
    attempts: tuple[Any, ...] = ()
    """By car the :class:`craftsim.Attempt` of the judge: primitive, result, errors and forces. Empty on the grid.

    In asynchronous execution a car has one when its action has ended, or was forbidden by the rules, else None."""
    contacts: tuple[Any, ...] | None = None
    """Contacts during the tick, each with ``first``, ``second`` and ``peak_n``; None on the grid, and in
    physics unless the option ``check_contacts`` is on. In asynchronous execution those of the cars whose actions have
    ended, and of what these handled, since the actions began."""
    problems: tuple[str, ...] = ()
    """Reasons why the world cannot be read as a grid any more; empty where it can."""

    @property
    def verdicts(self) -> tuple[str | None, ...]:
        """By car ``as predicted``, ``failed``, ``side effect``, ``unsafe`` or ``numerics``; None on the grid."""
        if not self.attempts:
            return (None,) * len(self.actions)
        verdicts: list[str | None] = []
        for attempt in self.attempts:
            if attempt is None:
                verdicts.append(None)
            else:
                verdicts.append(str(attempt.result))
        return tuple(verdicts)


RewardFunction = Callable[[Transition], float]
"""A reward of a user's own: one number for all cars, from one tick of one world."""

_COMPLETION: Final = 4.0
"""Extra potential of a finished building by the paper's table 1."""
PUBLISHED_COMPLETION: Final = 8.0
"""Extra potential of a finished building in CraftEnv's code."""
ALPHA: Final = 10.0
"""Reward of a tick that ends with the flag on the goal, by the paper."""
BETA: Final = 1.0
"""Cost of every tick of the barrier task, by the paper."""
STRUCTURE_WEIGHTS: Final = (1.0, 1.0, 5.0, 10.0, 25.0, 50.0)
"""Weights of the parts of :func:`structure`: ``block_near_unfold``, ``block_on_block``, ``fold_on_block``,
``unfold_on_block``, ``block_unfold_on_block`` and ``block_on_block_on_block`` of CraftEnv's ``free.yaml`` and
``flag.yaml``."""
_WEIGHTS: Final = np.array(STRUCTURE_WEIGHTS)
PUBLISHED_BONUS: Final = 20.0
"""From this CraftEnv's code subtracts the tick's number when the flag first reaches the goal."""


def building(grids: Grid, designs: Targets, layout: Layout, upper_block: float = 1.0) -> Floats:
    """Return how far each building is by table 1; ``upper_block`` is for a block above the floor level."""
    return _building_scores(grids, designs, 1.0, upper_block, _COMPLETION)


def published_building(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return how far each building is as CraftEnv's code computes it (docs/rules.md#goal-score)."""
    kind, x, y, z = np.moveaxis(designs[..., :4], -1, 0)
    blocks = kind == Kind.BLOCK
    top = grids.size[2]
    standing = grids.kind[np.arange(len(grids))[:, None], x, y, np.minimum(z, top)]
    hits = (
        (kind != Kind.AIR) & (z < top) & ((standing == kind) | (blocks & (standing == Kind.GEAR)))
    )
    finished = hits.sum(1) == (kind != Kind.AIR).sum(1)
    return (blocks & (z == 2)).sum(1) + hits.sum(1) + PUBLISHED_COMPLETION * finished


def platform(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return the blocks of the largest platform less one (equation 3); 0 without blocks."""
    return np.maximum(_platforms(grids, Kind.BLOCK, grids.size[2]) - 1, 0)


def published_platform(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return the blocks and gears of the largest platform, 0 for a single one; the top level is not looked at."""
    sizes = _platforms(grids, Kind.GEAR, grids.size[2] - 1)
    return np.where(sizes > 1, sizes, 0.0)


def flag_nearness(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return minus the Manhattan distance of the flag to the goal; a lost flag is farther than any cell."""
    out = np.empty(len(grids))
    flag_distances(grids.cells, grids.cars, layout.goal_cell, out)
    return -out


def complexity(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return how elaborate a building is: its largest platform, levels of blocks above the floor, ramps to blocks.

    Such a ramp is an unfolded slope with its foot below and a block behind its body.
    """
    extra = np.empty(len(grids))
    if len(grids) == 1:
        score = _score_complexity
    else:
        score = score_complexities
    score(grids.cells, grids.cars, extra)
    return platform(grids, designs, layout) + extra


def structure(grids: Grid, designs: Targets, layout: Layout) -> Floats:
    """Return how elaborate a building is by what CraftEnv's configuration files weigh for large-scale training.

    A block behind the body of an unfolded slope counts 1, a block on a block 1, a folded slope on a block 5, an
    unfolded one 10, and 25 more where it leads to a block, and a stack of three blocks from the floor 50.
    """
    out = np.empty(len(grids))
    if len(grids) == 1:
        score = _score_structure
    else:
        score = score_structures
    score(grids.cells, grids.cars, _WEIGHTS, out)
    return out


POTENTIALS: Final[dict[str, Potential]] = {
    "building": building,
    "complex_building": partial(building, upper_block=3.0),
    "published_building": published_building,
    "platform": platform,
    "published_platform": published_platform,
    "flag_nearness": flag_nearness,
    "complexity": complexity,
    "structure": structure,
}


GOALS: Final[dict[str, _Goal]] = {
    # Each cell to be built holds its kind with its yaw.
    "built": lambda grids, designs, layout: _building_scores(grids, designs, 0.0, 0.0, 1.0) != 0,
    # All blocks that the task announces form one platform.
    "one_platform": lambda grids, designs, layout: (
        platform(grids, designs, layout) == layout.n_blocks - 1
    ),
    # The flag, carried or not, is in the goal cell.
    "flag_at_goal": lambda grids, designs, layout: flag_nearness(grids, designs, layout) == 0,
    # Three blocks stand on one another from the floor.
    "three_high": lambda grids, designs, layout: _stacks(grids) > 0,
}


def published_barrier(
    before: Floats, after: Floats, t: NDArray[np.int64], bonus_given: Flags
) -> tuple[Floats, Flags]:
    """Return nothing in the first tick, then each step of the flag, and one bonus (docs/rules.md#flag-bonus)."""
    arrived = (t >= 1) & (after == 0) & ~bonus_given
    steps = np.where(t == 0, 0.0, after - before)
    bonus = np.where(arrived, PUBLISHED_BONUS - t, 0.0)
    return steps + bonus, bonus_given | arrived


REWARD_RULES: Final[dict[str, RewardRule]] = {
    # Over an episode that of the end less that of the start.
    "change": lambda before, after, t, bonus_given: (after - before, bonus_given),
    # In the first tick the whole potential (docs/rules.md#first-tick).
    "published_change": lambda before, after, t, bonus_given: (
        np.where(t == 0, after, after - before),
        bonus_given,
    ),
    # Each step of the flag towards the goal, ALPHA while it is there, less BETA every tick.
    "barrier": lambda before, after, t, bonus_given: (
        after - before + ALPHA * (after == 0) - BETA,
        bonus_given,
    ),
    "published_barrier": published_barrier,
}


@dataclass(frozen=True)
class Reward:
    """The reward of a tick, one number shared by all cars: what a rule makes of a potential before and after.

    Example:
        >>> from craftsim.tasks.rewards import Reward
        >>> Reward("building", "published_change").rule
        'published_change'
    """

    potential: str | Callable[[Grid], float]
    """A name in POTENTIALS, or any function of a Grid, which then looks at a batch world by world."""
    rule: str | RewardRule = "change"
    """A name in REWARD_RULES, or a function such as those."""

    def __post_init__(self) -> None:
        check_name("potential", self.potential, POTENTIALS)
        check_name("reward rule", self.rule, REWARD_RULES)

    def of_tick(
        self, before: Floats, after: Floats, t: NDArray[np.int64], bonus_given: Flags
    ) -> tuple[Floats, Flags]:
        """Return the reward of tick t, and whether the bonus is spent; see :data:`RewardRule`."""
        if isinstance(self.rule, str):
            rule = REWARD_RULES[self.rule]
        else:
            rule = self.rule
        return rule(before, after, t, bonus_given)


def rewards_of(function: RewardFunction, transitions: Iterable[Transition]) -> Floats:
    """Return what a reward function gives for ticks of worlds; raises InputError for anything but a finite number."""
    rewards = []
    for transition in transitions:
        value: object = function(transition)
        if not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise InputError(
                f"the reward function returned {value!r}; it must return a finite number"
            )
        rewards.append(float(value))
    return np.array(rewards, np.float64)


def check_name(noun: str, value: Any, options: Iterable[str]) -> None:
    """Raise InputError for anything but a function or the known name of one."""
    if not callable(value):
        names = list(options)
        if value not in names:
            raise InputError(
                f"unknown {noun} '{value}'{suggestion(str(value), names)}; there are {', '.join(names)}, or a function"
            )


def _building_scores(
    grids: Grid, designs: Targets, per_thing: float, upper_block: float, completion: float
) -> Floats:
    out = np.empty(len(grids))
    if len(out) == 1:
        score = _score_building
    else:
        score = score_buildings
    score(grids.cells, grids.cars, designs, per_thing, upper_block, completion, out)
    return out


def _platforms(grids: Grid, extra_kind: Kind, levels: int) -> Floats:
    """Return the size of the largest platform of each world; a thing of ``extra_kind`` counts as a block, too."""
    length, width, _ = grids.size
    visited = np.empty((length, width), np.bool_)
    stack = np.empty((length * width, 2), np.int64)
    out = np.empty(len(grids))
    largest_platforms(grids.cells, grids.cars, int(extra_kind), levels, visited, stack, out)
    return out


def _stacks(grids: Grid) -> Floats:
    """Return (B,): how many stacks of three blocks from the floor each world has."""
    out = np.empty(len(grids))
    if len(grids) == 1:
        count = _count_stacks
    else:
        count = count_stacks
    count(grids.cells, grids.cars, out)
    return out
