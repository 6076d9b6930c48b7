"""An episode of a plan, a list of actions, a policy, random play or a planner, in physics and by the rules alone."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, get_args

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.judge import Judge
from craftsim.checking.recipe import OnAttempts, Recipe, Step, Watch, perform_step, unwatched
from craftsim.checking.setup import Seed, SetUp, Setup, set_up
from craftsim.discrete.files.blueprint import blueprint_text, write_blueprint
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import TeamAction
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.discrete.schedule import Constraints
from craftsim.errors import InputError, StartError, check_choice
from craftsim.experiments.bundle import write_bundle
from craftsim.experiments.experiment import Result
from craftsim.learning.policies import PLANNER, Policy, make_policy
from craftsim.planning.plan_file import Plan, read_plan, write_plan
from craftsim.rendering.trajectory import SUFFIX, TRAJECTORIES, Recorder
from craftsim.robots.log import LogRecorder
from craftsim.robots.log_files import LOG_SUFFIX, write_table
from craftsim.skills.executor import Observer
from craftsim.storage.folders import directory_within
from craftsim.tasks import TASK_NAMES, Task, as_task
from craftsim.validation.episode import Episode
from craftsim.validation.options import PlanOrder as PlanOrder
from craftsim.validation.play import covered, play
from craftsim.validation.replanning import Replanner, Replanning
from craftsim.validation.worlds import RandomWorlds

if TYPE_CHECKING:
    from craftsim.envs.physics_backend import PhysicsBackend

BUNDLES: Final = "bundles"
_WORLDS: Final = "worlds"
PLAY: Final = "play"
"""Random legal play, weighted towards rare actions: a plan that each run draws for its world."""

Behaviour = Plan | Replanning | str | Policy
"""What decides actions: a plan, a planner with replanning, or a policy, by its name or a function; :data:`PLAY` is
random play."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeJob:
    """What is to be run in one :class:`craftsim.validation.episode.Episode`; sent to a worker."""

    key: str
    world: Task | str | RandomWorlds
    behaviour: Behaviour
    episode: int = 0
    """Index that, with the seed, determines all random draws; equal for all plans and policies, which pairs them."""
    identical: int = 1
    """Number of trials that this one stands for, as nothing is drawn at random."""
    seed: int
    setup: Setup
    out: Path | None = None
    """Folder of the validation, for bundles."""
    replans: int = 0
    """Plans with which the planner goes on where a policy gets no further, at most."""
    order: PlanOrder = "concurrent"
    """Execution of the plan, also of the one that random play draws for its world."""
    observers: tuple[Observer, ...] = ()
    record: bool = False
    set_up: SetUp = set_up
    """Sets up a plan's world: simulated here, or remote robots."""


def steps_of(
    ticks: Sequence[TeamAction], order: PlanOrder, after: Constraints | None = None
) -> tuple[Step, ...]:
    """Return the steps of a plan's ticks and of its order constraints."""
    check_choice("order", order, get_args(PlanOrder))
    after = after or {}
    if order == "concurrent":
        return (Step.of_ticks(0, *ticks, order=order, after=after),)
    numbered = [(tick, team_action) for tick, team_action in enumerate(ticks) if team_action]
    steps = []
    if order == "sequential":
        for tick, team_action in numbered:
            for car, action in team_action:
                steps.append(Step.single(tick, car, action))
        return tuple(steps)
    assert order == "ticks"
    for tick, team_action in numbered:
        # Of a tick alone, whose number is then 0; order constraints between ticks hold anyway.
        constraints = {}
        for car, _ in team_action:
            constraints[0, car] = [(0, c) for at, c in after.get((tick, car), ()) if at == tick]
        steps.append(Step.of_ticks(tick, team_action, after=constraints))
    return tuple(steps)


def run_job(job: EpisodeJob) -> Result:
    """Run in physics and by the rules alone; write the bundle of the first disagreement, if any."""
    try:
        episode = roll_out(job)
    except StartError as error:
        if job.behaviour != PLAY:
            raise
        nothing = {"ticks": 0, "forbidden": 0, "makespan_s": 0.0}
        return Result(agrees=False, extra=nothing | {"does_not_stand": str(error)})
    extra: dict[str, Any] = {
        "ticks": episode.n_ticks,
        "forbidden": len(episode.forbidden),
        "makespan_s": episode.makespan_s,
        **(episode.ending or {}),
    }
    if job.identical > 1:
        extra["identical"] = job.identical
    if episode.recovery is not None:
        extra["recovery"] = episode.recovery
    if episode.reached is not None:
        extra |= {"grid_success": episode.reached_by_rules, "physics_success": episode.reached}
    if job.behaviour == PLAY:
        rules = Rules(job.setup.rules)
        extra["coverage"] = covered(episode.start, episode.ticks or (), rules, episode.attempts)
    # What a policy asks for, and the rules forbid at the car's turn, does nothing in either world; so does what random
    # play would have done had all before gone as predicted.
    follows_plan = isinstance(job.behaviour, Plan)
    # What is left of a plan when another one takes its place says nothing of any action.
    unperformed = not isinstance(job.behaviour, Replanning)
    bundle = None
    if job.out is not None:
        bundle = _write(job, episode, job.out)
    attempts = []
    for attempt in episode.attempts:
        if (attempt.legal or follows_plan) and (unperformed or attempt.performed):
            attempts.append(attempt)
    return Result(
        agrees=episode.agrees and not (follows_plan and episode.forbidden),
        attempts=attempts,
        bundle=bundle,
        extra=extra,
    )


