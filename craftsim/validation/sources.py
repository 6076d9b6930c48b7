"""Worlds by reference, sources of actions, and the trials of every source in every world."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from craftsim.checking.setup import Setup, check_start
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError
from craftsim.experiments.experiment import Trial
from craftsim.learning.policies import PLANNER, RANDOM, Policy, check_policy, policy_digest
from craftsim.learning.policy_files import is_shipped_policy
from craftsim.models.world import PhysicsWorld
from craftsim.planning.plan_file import Plan, read_actions, read_plan
from craftsim.rendering.trajectory import Trajectory
from craftsim.skills.library import check_cars
from craftsim.storage.paths import exists, resolved
from craftsim.storage.writing import writable
from craftsim.tasks import TASK_NAMES, Task, as_task, free_play
from craftsim.validation.options import Rollouts
from craftsim.validation.replanning import Replanning
from craftsim.validation.rollout import PLAY, Behaviour, EpisodeJob, PlanOrder, roll_out
from craftsim.validation.worlds import MAX_RANDOM_CARS, RandomWorlds

AUTO: Final = "auto"
"""The plan that is made, and made again after a failure."""
_SHIPPED: Final = "shipped"
"""Digest of everything that belongs to a version of craftsim."""

WorldSource = Task | Grid | RandomWorlds | str | Path
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

    @property
    def is_fixed(self) -> bool:
        """Whether every episode starts alike: nothing is drawn for its start."""
        if isinstance(self.world, RandomWorlds):
            return False
        rng = np.random.default_rng(0)
        before = rng.bit_generator.state
        as_task(self.world).for_episode(rng).draw(rng)
        return bool(rng.bit_generator.state == before)


class ActionSource(NamedTuple):
    """A source of actions: a plan, an action list or a policy."""

    name: str
    digest: str
    behaviour: Behaviour
    plans: Mapping[str, Plan] = {}
    """Plans of single worlds, by name, in place of the behaviour."""

    @property
    def follows_plan(self) -> bool:
        """Whether actions are decided before a run, so that each of them is predicted."""
        return isinstance(self.behaviour, Plan) or self.behaviour in (PLANNER, PLAY)


def rollout_worlds(
    worlds: Iterable[WorldSource],
    n_cars: int | None = None,
    n_blocks: int | None = None,
    max_steps: int | None = None,
) -> list[RolloutWorld]:
    """Return the worlds for some references.

    ``n_cars`` and ``n_blocks`` set the numbers of things placed at random, ``max_steps`` the length of an episode in
    ``random`` worlds. Raises InputError for an unknown world, and for two of one name.
    """
    referenced = [_rollout_world(world, n_cars, n_blocks, max_steps) for world in worlds]
    for name, count in Counter(world.name for world in referenced).items():
        if count > 1:
            raise InputError(
                f"two worlds are called '{name}'; rename one, or run them one after the other"
            )
    return referenced


def _rollout_world(
    world: WorldSource, n_cars: int | None, n_blocks: int | None, max_steps: int | None
) -> RolloutWorld:
    if isinstance(world, str) and world == RANDOM:
        world = RandomWorlds(n_cars, n_blocks)
        if max_steps is not None:
            world = replace(world, max_steps=max_steps)
    if isinstance(world, RandomWorlds):
        return RolloutWorld(
            RANDOM, world, _digest(repr(world).encode()), world.n_cars or MAX_RANDOM_CARS
        )
    if isinstance(world, Grid):
        world = free_play("grid", (parse_blueprint(blueprint_text(world), "grid"),))
    if isinstance(world, str | Path) and (n_cars is not None or n_blocks is not None):
        world = as_task(str(world), n_cars, n_blocks)
    if isinstance(world, Task):
        return RolloutWorld(world.name, world, world.digest, world.layout.n_cars)
    name = str(world)
    if exists(world) and world not in TASK_NAMES:
        name = str(resolved(world))
    task = as_task(name)
    if name in TASK_NAMES:
        digest = _SHIPPED
    else:
        digest = task.digest
    return RolloutWorld(task.name, name, digest, task.layout.n_cars)


def check_starts(worlds: Iterable[RolloutWorld], setup: Setup, seed: int) -> None:
    """Raise StartError for a user's world in which solids overlap, and InputError for a skill for a missing car."""
    for world in worlds:
        if isinstance(world.world, RandomWorlds):
            continue
        check_cars(setup.skills, world.n_cars)
        if world.world not in TASK_NAMES:
            start = as_task(world.world).draw(np.random.default_rng(seed))
            check_start(PhysicsWorld(start, setup.simulation, machines=setup.machines))


def action_sources(
    rollouts: Rollouts, worlds: Sequence[RolloutWorld], rules: RuleSet, replanning: Replanning
) -> list[ActionSource]:
    """Return the sources of actions that options name; without any, the planner, or in random worlds random play.

    Raises InputError for a plan, an action list or a policy that is invalid or does not fit the worlds.
    """
    if rollouts.plan == AUTO:
        return [replanning_source(replanning, worlds)]
    n_cars = 0
    if worlds:
        n_cars = worlds[0].n_cars
    if rollouts.plan is not None:
        if isinstance(rollouts.plan, Plan):
            plan = rollouts.plan
        else:
            plan = read_plan(Path(rollouts.plan), n_cars)
        return [plan_source(plan)]
    if rollouts.actions is not None:
        return [plan_source(read_actions(Path(rollouts.actions), n_cars))]
    policies: Any = rollouts.policy
    if not policies:
        if all(world.name == RANDOM for world in worlds):
            policies = PLAY
        else:
            policies = PLANNER
    if isinstance(policies, str) or callable(policies):
        policies = [policies]
    return [
        policy_source(policy, worlds, rules, rollouts.timeout_s)
        for policy in dict.fromkeys(policies)
    ]


