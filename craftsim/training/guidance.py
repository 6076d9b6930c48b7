"""What a run is given beside its task: other starts to train from, and what it imitates before it learns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import Task
from craftsim.discrete.tasks.starts import Starts, targets_of
from craftsim.errors import InputError
from craftsim.training.config import HALF, TrainConfig
from craftsim.training.demonstrations import (
    Demonstrations,
    Progress,
    planned_demonstrations,
    replayed,
)
from craftsim.training.exploration import STARTS, done_on, explore
from craftsim.training.starts import half_from, half_shown


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
    """Return what a configuration asks for; starts that are given stand in for those on the way of plans."""
    if config.explore:
        return _explored(config, task, rng)
    if config.imitate:
        shown = planned_demonstrations(task, config.imitate, rng, progress)
        return _planned(config, task, shown, rng) if starts is None else Guidance(starts, shown)
    return Guidance(starts)


def _explored(config: TrainConfig, task: Task, rng: np.random.Generator) -> Guidance:
    found = explore(task, config.rules, config.explore, rng)
    shown = None
    if 1 < len(found.way) <= task.max_steps + 3:
        start = Starts.of(found.way[:1], targets_of(task.design))
        shown = replayed(task, start, [done_on(found.way, Rules(config.rules))], config.rules)
    return Guidance(half_from(task, found.starts), shown)


def _planned(config: TrainConfig, task: Task, shown: Demonstrations, rng: np.random.Generator) -> Guidance:
    if task.split:
        return Guidance(half_shown(task, shown.worlds, config.shown_share), shown)
    some = rng.integers(len(shown.worlds), size=STARTS)
    return Guidance(half_from(task, [shown.worlds.grid(i) for i in some]), shown)
