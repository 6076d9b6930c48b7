"""One run of a plan, of a list of actions or of a policy, in physics and by the rules alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from craftsim.checking.attempt import Attempt, Result, attempt_of
from craftsim.checking.recipe import Recipe, Seed, Step
from craftsim.checking.settings import TrialSettings
from craftsim.discrete.actions import Action
from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.discrete.tasks import TASK_NAMES, Task, make_task
from craftsim.discrete.tasks.measures import Complexity
from craftsim.discrete.tasks.rewards import Reward
from craftsim.envs.options import Options
from craftsim.envs.parallel import ParallelConstruction
from craftsim.validation.campaign import Done
from craftsim.validation.replays.bundle import write_bundle
from craftsim.validation.runs.backend import CheckedBackend
from craftsim.validation.runs.policies import Policy, make_policy

BUNDLES: Final = "bundles"


@dataclass(frozen=True)
class Terms:
    """What all runs of a validation have in common."""

    seed: int
    settings: TrialSettings
    rules: RuleSet
    out: Path
    """Folder of the campaign."""


@dataclass(frozen=True)
class Run:
    """What to run; goes to a worker."""

    key: str
    place: str
    """Name of a shipped task, or path of a blueprint."""
    plan: tuple[Step, ...] | None
    """What to do, whatever comes of it; None asks the policy."""
    policy: str
    episode: int
    """Decides, with the seed, all that is drawn; the same for all plans and policies, so that they can be compared."""
    terms: Terms

    @property
    def file_name(self) -> str:
        """The key as a name of a file."""
        return re.sub(r"[^\w.-]+", "-", self.key)


@dataclass(frozen=True)
class _Seeds:
    """What the parts of a run are drawn from."""

    world: int
    """The start, and the orders in which the cars act."""
    policy: int
    physics: Seed
    sensors: Seed

    @classmethod
    def of(cls, run: Run) -> _Seeds:
        world, policy, physics, sensors = np.random.SeedSequence([run.terms.seed, run.episode]).spawn(4)
        world_number, policy_number = (int(s.generate_state(1)[0]) for s in (world, policy))
        return cls(world_number, policy_number, Seed.of(physics), Seed.of(sensors))


def read_task(place: str) -> Task:
    """Return a shipped task by its name, or one without a goal around a blueprint of one's own.

    Raises BlueprintError for a file that is none.
    """
    if place in TASK_NAMES:
        return make_task(place)
    blueprint = read_blueprint(Path(place))
    return Task(
        name=blueprint.path.stem,
        starts=(blueprint,),
        reward=Reward(Complexity()),
        success=lambda grid: False,
        ends_on_success=False,
    )


def do_run(run: Run) -> Done:
    """Run in physics, and by the rules alone; write the bundle of the first disagreement, if there is one."""
    task, seeds, terms = read_task(run.place), _Seeds.of(run), run.terms
    backend = CheckedBackend(_start(run, task, seeds))
    if run.plan is not None:
        reached = _follow(run.plan, task, backend)
        by_rules = _predict(run.plan, task, seeds, terms.rules)
    else:
        options = Options("grid", rule_set=terms.rules)
        reached = _play(task, options, run.policy, seeds, backend)
        by_rules = _play(task, options, run.policy, seeds)
    steps = [[attempt_of(record, terms.settings.thresholds) for record in step] for step in backend.records]
    # What a policy asks for and the rules forbid at the car's turn does nothing in either world.
    attempts = [a for step in steps for a in step if a.legal or run.plan is not None]
    extra: dict[str, Any] = {"ticks": len(steps), "forbidden": sum(not a.legal for s in steps for a in s)}
    if run.place in TASK_NAMES:
        extra |= {"grid_success": by_rules, "physics_success": reached}
    return Done(
        agrees=all(a.result == Result.AS_PREDICTED for a in attempts),
        attempts=attempts,
        bundle=_bundle(run, backend.recipe, steps),
        extra=extra,
    )


def start_recipe(run: Run) -> Recipe:
    """Return the recipe of a run's start."""
    return _start(run, read_task(run.place), _Seeds.of(run))


def _start(run: Run, task: Task, seeds: _Seeds) -> Recipe:
    recipe = Recipe.of(_draw(task, seeds), (), run.terms.settings)
    return replace(recipe, rules=run.terms.rules, physics=seeds.physics, sensors=seeds.sensors)


def _draw(task: Task, seeds: _Seeds) -> Grid:
    """Return the start that an environment draws from the same seed."""
    return task.draw(np.random.default_rng(np.random.SeedSequence(seeds.world).spawn(2)[0]))


def _follow(plan: Sequence[Step], task: Task, backend: CheckedBackend) -> bool:
    """Carry out a plan, each step from what was read before it; return whether the goal is reached."""
    for step in plan:
        backend.perform(step)
        if backend.problems:
            return False
    return task.succeeded(backend.grid)


def _predict(plan: Sequence[Step], task: Task, seeds: _Seeds, rules: RuleSet) -> bool:
    """Return whether a plan reaches the goal by the rules alone."""
    by_rules, grid = Rules(rules), _draw(task, seeds)
    for step in plan:
        for act in step.acts:
            action = Action[act.action]
            if by_rules.legal(grid, act.car, action):
                grid = by_rules.apply(grid, act.car, action)
    return task.succeeded(grid)


def _play(
    task: Task, options: Options, policy_name: str, seeds: _Seeds, backend: CheckedBackend | None = None
) -> bool:
    """Let a policy play an episode; return whether it ends in success."""
    policy: Policy = make_policy(policy_name, seeds.policy)
    env = ParallelConstruction(task, options, backend)
    observations, _ = env.reset(seed=seeds.world)
    success = False
    while env.agents:
        observations, _, _, _, infos = env.step(policy(observations))
        success = all(info["success"] for info in infos.values())
    return success


def _bundle(run: Run, recipe: Recipe, steps: Sequence[Sequence[Attempt]]) -> str | None:
    """Write the bundle of the first step in which something allowed did not go as predicted; return its folder."""
    for number, attempts in enumerate(steps, start=1):
        if any(a.legal and a.result != Result.AS_PREDICTED for a in attempts):
            folder = f"{BUNDLES}/{run.file_name}"
            until = replace(recipe, steps=recipe.steps[:number])
            write_bundle(run.terms.out / folder, run.key, until, tuple(attempts))
            return folder
    return None