def plan_source(plan: Plan) -> ActionSource:
    """Return the source of a fixed plan."""
    if plan.after:
        content = (plan.ticks, *plan.after.items())
    else:
        content = plan.ticks
    return ActionSource(writable(plan.path.stem), _digest(repr(content).encode()), plan)


def replanning_source(replanning: Replanning, worlds: Iterable[RolloutWorld]) -> ActionSource:
    """Return the source that plans, and plans again after a failure. Raises InputError for a world without a goal."""
    for world in worlds:
        if not world.has_goal:
            raise InputError(f"{world.name} has no goal to plan for; give a design with --goal")
    return ActionSource(AUTO, _digest(repr(replanning).encode()), replanning)


def policy_source(
    policy: str | Policy,
    worlds: Sequence[RolloutWorld],
    rules: RuleSet = "physical",
    timeout_s: float = 600.0,
) -> ActionSource:
    """Return the source of a policy; a user's policy is tried at the start of each world.

    Raises InputError for an unknown policy, and for one that does not return an action for each agent in time.
    """
    if not isinstance(policy, str):
        name = getattr(policy, "__name__", type(policy).__name__)
        return ActionSource(name, _digest(name.encode()), policy)
    if policy == PLAY:
        return ActionSource(PLAY, _SHIPPED, PLAY)
    if policy == PLANNER:
        return _planner_source(worlds)
    place = policy
    if exists(policy) and not is_shipped_policy(policy):
        place = str(resolved(policy))
    for world in worlds:
        if isinstance(world.world, RandomWorlds):
            task = world.world.task(np.random.default_rng(0))
        else:
            task = as_task(world.world)
        check_policy(place, task, rules, timeout_s)
    return ActionSource(writable(policy), policy_digest(place), place)


def _planner_source(worlds: Sequence[RolloutWorld]) -> ActionSource:
    """Return the source of the shipped plans, and of the planner where there is none."""
    for world in worlds:
        if not world.has_goal:
            raise InputError(
                f"there is no shipped plan for {world.name}, and no goal to plan for; "
                "give a plan with --plan, or a --policy"
            )
    plans = dict[str, Plan]()
    for world in worlds:
        if world.world in TASK_NAMES:
            plans[world.name] = read_plan(shipped_plan(world.name), world.n_cars)
    return ActionSource(PLANNER, _SHIPPED, PLANNER, plans)


def rollout_trials(
    worlds: Iterable[RolloutWorld],
    sources: Iterable[ActionSource],
    trials: int,
    seed: int,
    setup: Setup,
    **terms: Any,
) -> Iterator[Trial]:
    """Yield all trials: every source of actions in every world; ``terms`` are further fields of
    :class:`EpisodeJob`.

    Where nothing is drawn at random all trials are identical, and the first stands for all.
    """
    worlds = list(worlds)
    fixed = set[str]()
    if trials > 1 and not setup.draws:
        fixed = {world.name for world in worlds if world.is_fixed}
    for episode, world, source in product(range(trials), worlds, sources):
        key = f"{world.name}/{source.name}/{episode:04d}"
        behaviour = source.plans.get(world.name, source.behaviour)
        identical = 1
        if world.name in fixed and isinstance(behaviour, Plan):
            if episode > 0:
                continue
            identical = trials
        job = EpisodeJob(
            key=key,
            world=world.world,
            behaviour=behaviour,
            episode=episode,
            identical=identical,
            seed=seed,
            setup=setup,
            **terms,
        )
        yield Trial(key, source.name, seed, job, world.name, episode)


def read_goal(start: str, goal: Path | None) -> Task:
    """Return a task, with its goal replaced by the design in a file, if given.

    Raises InputError for invalid files, and without a goal.
    """
    task = as_task(start)
    if goal is not None:
        return replace(task, design=read_design(goal), success="built")
    if not task.has_goal:
        raise InputError(f"{start} has no goal; give a design with --goal")
    return task


def record_once(
    world: WorldSource,
    setup: Setup,
    seed: int,
    *,
    plan: Path | None = None,
    policy: str | None = None,
    order: PlanOrder = "concurrent",
) -> Trajectory:
    """Run a plan (default: the shipped one) or a policy in a world once, and return its trajectory.

    Raises InputError if there is no plan, and for an invalid file.
    """
    worlds = rollout_worlds([world])
    if plan is None:
        source = policy_source(policy or PLANNER, worlds, setup.rules)
    elif policy is not None:
        raise InputError("--plan and --policy exclude each other; give one of them")
    else:
        source = plan_source(read_plan(plan, worlds[0].n_cars))
    (trial,) = rollout_trials(worlds, [source], 1, seed, setup, order=order, record=True)
    trajectory = roll_out(trial.job).trajectory
    assert trajectory is not None
    return trajectory


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