def _write(job: EpisodeJob, episode: Episode, out: Path) -> str | None:
    """Write recordings, random world, and the bundle of the first disagreement; return the bundle's folder."""
    name = re.sub(r"[^\w.-]+", "-", job.key)
    if episode.trajectory is not None:
        folder = directory_within(out, TRAJECTORIES)
        episode.trajectory.write(folder / f"{name}{SUFFIX}")
        write_table(folder / f"{name}{LOG_SUFFIX}", episode.logs)
    if job.behaviour == PLAY and episode.n_planned:
        folder = directory_within(out, _WORLDS)
        write_blueprint(episode.start, folder / f"{name}.yaml")
        write_plan(episode.ticks or (), folder / f"{name}.plan")
    number = episode.first_disagreement
    if number is None:
        return None
    bundle = f"{BUNDLES}/{name}"
    write_bundle(out / bundle, job.key, episode.until(number), episode.steps[number])
    return bundle


def roll_out(job: EpisodeJob, watch: Watch = unwatched) -> Episode:
    """Return an episode in physics and by the rules alone.

    Raises StartError for an invalid world, and NoPlanError if a planner finds no plan from the start.
    """
    world_seed, policy_seed = np.random.SeedSequence([job.seed, job.episode]).spawn(2)
    world_number = int(world_seed.generate_state(1)[0])
    policy_number = int(policy_seed.generate_state(1)[0])
    # As an environment spawns them from the same seed.
    start_seed, physics_seed = np.random.SeedSequence(world_number).spawn(2)
    start_rng = np.random.default_rng(start_seed)
    world = job.world
    if isinstance(world, RandomWorlds):
        world = world.task(np.random.default_rng(world_number))
    task = as_task(world).for_episode(start_rng)
    start = task.draw(start_rng)
    recorder = Recorder()
    logs = list[LogRecorder]()

    def begin(judge: Judge) -> OnAttempts:
        judge.executor.observers.extend(job.observers)
        if job.behaviour == PLAY and not judge.grid.same_visible(start):
            raise StartError("this world cannot be: it reads otherwise than it was drawn")
        if job.record:
            recorder.begin(judge)
            logs.append(LogRecorder(judge.executor))
        return watch(judge)

    seed = Seed.drawn(np.random.default_rng(physics_seed))
    behaviour = job.behaviour
    if behaviour == PLAY:
        rng = np.random.default_rng(policy_number)
        behaviour = Plan(Path(PLAY), play(start, Rules(job.setup.rules), rng, task.max_steps + 2))
    if isinstance(behaviour, Plan):
        episode = _execute(job, behaviour, task, start, seed, begin)
    elif isinstance(behaviour, Replanning):
        planner = Replanner(task, start, behaviour, job.setup, policy_number)
        episode = _build(job, planner, seed, begin)
    else:
        episode = _run_policy(
            behaviour, task, start, job.setup, (world_number, policy_number), job.replans, begin
        )
    if not job.record:
        return episode
    trajectory = recorder.trajectory(job.key, episode.recipe, episode.attempts, task.design)
    return replace(episode, trajectory=trajectory, logs=logs[-1].logs())


def _execute(
    job: EpisodeJob, plan: Plan, task: Task, start: Grid, seed: Seed, begin: Watch
) -> Episode:
    """Execute a plan step by step, each from the world read before it, as long as that can be read."""
    recipe = Recipe(blueprint_text(start), (), job.setup, seed, tuple(task.goal_cells))
    judge = job.set_up(start, recipe.setup, recipe.seed, recipe.goals)
    on_attempts = begin(judge)
    performed: list[tuple[Attempt, ...]] = []
    for step in steps_of(plan.ticks, job.order, plan.after):
        recipe = recipe.then(step)
        performed.append(perform_step(judge, step))
        on_attempts(performed[-1])
        if judge.problems:
            break
    reached = None
    reached_by_rules = None
    if task.has_goal:
        reached = not judge.problems and task.succeeded(judge.grid)
        reached_by_rules = task.succeeded(_predicted_end(start, plan, Rules(job.setup.rules)))
    return Episode(
        task=task,
        start=start,
        ticks=plan.ticks,
        recipe=recipe,
        steps=tuple(performed),
        reached=reached,
        reached_by_rules=reached_by_rules,
        end_s=judge.physics.time_s,
        problems=judge.problems,
    )


def _predicted_end(grid: Grid, plan: Plan, rules: Rules) -> Grid:
    """Return the world after all actions of a plan that the rules allow when their turn comes."""
    for tick in plan.ticks:
        for car, action in tick:
            if rules.legal(grid, car, action):
                grid = rules.apply(grid, car, action)
    return grid


