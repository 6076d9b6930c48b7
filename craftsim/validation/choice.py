"""The worlds of a validation, and the plans, action lists or policies that are executed in them."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from craftsim.checking.setup import Setup, check_start
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.files.plan import Plan, read_plan
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import RuleSet
from craftsim.discrete.tasks import TASK_NAMES, Task, as_task, free_play
from craftsim.errors import InputError
from craftsim.experiments.experiment import Trial
from craftsim.models.world import PhysicsWorld
from craftsim.skills.library import check_cars
from craftsim.storage.paths import exists, resolved
from craftsim.storage.writing import writable
from craftsim.training.policy import is_shipped_policy
from craftsim.validation.policies import PLANNER, RANDOM, Policy, check_policy, policy_digest
from craftsim.validation.replanning import Replanning
from craftsim.validation.rollout import PLAY as PLAY
from craftsim.validation.rollout import By, PlanOrder, Run, steps_of
from craftsim.validation.worlds import MAX_CARS, RandomWorlds

AUTO: Final = "auto"
"""The plan that is made, and made again after a failure."""
SHIPPED: Final = "shipped"
"""Digest of everything that belongs to a version of craftsim."""

World = Task | Grid | RandomWorlds | str | Path
"""A task, a start without a goal, or a reference: a task's name, a file, ``module:factory``, or ``random``."""


class RolloutWorld(NamedTuple):
    """A world to run in."""

    name: str
    world: Task | str | RandomWorlds
    digest: str
    n_cars: int

    @property
    def has_goal(self) -> bool:
        """Whether it has a goal."""
        return not isinstance(self.world, RandomWorlds) and as_task(self.world).has_goal


class PolicySpec(NamedTuple):
    """A source of actions: a plan, an action list or a policy."""

    name: str
    digest: str
    by: By
    plans: Mapping[str, By] = {}


def subjects_of(
    worlds: Iterable[World],
    n_cars: int | None = None,
    n_blocks: int | None = None,
    max_steps: int | None = None,
) -> list[RolloutWorld]:
    """Return the worlds for some references.

    ``n_cars`` and ``n_blocks`` set the numbers of things placed at random, ``max_steps`` the length of an episode in
    ``random`` worlds. Raises InputError for an unknown world, and for two of one name.
    """
    found = [_subject(world, n_cars, n_blocks, max_steps) for world in worlds]
    for name, number in Counter(one.name for one in found).items():
        if number > 1:
            raise InputError(f"two worlds are called '{name}'; rename one, or run them one after the other")
    return found


def _subject(world: World, n_cars: int | None, n_blocks: int | None, max_steps: int | None) -> RolloutWorld:
    if isinstance(world, str) and world == RANDOM:
        world = RandomWorlds(n_cars, n_blocks, RandomWorlds.max_steps if max_steps is None else max_steps)
    if isinstance(world, RandomWorlds):
        return RolloutWorld(RANDOM, world, _digest(repr(world).encode()), world.n_cars or MAX_CARS)
    if isinstance(world, Grid):
        world = free_play("grid", (parse_blueprint(blueprint_text(world), "grid"),))
    if isinstance(world, str | Path) and (n_cars is not None or n_blocks is not None):
        world = as_task(str(world), n_cars, n_blocks)
    if isinstance(world, Task):
        return RolloutWorld(world.name, world, world.digest, world.layout.n_cars)
    name = str(resolved(world)) if exists(world) and world not in TASK_NAMES else str(world)
    task = as_task(name)
    digest = SHIPPED if name in TASK_NAMES else task.digest
    return RolloutWorld(task.name, name, digest, task.layout.n_cars)


def check_starts(subjects: Sequence[RolloutWorld], setup: Setup, seed: int) -> None:
    """Raise StartError for a user's world in which solids overlap, and InputError for a skill for a missing car."""
    for _, world, _, n_cars in subjects:
        if isinstance(world, RandomWorlds):
            continue
        check_cars(setup.skills, n_cars)
        if world not in TASK_NAMES:
            start = as_task(world).draw(np.random.default_rng(seed))
            check_start(PhysicsWorld(start, setup.simulation, machines=setup.machines))


def plan_pilot(plan: Plan, order: PlanOrder) -> PolicySpec:
    """Return the source of a fixed plan."""
    said = (plan.ticks, *plan.after.items()) if plan.after else plan.ticks
    steps = steps_of(plan.ticks, order, plan.after)
    return PolicySpec(writable(plan.path.stem), _digest(repr(said).encode()), steps)


def replanning_pilot(replanning: Replanning, subjects: Sequence[RolloutWorld]) -> PolicySpec:
    """Return the source that plans, and plans again after a failure. Raises InputError for a world without a goal."""
    for subject in subjects:
        if not subject.has_goal:
            raise InputError(f"{subject.name} has no goal to plan for; give a design with --goal")
    return PolicySpec(AUTO, _digest(repr(replanning).encode()), replanning)


def policy_pilot(
    policy: str | Policy,
    subjects: Sequence[RolloutWorld],
    order: PlanOrder,
    rules: RuleSet = "physical",
    timeout_s: float = 600.0,
) -> PolicySpec:
    """Return the source of a policy; a user's policy is tried at the start of each world.

    Raises InputError for an unknown policy, and for one that does not return an action for each agent in time.
    """
    if not isinstance(policy, str):
        name = getattr(policy, "__name__", type(policy).__name__)
        return PolicySpec(name, _digest(name.encode()), policy)
    if policy == PLAY:
        return PolicySpec(PLAY, SHIPPED, PLAY)
    if policy != PLANNER:
        own = exists(policy) and not is_shipped_policy(policy)
        place = str(resolved(policy)) if own else policy
        for _, world, _, _ in subjects:
            task = world.task(np.random.default_rng(0)) if isinstance(world, RandomWorlds) else as_task(world)
            check_policy(place, task, rules, timeout_s)
        return PolicySpec(writable(policy), policy_digest(place), place)
    for subject in subjects:
        if not subject.has_goal:
            raise InputError(
                f"there is no shipped plan for {subject.name}, and no goal to plan for; "
                "give a plan with --plan, or a --policy"
            )
    shipped = [subject for subject in subjects if subject.world in TASK_NAMES]
    plans = {s.name: steps_of(read_plan(shipped_plan(s.name), s.n_cars).ticks, order) for s in shipped}
    return PolicySpec(PLANNER, SHIPPED, PLANNER, plans)


def items_of(
    subjects: Sequence[RolloutWorld],
    pilots: Sequence[PolicySpec],
    trials: int,
    seed: int,
    setup: Setup,
    **terms: Any,
) -> Iterator[Trial]:
    """Yield all trials: every source of actions in every world; ``terms`` are further fields of :class:`Run`."""
    for episode, (name, world, *_), pilot in product(range(trials), subjects, pilots):
        key, by = f"{name}/{pilot.name}/{episode:04d}", pilot.plans.get(name, pilot.by)
        run = Run(key=key, world=world, by=by, episode=episode, seed=seed, setup=setup, **terms)
        yield Trial(key, pilot.name, seed, run, name, episode)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
