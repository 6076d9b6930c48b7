"""What a run is given beside its task: other starts to train from, and what it imitates before it learns.

Demonstrations are what is done on the way to a building, tick by tick, by the planner or by exploration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel.codes import N_ACTIONS
from craftsim.discrete.kinds import Action, PlanTick
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.errors import InputError
from craftsim.learning.config import HALF, TrainConfig
from craftsim.learning.exploration import EXPLORED_STARTS, explore
from craftsim.planning import NoPlanError, plan_building
from craftsim.planning.plan_file import read_plan
from craftsim.tasks import Task
from craftsim.tasks.episodes import Episodes
from craftsim.tasks.starts import Starts, StartSampler, load_starts, targets_of

if TYPE_CHECKING:
    from torch import Tensor

ProgressDisplay = Callable[[int], AbstractContextManager[Callable[[bool], None]]]
"""Given how many plans are to be made, a context in which a call says of each whether there is one."""
NOT_SHOWN: Final = -1
"""In place of an action: the plan lets the car wait. A policy that has learnt to wait may do so for ever."""

_LENGTHS: Final = "plans.lengths"
_STEPS: Final = "plans.steps"
_MOST_TICKS: Final = 10
"""Of plans in a run file, for each of their actions on average; a planner's hardly ever lets all cars wait."""


def silent(total: int) -> AbstractContextManager[Callable[[bool], None]]:
    """Show no progress."""
    return nullcontext(lambda succeeded: None)


def with_starts(task: Task, path: Path, rules: RuleSet = "physical") -> Task:
    """Return a task of whose episodes half start as ever and half with a world drawn from a file.

    Args:
        task: the task.
        path: a plan, followed from the task's start, or a file of
            :func:`craftsim.tasks.starts.save_starts`.
        rules: the rule set that the plan is followed under.

    Raises:
        InputError: the file cannot be read, or does not fit the task.
    """
    if task.draws_designs or (task.split and path.suffix == ".plan"):
        raise InputError(
            f"{path}: task '{task.name}' starts otherwise in every episode, so that no plan fits it, nor worlds "
            "without a design where each has its own; leave starts out"
        )
    if path.suffix != ".plan":
        return _half_from(task, load_starts(path))
    played = Rules(rules)
    grids = [task.draw(np.random.default_rng(0))]
    for tick in read_plan(path, grids[0].n_cars).ticks[:-1]:
        grids.append(played.tick(grids[-1], tick)[0])
    return _half_from(task, grids[1:])


def _half_from(task: Task, grids: Sequence[Grid]) -> Task:
    """Return a task of whose episodes half start as ever and half with one of these worlds."""
    if task.split:
        for grid in grids:
            task.check_start(grid)
        return _half_shown(task, Starts.of(grids, targets_of(task.design)))
    start = task.draw(np.random.default_rng(0))
    return task.starting_from([*grids, *[start] * len(grids)])