def _build(job: EpisodeJob, planner: Replanner, seed: Seed, begin: Watch) -> Episode:
    """Execute the steps of a planner, which plans again after a failure."""
    task = planner.task
    recipe = Recipe(blueprint_text(planner.grid), (), planner.setup, seed, tuple(task.goal_cells))
    judge = job.set_up(planner.grid, recipe.setup, recipe.seed, recipe.goals)
    on_attempts = begin(judge)
    performed: list[tuple[Attempt, ...]] = []
    for step in planner.steps(judge, performed):
        recipe = recipe.then(step)
        performed.append(perform_step(judge, step))
        on_attempts(performed[-1])
    reached, reached_by_rules, ending = planner.end(judge)
    return Episode(
        task=task,
        start=planner.grid,
        recipe=recipe,
        steps=tuple(performed),
        reached=reached,
        reached_by_rules=reached_by_rules,
        end_s=judge.physics.time_s,
        problems=judge.problems,
        ending=ending,
    )


def _run_policy(
    policy: str | Policy,
    task: Task,
    start: Grid,
    setup: Setup,
    seeds: tuple[int, int],
    replans: int,
    begin: Watch,
) -> Episode:
    """Run a policy for one episode in physics and, with a goal, one by the rules alone; both with as many plans."""
    from craftsim.envs.options import Options
    from craftsim.envs.physics_backend import PhysicsBackend

    backend = PhysicsBackend(setup, Options(check_contacts=True), task)
    recovery = dict[str, Any]()
    reached: bool | None = _reaches_goal(
        policy, task, setup.rules, seeds, replans, recovery, backend, begin
    )
    reached_by_rules = None
    if task.has_goal:
        reached_by_rules = _reaches_goal(policy, task, setup.rules, seeds, replans, {})
    else:
        reached = None
    judge = backend.judge
    return Episode(
        task=task,
        start=start,
        recipe=backend.recipe,
        steps=tuple(backend.ticks),
        reached=reached,
        reached_by_rules=reached_by_rules,
        end_s=judge.physics.time_s,
        problems=judge.problems,
        recovery=recovery or None,
    )


def _reaches_goal(
    policy: str | Policy,
    task: Task,
    rules: RuleSet,
    seeds: tuple[int, int],
    replans: int,
    recovery: dict[str, Any],
    backend: PhysicsBackend | None = None,
    begin: Watch = unwatched,
) -> bool:
    """Run a policy for one episode, on the grid unless there is a ``backend``; return whether it succeeds.

    ``seeds`` are those of the world and of the policy. With ``replans`` the planner goes on where the policy gets no
    further, and what that took in physics is added to ``recovery``.
    """
    from craftsim.envs.options import Options
    from craftsim.envs.parallel import ParallelConstruction
    from craftsim.envs.planner import PlannerPolicy

    env = ParallelConstruction(task, Options("grid", rule_set=rules), backend)
    if policy == PLANNER:
        policy = PlannerPolicy(env)
    elif isinstance(policy, str):
        policy = make_policy(policy, seeds[1], task)
    planner = None
    if replans:
        planner = PlannerPolicy(env, policy=policy, most_plans=replans)
        policy = planner
    observations, _ = env.reset(seed=seeds[0])
    on_attempts = None
    if backend is not None:
        on_attempts = begin(backend.judge)
    success = False
    while env.agents:
        observations, _, _, _, infos = env.step(policy(observations))
        success = all(info["success"] for info in infos.values())
        if backend is not None and on_attempts is not None:
            on_attempts(backend.ticks[-1])
    if planner is not None and backend is not None:
        recovery["replaces"] = planner.replaces
        recovery["plans"] = planner.n_plans
        recovery["seated"] = backend.n_seated
    return success


def planned_task(
    name: str, plan: Path | None = None, goal: Path | None = None
) -> tuple[Task, Plan]:
    """Return a task with its plan, its own or that of a file, and with the design in the file ``goal``, if given.

    Raises InputError for an invalid file, and if there is no plan for this task.
    """
    task = as_task(name)
    if plan is None and task.name not in TASK_NAMES:
        raise InputError(
            f"there is no shipped plan for {name}; give one with --plan "
            f"(shipped ones: {', '.join(TASK_NAMES)})"
        )
    if goal is not None:
        task = replace(task, design=read_design(goal), success="built")
    return task, read_plan(plan or shipped_plan(task.name), task.layout.n_cars)


def run_plan(
    task: Task,
    plan: Plan | Replanning,
    setup: Setup,
    seed: int,
    order: PlanOrder,
    watch: Watch = unwatched,
    set_up_world: SetUp = set_up,
) -> Episode:
    """Execute a plan in a world that ``set_up_world`` sets up, and return the episode with its recordings.

    With :class:`Replanning` plans are made, and made again after a failure.
    """
    job = EpisodeJob(
        key=task.name,
        world=task,
        behaviour=plan,
        seed=seed,
        setup=setup,
        order=order,
        record=True,
        set_up=set_up_world,
    )
    return roll_out(job, watch)
