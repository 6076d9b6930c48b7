"""Demonstrations: what is done on the way to a building, tick by tick, by the planner or by exploration."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import RuleSet
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.starts import Starts
from craftsim.errors import InputError
from craftsim.planning import NoPlanError, plan_building
from craftsim.planning.joint_plan import Ticks

Progress = Callable[[int], AbstractContextManager[Callable[[bool], None]]]
"""Given how many plans are to be made, a context in which a call says of each whether there is one."""
ATTEMPTS: Final = 1
"""Of the planner at each start."""
NOT_SHOWN: Final = -1
"""In place of an action: the plan lets the car wait. A policy that has learnt to wait may do so for ever."""


def silent(total: int) -> AbstractContextManager[Callable[[bool], None]]:
    """Show no progress."""
    return nullcontext(lambda found: None)


@dataclass(frozen=True)
class Demonstrations:
    """N ticks of plans, one plan after the other."""

    worlds: Starts
    """Before each tick, with what is to be built."""
    actions: NDArray[np.int64]
    """(N, n): of each car, or NOT_SHOWN."""
    rewards: NDArray[np.float32]
    """(N,)."""
    first: NDArray[np.bool_]
    """(N,): the first tick of a plan."""

    def returns(self, gamma: float) -> NDArray[np.float32]:
        """Return (N,): the discounted sum of rewards from each tick to the end of its plan."""
        found, ahead = np.empty_like(self.rewards), np.float32(0)
        for i in range(len(found) - 1, -1, -1):
            found[i] = ahead = self.rewards[i] + np.float32(gamma) * ahead
            if self.first[i]:
                ahead = np.float32(0)
        return found


def planned_demonstrations(
    task: Task, plans: int, rng: np.random.Generator, progress: Progress = silent
) -> Demonstrations:
    """Return what the planner does from so many starts of a task under the physical rule set.

    Starts without a plan within the length of an episode are left out. Raises InputError where there is none at all.
    """
    starts = task.draw_starts(rng, plans)
    seeds = rng.integers(2**31, size=plans).tolist()
    planned: list[Ticks] = []
    with progress(plans) as made:
        for i, seed in enumerate(seeds):
            planned.append(_plan(task, starts, i, seed))
            made(bool(planned[-1]))
    found = np.flatnonzero([0 < len(ticks) <= task.max_steps + 2 for ticks in planned])
    if not len(found):
        raise InputError(
            f"task '{task.name}': the planner found no plan within {task.max_steps + 2} ticks for any of {plans} "
            "starts; ask for more, or leave imitate out"
        )
    return replayed(task, starts.take(found), [planned[i] for i in found])


def _plan(task: Task, starts: Starts, i: int, seed: int) -> Ticks:
    """Return the ticks of a plan; none where there is no plan."""
    grid = starts.grid(i)
    one = task.starting_from([grid], starts.design(i, task.name)) if task.draws_designs else task
    try:
        return plan_building(grid, one, rounds=ATTEMPTS, time_s=math.inf, seed=seed, exact=False).ticks
    except NoPlanError:
        return ()


def replayed(
    task: Task, starts: Starts, plans: Sequence[Ticks], rules: RuleSet = "physical"
) -> Demonstrations:
    """Return what cars do in plans, one from each start."""
    n_cars, lengths = starts.grids.n_cars, np.array([len(plan) for plan in plans])
    rows, n_ticks = np.arange(len(plans)), int(lengths.max())
    actions = np.full((len(plans), n_ticks, n_cars), NOT_SHOWN)
    turns = np.tile(np.arange(n_cars), (len(plans), n_ticks, 1))
    for i, plan in enumerate(plans):
        for t, tick in enumerate(plan):
            acting = [car for car, _ in tick]
            actions[i, t, acting] = [action for _, action in tick]
            turns[i, t] = acting + [car for car in range(n_cars) if car not in acting]
    episodes = Episodes(task, np.random.default_rng(0), len(plans), rules)
    episodes.begin(rows, starts)
    worlds, rewards = [], np.zeros(actions.shape[:2], np.float32)
    for t in range(n_ticks):
        worlds.append(Starts(episodes.grids, episodes.designs).take(rows[lengths > t]))
        done = np.where(actions[:, t] == NOT_SHOWN, int(Action.STOP), actions[:, t])
        rewards[:, t] = episodes.step(done, turns[:, t]).reward
    # All that is shown in one tick lies together so far.
    which = np.arange(n_ticks)[:, None] < lengths
    order = np.lexsort(np.nonzero(which))
    shown = Starts.joined(worlds).take(order)
    which = which.T
    return Demonstrations(shown, actions[which], rewards[which], np.nonzero(which)[1] == 0)