@dataclass(frozen=True)
class HalfShown:
    """Starts of which half come from one sampler, and half are drawn from others, with what is to be built in each."""

    sampler: StartSampler
    demonstrated: Starts
    share: float  # of the others, where it is not half

    def draw(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n starts."""
        starts = self.sampler.draw(rng, n)
        rows = np.flatnonzero(rng.random(n) < self.share)
        starts.put(rows, self.demonstrated.draw(rng, len(rows)))
        return starts


def _half_shown(task: Task, worlds: Starts, share: float = HALF) -> Task:
    assert task.sampler is not None, "a task that varies has a sampler"
    return replace(task, sampler=HalfShown(task.sampler, worlds, share))


@dataclass(frozen=True)
class Demonstrations:
    """N ticks of plans, one plan after the other."""

    worlds: Starts  # before each tick, with what is to be built
    actions: NDArray[np.int64]  # (N, n): of each car, or NOT_SHOWN
    rewards: NDArray[np.float32]  # (N,)
    first: NDArray[np.bool_]  # (N,): the first tick of a plan

    def returns(self, gamma: float) -> NDArray[np.float32]:
        """Return (N,): the discounted sum of rewards from each tick to the end of its plan."""
        returns = np.empty_like(self.rewards)
        later = np.float32(0)
        for i in range(len(returns) - 1, -1, -1):
            returns[i] = later = self.rewards[i] + np.float32(gamma) * later
            if self.first[i]:
                later = np.float32(0)
        return returns


def planned_demonstrations(
    task: Task,
    plans: int,
    rng: np.random.Generator,
    progress: ProgressDisplay = silent,
    planned: list[tuple[PlanTick, ...]] | None = None,
) -> Demonstrations:
    """Return what the planner does from so many starts of a task under the physical rule set.

    Starts without a plan within the length of an episode are left out. ``planned`` holds the plans of the first starts,
    which are not made again; each plan is appended as it is made. Raises InputError where there is none at all.
    """
    starts = task.draw_starts(rng, plans)
    seeds = rng.integers(2**31, size=plans).tolist()
    planned = [] if planned is None else planned
    with progress(plans) as tell:
        for ticks in planned:
            tell(bool(ticks))
        for i in range(len(planned), plans):
            planned.append(_plan(task, starts, i, seeds[i]))
            tell(bool(planned[i]))
    usable = np.flatnonzero([0 < len(ticks) <= task.max_steps + 2 for ticks in planned])
    if not len(usable):
        raise InputError(
            f"task '{task.name}': the planner found no plan within {task.max_steps + 2} ticks for any of {plans} "
            "starts; ask for more, or leave imitate out"
        )
    return _replayed(task, starts.take(usable), [planned[i] for i in usable])


def _plan(task: Task, starts: Starts, i: int, seed: int) -> tuple[PlanTick, ...]:
    """Return the ticks of a plan; none where there is no plan."""
    grid = starts.grid(i)
    start_task = task
    if task.draws_designs:
        start_task = task.starting_from([grid], starts.design(i, task.name))
    try:
        return plan_building(
            grid, start_task, rounds=1, time_s=math.inf, seed=seed, exact=False
        ).ticks
    except NoPlanError:
        return ()


def tensors_of_plans(planned: Sequence[tuple[PlanTick, ...]]) -> dict[str, Tensor]:
    """Return plans as tensors, by the names that they have in a run file.

    Of n plans: _LENGTHS (n,), their ticks, and _STEPS (m, 4), of each action its plan, tick, car and code.
    """
    import torch

    steps = list[tuple[int, int, int, int]]()
    for i, ticks in enumerate(planned):
        for t, tick in enumerate(ticks):
            for car, action in tick:
                steps.append((i, t, car, int(action)))
    lengths = torch.tensor([len(ticks) for ticks in planned], dtype=torch.int32)
    return {_LENGTHS: lengths, _STEPS: torch.tensor(steps, dtype=torch.int32).reshape(-1, 4)}


def plans_of_arrays(
    arrays: dict[str, Any], max_plans: int, n_cars: int
) -> list[tuple[PlanTick, ...]]:
    """Take the plans, at most so many, out of the arrays of a run file and return them; none if there are none.

    Raises InputError for arrays that are no plans.
    """
    lengths = arrays.pop(_LENGTHS, np.zeros(0, np.int32))
    steps = arrays.pop(_STEPS, np.zeros((0, 4), np.int32))
    _check_plans(lengths, steps, max_plans, n_cars)
    planned = []
    for n_ticks in lengths.tolist():
        planned.append([list[tuple[int, Action]]() for _ in range(n_ticks)])
    for plan, tick, car, action in steps.tolist():
        planned[plan][tick].append((car, Action(action)))
    return [tuple(tuple(tick) for tick in plan) for plan in planned]


def _check_plans(lengths: NDArray[Any], steps: NDArray[Any], max_plans: int, n_cars: int) -> None:
    if lengths.dtype != np.int32 or lengths.ndim != 1 or len(lengths) > max_plans:
        raise InputError(
            f"'{_LENGTHS}' is {lengths.dtype} {lengths.shape}; allowed: int32, at most ({max_plans},)"
        )
    if steps.dtype != np.int32 or steps.ndim != 2 or steps.shape[1] != 4:
        raise InputError(f"'{_STEPS}' is {steps.dtype} {steps.shape}; allowed: int32 (m, 4)")
    most_ticks = _MOST_TICKS * len(steps)
    if (lengths < 0).any() or int(lengths.sum(dtype=np.int64)) > most_ticks:
        raise InputError(
            f"'{_LENGTHS}' has numbers below 0, or more than {most_ticks} ticks together"
        )
    if not len(steps):
        return
    plan, tick, car, action = steps.T
    fits = (steps >= 0).all() and (plan < len(lengths)).all()
    if not (
        fits
        and (tick < lengths[plan]).all()
        and (car < n_cars).all()
        and (action < N_ACTIONS).all()
    ):
        raise InputError(f"'{_STEPS}' has numbers that are of no action of its plans")


def _replayed(
    task: Task, starts: Starts, plans: Sequence[tuple[PlanTick, ...]], rules: RuleSet = "physical"
) -> Demonstrations:
    """Return what cars do in plans, one from each start."""
    n_cars = starts.grids.n_cars
    lengths = np.array([len(plan) for plan in plans])
    rows = np.arange(len(plans))
    n_ticks = int(lengths.max())
    actions = np.full((len(plans), n_ticks, n_cars), NOT_SHOWN)
    turns = np.tile(np.arange(n_cars), (len(plans), n_ticks, 1))
    for i, plan in enumerate(plans):
        for t, tick in enumerate(plan):
            acting = [car for car, _ in tick]
            actions[i, t, acting] = [action for _, action in tick]
            turns[i, t] = acting + [car for car in range(n_cars) if car not in acting]
    episodes = Episodes(task, np.random.default_rng(0), len(plans), rules)
    episodes.begin(rows, starts)
    worlds = []
    rewards = np.zeros(actions.shape[:2], np.float32)
    for t in range(n_ticks):
        worlds.append(Starts(episodes.grids, episodes.designs).take(rows[lengths > t]))
        done = np.where(actions[:, t] == NOT_SHOWN, int(Action.STOP), actions[:, t])
        rewards[:, t] = episodes.step(done, turns[:, t]).reward
    # All that is shown in one tick lies together so far.
    which = np.arange(n_ticks)[:, None] < lengths
    played_starts = Starts.joined(worlds).take(np.lexsort(np.nonzero(which)))
    which = which.T
    return Demonstrations(played_starts, actions[which], rewards[which], np.nonzero(which)[1] == 0)


class Guidance(NamedTuple):
    """Either may be absent; the same whenever a run is resumed."""

    starts: Task | None = None  # the task with other starts
    demonstrations: Demonstrations | None = None


def check_guidance(config: TrainConfig, task: Task, starts: Task | None) -> None:
    """Raise InputError where a configuration asks for what does not go together, or not with a task."""
    if starts is not None and (config.explore or config.stages):
        raise InputError(
            "exploration and stages have starts of their own: leave them or starts out"
        )
    if config.shown_share != HALF and (starts is not None or not task.split):
        raise InputError(
            f"shown_share is {config.shown_share} with {'other starts' if starts else task.name}; it is of the plans "
            "that are imitated in a task that varies: leave it out"
        )
    if config.explore and not task.always_starts_the_same:
        raise InputError(
            f"exploration needs a fixed start, which task '{task.name}' has not: leave it out"
        )


def guidance_of(
    config: TrainConfig,
    task: Task,
    starts: Task | None,
    rng: np.random.Generator,
    progress: ProgressDisplay,
    planned: list[tuple[PlanTick, ...]],
) -> Guidance:
    """Return what a configuration asks for; given starts replace those along plans.

    ``planned`` holds plans that are made already, see :func:`planned_demonstrations`.
    """
    if config.explore:
        reached, path, ticks = explore(task, config.rules, config.explore, rng)
        demonstrations = None
        if 0 < len(ticks) <= task.max_steps + 2:
            start = Starts.of(path[:1], targets_of(task.design))
            demonstrations = _replayed(task, start, [ticks], config.rules)
        return Guidance(_half_from(task, reached), demonstrations)
    if not config.imitate:
        return Guidance(starts)
    demonstrations = planned_demonstrations(task, config.imitate, rng, progress, planned)
    if starts is None and task.split:
        starts = _half_shown(task, demonstrations.worlds, config.shown_share)
    elif starts is None:
        numbers = rng.integers(len(demonstrations.worlds), size=EXPLORED_STARTS)
        starts = _half_from(task, [demonstrations.worlds.grid(i) for i in numbers])
    return Guidance(starts, demonstrations)
