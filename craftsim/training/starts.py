"""What a run is given beside its task: other starts to train from, and what it imitates before it learns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.starts import Starts, StartSampler, load_starts, targets_of
from craftsim.errors import InputError
from craftsim.training.config import HALF, TrainConfig
from craftsim.training.demonstrations import Demonstrations, Progress, planned_demonstrations, replayed
from craftsim.training.exploration import STARTS, done_on, explore


def with_starts(task: Task, path: Path, rules: RuleSet = "physical") -> Task:
    """Return a task of whose episodes half start as ever and half with a world drawn from a file.

    Args:
        task: the task.
        path: a plan, followed from the task's start, or a file of
            :func:`craftsim.discrete.tasks.starts.save_starts`.
        rules: the rule set that the plan is followed under.

    Raises:
        InputError: the file cannot be read, or does not fit the task.
    """
    if task.draws_designs or (task.split and path.suffix == ".plan"):
        raise InputError(
            f"{path}: task '{task.name}' starts otherwise in every episode, so that no plan fits it, nor worlds "
            "without a design where each has its own; leave starts out"
        )
    own = task.draw(np.random.default_rng(0))
    grids = along_plan(own, path, rules) if path.suffix == ".plan" else load_starts(path)
    return half_from(task, grids)


def half_from(task: Task, grids: Sequence[Grid]) -> Task:
    """Return a task of whose episodes half start as ever and half with one of these worlds."""
    if task.split:
        for grid in grids:
            task.check_start(grid)
        return half_shown(task, Starts.of(grids, targets_of(task.design)))
    own = task.draw(np.random.default_rng(0))
    return task.starting_from([*grids, *[own] * len(grids)])


@dataclass(frozen=True)
class HalfShown:
    """Starts of which half come from one sampler, and half are drawn from others, with what is to be built in each."""

    own: StartSampler
    others: Starts
    share: float = 0.5
    """Of the others, where it is not half."""

    def draw(self, rng: np.random.Generator, n: int) -> Starts:
        """Return n starts."""
        starts = self.own.draw(rng, n)
        rows = np.flatnonzero(rng.random(n) < self.share)
        starts.put(rows, self.others.draw(rng, len(rows)))
        return starts


def half_shown(task: Task, worlds: Starts, share: float = 0.5) -> Task:
    """Return a task that varies of whose episodes half, or another share, start with one of these worlds."""
    assert task.sampler is not None, "a task that varies has a sampler"
    return replace(task, sampler=HalfShown(task.sampler, worlds, share))


def along_plan(start: Grid, path: Path, rule_set: RuleSet) -> list[Grid]:
    """Return the worlds that a plan comes by before its last tick, the start left out."""
    rules, grids = Rules(rule_set), [start]
    for tick in read_plan(path, start.n_cars).ticks[:-1]:
        grids.append(rules.tick(grids[-1], tick)[0])
    return grids[1:]


class Guidance(NamedTuple):
    """Either may be absent; the same whenever a run is resumed."""

    starts: Task | None = None
    """The task with other starts."""
    shown: Demonstrations | None = None


def check_guidance(config: TrainConfig, task: Task, starts: Task | None) -> None:
    """Raise InputError where a configuration asks for what does not go together, or not with a task."""
    if starts is not None and (config.explore or config.stages):
        raise InputError("exploration and stages have starts of their own: leave them or starts out")
    if config.shown_share != HALF and (starts is not None or not task.split):
        raise InputError(
            f"shown_share is {config.shown_share} with {'other starts' if starts else task.name}; it is of the plans "
            "that are imitated in a task that varies: leave it out"
        )
    if config.explore and not task.always_starts_the_same:
        raise InputError(f"exploration needs a fixed start, which task '{task.name}' has not: leave it out")


def guidance_of(
    config: TrainConfig, task: Task, starts: Task | None, rng: np.random.Generator, progress: Progress
) -> Guidance:
    """Return what a configuration asks for; given starts replace those along plans."""
    if config.explore:
        return _explored(config, task, rng)
    if config.imitate:
        shown = planned_demonstrations(task, config.imitate, rng, progress)
        return _planned(config, task, shown, rng) if starts is None else Guidance(starts, shown)
    return Guidance(starts)


def _explored(config: TrainConfig, task: Task, rng: np.random.Generator) -> Guidance:
    starts, way = explore(task, config.rules, config.explore, rng)
    shown = None
    if 1 < len(way) <= task.max_steps + 3:
        start = Starts.of(way[:1], targets_of(task.design))
        shown = replayed(task, start, [done_on(way, Rules(config.rules))], config.rules)
    return Guidance(half_from(task, starts), shown)


def _planned(config: TrainConfig, task: Task, shown: Demonstrations, rng: np.random.Generator) -> Guidance:
    if task.split:
        return Guidance(half_shown(task, shown.worlds, config.shown_share), shown)
    some = rng.integers(len(shown.worlds), size=STARTS)
    return Guidance(half_from(task, [shown.worlds.grid(i) for i in some]), shown)
