"""An episode of a plan, a list of actions, a policy, random play or a planner, in physics and by the rules alone."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.episode import Episode, OnAttempts, Recipe, Step, Watch, do, unwatched
from craftsim.checking.judge import Judge
from craftsim.checking.setup import Seed, SetUp, Setup, set_up
from craftsim.choices import PlanOrder as PlanOrder
from craftsim.discrete.files.blueprint import blueprint_text, write_blueprint
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.plan import Plan, read_plan, write_plan
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Constraints
from craftsim.discrete.tasks import TASK_NAMES, Task, as_task
from craftsim.errors import InputError, StartError, check_choice
from craftsim.experiments.bundle import write_bundle
from craftsim.experiments.experiment import Result
from craftsim.logs.files import LOG_SUFFIX, write_table
from craftsim.logs.log import Log, LogRecorder
from craftsim.rendering.trajectory import SUFFIX, TRAJECTORIES, Recorder, Trajectory
from craftsim.skills.executor import Observer
from craftsim.storage.folders import directory_within
from craftsim.validation.play import Joint, covered, play
from craftsim.validation.policies import PLANNER, Policy, make_policy
from craftsim.validation.replanning import Replanner, Replanning
from craftsim.validation.worlds import RandomWorlds

BUNDLES: Final = "bundles"
WORLDS: Final = "worlds"
PLAY: Final = "play"
"""Random legal play, weighted towards rare actions: a plan that each run draws for its world."""


By = tuple[Step, ...] | Replanning | str | Policy
"""A source of actions: the steps of a plan, a planner with replanning, or a policy; :data:`PLAY` is random play."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One run; sent to a worker."""

    key: str
    world: Task | str | RandomWorlds
    by: By
    episode: int = 0
    """Index that, with the seed, determines all random draws; equal for all plans and policies, which pairs them."""
    identical: int = 1
    """Number of trials that this one stands for, as nothing is drawn at random."""
    seed: int
    setup: Setup
    out: Path | None = None
    """Folder of the validation, for bundles."""
    order: PlanOrder = "concurrent"
    """Execution of the plan that random play draws for its world."""
    observers: tuple[Observer, ...] = ()
    record: bool = False
    set_up: SetUp = set_up
    """Sets up a plan's world: simulated here, or remote robots."""


@dataclass(frozen=True)
class RolloutResult:
    """An episode with its recordings, if any."""

    task: Task
    start: Grid
    played: Sequence[Joint] | None
    episode: Episode
    trajectory: Trajectory | None = None
    logs: Mapping[int, Log] = field(default_factory=dict)


def steps_of(
    ticks: Sequence[Sequence[tuple[int, Action]]], order: PlanOrder, after: Constraints | None = None
) -> tuple[Step, ...]:
    """Return the steps of a plan's ticks, each with (car, action) in acting order, and its order constraints."""
    check_choice("order", order, get_args(PlanOrder))
    after = after or {}
    if order == "concurrent":
        return (Step.joint(0, *ticks, order=order, after=after),)
    numbered = [(tick, joint) for tick, joint in enumerate(ticks) if joint]
    if order == "sequential":
        return tuple(Step.single(tick, *act) for tick, joint in numbered for act in joint)
    assert order == "ticks"
    steps = []
    for tick, joint in numbered:
        # Of a tick alone, whose number is then 0; order constraints between ticks hold anyway.
        within = {
            (0, car): [(0, c) for at, c in after.get((tick, car), ()) if at == tick] for car, _ in joint
        }
        steps.append(Step.joint(tick, joint, after=within))
    return tuple(steps)


def do_run(run: Run) -> Result:
    """Run in physics and by the rules alone; write the bundle of the first disagreement, if any."""
    try:
        done = roll_out(run)
    except StartError as error:
        if run.by != PLAY:
            raise
        nothing = {"ticks": 0, "forbidden": 0, "makespan_s": 0.0}
        return Result(agrees=False, extra=nothing | {"does_not_stand": str(error)})
    episode = done.episode
    extra: dict[str, Any] = {
        "ticks": episode.n_ticks,
        "forbidden": len(episode.forbidden),
        "makespan_s": episode.makespan_s,
        **(episode.ending or {}),
    }
    if run.identical > 1:
        extra["identical"] = run.identical
    if episode.reached is not None:
        extra |= {"grid_success": episode.reached_by_rules, "physics_success": episode.reached}
    if done.played is not None:
        extra["coverage"] = covered(done.start, done.played, Rules(run.setup.rules), episode.attempts)
    # What a policy asks for, and the rules forbid at the car's turn, does nothing in either world; so does what random
    # play would have done had all before gone as predicted.
    follows = isinstance(run.by, tuple)
    # What is left of a plan when another one takes its place says nothing of any action.
    unperformed = not isinstance(run.by, Replanning)
    return Result(
        agrees=episode.agrees and not (follows and episode.forbidden),
        attempts=[a for a in episode.attempts if (a.legal or follows) and (unperformed or a.performed)],
        bundle=None if run.out is None else _write(run, done, run.out),
        extra=extra,
    )


def _write(run: Run, done: RolloutResult, out: Path) -> str | None:
    """Write recordings, random world, and the bundle of the first disagreement; return the bundle's folder."""
    name = re.sub(r"[^\w.-]+", "-", run.key)
    if done.trajectory is not None:
        folder = directory_within(out, TRAJECTORIES)
        done.trajectory.write(folder / f"{name}{SUFFIX}")
        write_table(folder / f"{name}{LOG_SUFFIX}", done.logs)
    if done.played is not None and any(done.played):
        folder = directory_within(out, WORLDS)
        write_blueprint(done.start, folder / f"{name}.yaml")
        write_plan(done.played, folder / f"{name}.plan")
    number = done.episode.first_disagreement
    if number is None:
        return None
    bundle = f"{BUNDLES}/{name}"
    write_bundle(out / bundle, run.key, done.episode.until(number), done.episode.steps[number])
    return bundle


def roll_out(run: Run, watch: Watch = unwatched) -> RolloutResult:
    """Return an episode in physics and by the rules alone.

    Raises StartError for an invalid world, and NoPlanError if a planner finds no plan from the start.
    """
    by, setup = run.by, run.setup
    world_seed, policy_seed = np.random.SeedSequence([run.seed, run.episode]).spawn(2)
    number, policy_number = (int(s.generate_state(1)[0]) for s in (world_seed, policy_seed))
    # As an environment spawns them from the same seed.
    start, physics = (np.random.default_rng(s) for s in np.random.SeedSequence(number).spawn(2))
    world = run.world
    drawn = world.task(np.random.default_rng(number)) if isinstance(world, RandomWorlds) else world
    task = as_task(drawn).for_episode(start)
    grid, played = task.draw(start), None
    if by == PLAY:
        rng = np.random.default_rng(policy_number)
        played = play(grid, Rules(setup.rules), rng, task.max_steps + 2)
        by = steps_of(played, run.order)
    recorder, logs = Recorder(), list[LogRecorder]()

    def begin(judge: Judge) -> OnAttempts:
        judge.executor.observers.extend(run.observers)
        if played is not None and not judge.grid.same_visible(grid):
            raise StartError("this world cannot be: it reads otherwise than it was drawn")
        if run.record:
            recorder.begin(judge)
            logs.append(LogRecorder(judge.executor))
        return watch(judge)

    if isinstance(by, tuple | Replanning):
        plan = Replanner(task, grid, by, setup, policy_number) if isinstance(by, Replanning) else by
        setup = plan.setup if isinstance(plan, Replanner) else setup
        recipe = Recipe(blueprint_text(grid), (), setup, Seed.drawn(physics), tuple(task.goal_cells))
        episode = _carried_out(task, grid, plan, recipe, run.set_up, begin)
    else:
        episode = _asked(task, by, setup, (number, policy_number), begin)
    if not run.record:
        return RolloutResult(task, grid, played, episode)
    trajectory = recorder.trajectory(run.key, episode.recipe, episode.attempts, task.design)
    return RolloutResult(task, grid, played, episode, trajectory, logs[-1].logs())


def _carried_out(
    task: Task, grid: Grid, plan: tuple[Step, ...] | Replanner, recipe: Recipe, where: SetUp, begin: Watch
) -> Episode:
    """Execute the steps of a plan or planner, each from the world read before it, as long as that can be read."""
    judge = where(grid, recipe.setup, recipe.seed, recipe.goals)
    on_attempts = begin(judge)
    found: list[tuple[Attempt, ...]] = []
    for step in plan.steps(judge, found) if isinstance(plan, Replanner) else plan:
        recipe = recipe.then(step)
        found.append(do(judge, step))
        on_attempts(found[-1])
        if judge.problems and not isinstance(plan, Replanner):
            break
    reached = by_rules = ending = None
    if isinstance(plan, Replanner):
        reached, by_rules, ending = plan.end(judge)
    elif task.has_goal:
        reached = not judge.problems and task.succeeded(judge.grid)
        rules = Rules(recipe.setup.rules)
        for act in (act for step in plan for act in step.acts):
            if rules.legal(grid, act.car, Action[act.action]):
                grid = rules.apply(grid, act.car, Action[act.action])
        by_rules = task.succeeded(grid)
    return Episode(recipe, tuple(found), reached, by_rules, judge.physics.time_s, judge.problems, ending)


def _asked(task: Task, by: str | Policy, setup: Setup, seeds: tuple[int, int], begin: Watch) -> Episode:
    """Run a policy for one episode in physics and one by the rules alone."""
    from craftsim.envs.options import Options
    from craftsim.envs.parallel import ParallelConstruction
    from craftsim.envs.physics_backend import PhysicsBackend
    from craftsim.envs.planner import PlannerPolicy

    backend = PhysicsBackend(setup, Options(check_contacts=True), task)
    reached = by_rules = None
    for world in (backend, None) if task.has_goal else (backend,):
        env = ParallelConstruction(task, Options("grid", rule_set=setup.rules), world)
        policy = by
        if isinstance(policy, str):
            policy = PlannerPolicy(env) if policy == PLANNER else make_policy(policy, seeds[1], task)
        observations, _ = env.reset(seed=seeds[0])
        on_attempts = None if world is None else begin(backend.judge)
        success = False
        while env.agents:
            observations, _, _, _, infos = env.step(policy(observations))
            success = all(info["success"] for info in infos.values())
            if on_attempts is not None:
                on_attempts(backend.ticks[-1])
        if world is None:
            by_rules = success
        elif task.has_goal:
            reached = success
    judge = backend.judge
    return Episode(
        backend.recipe, tuple(backend.ticks), reached, by_rules, judge.physics.time_s, judge.problems
    )


@dataclass(frozen=True)
class Building:
    """A task with a plan and, once it was executed, its episode and recordings."""

    task: Task
    plan: Plan
    episode: Episode | None = None
    trajectory: Trajectory | None = None
    logs: Mapping[int, Log] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the task."""
        return self.task.name

    @property
    def n_actions(self) -> int:
        """Number of actions in the plan."""
        return sum(len(tick) for tick in self.plan.ticks)

    @property
    def attempts(self) -> tuple[Attempt, ...]:
        """The attempts at the plan's actions; empty before the execution."""
        return self.episode.attempts if self.episode is not None else ()

    @property
    def n_agree(self) -> int:
        """Number of actions that did what the rules predict, within all limits."""
        return sum(attempt.agrees for attempt in self.attempts)

    @property
    def reached(self) -> bool | None:
        """Whether the goal is reached; None without a goal."""
        return self.episode.reached if self.episode is not None else None

    @property
    def good(self) -> bool:
        """Whether every action of the plan agrees and no goal was missed."""
        return self.n_agree == self.n_actions and self.reached is not False

    def run(
        self, setup: Setup, seed: int, order: PlanOrder, watch: Watch = unwatched, where: SetUp = set_up
    ) -> Building:
        """Execute the plan in a world that ``where`` sets up, and return the building with its episode."""
        steps = steps_of(self.plan.ticks, order, self.plan.after)
        run = Run(key=self.name, world=self.task, by=steps, seed=seed, setup=setup, record=True, set_up=where)
        done = roll_out(run, watch)
        return replace(self, episode=done.episode, trajectory=done.trajectory, logs=done.logs)

    @property
    def figures(self) -> dict[str, Any]:
        """Metrics for the report; lengths in mm, angles in mrad, None where nothing was measured."""
        assert self.episode is not None

        def worst(name: str) -> float | None:
            values = [getattr(attempt, name) for attempt in self.attempts]
            return max((1e3 * value for value in values if value is not None), default=None)

        return {
            "actions": self.attempts,
            "agree": self.n_agree,
            "total": self.n_actions,
            "ticks": len(self.plan.ticks),
            "matches_goal": self.reached,
            "simulated_s": round(self.episode.end_s, 6),
            "makespan_s": self.episode.makespan_s,
            "capped_steps": sum(attempt.capped_steps for attempt in self.attempts),
            "retried": sum(attempt.tries > 1 for attempt in self.attempts),
            "max_car_error_mm": worst("car_error_m"),
            "max_car_heading_error_mrad": worst("heading_error_rad"),
            "max_placed_error_mm": worst("placed_error_m"),
            "max_bystander_displacement_mm": worst("bystander_displacement_m"),
        }

    @property
    def files(self) -> dict[str, str | None]:
        """Names of its files, and the task's digest."""
        task = self.task
        return {
            "task": self.name,
            "task_digest": task.digest,
            "blueprint": task.starts[0].path.name,
            "plan": self.plan.path.name,
            "goal": task.design.path.name if task.design else None,
        }


def read_building(task: str, plan: Path | None = None, goal: Path | None = None) -> Building:
    """Return a task with its plan, its own or that of a file, and with the design in the file ``goal``, if given.

    Raises InputError for an invalid file, and if there is no plan for this task.
    """
    found = as_task(task)
    if plan is None and found.name not in TASK_NAMES:
        raise InputError(
            f"there is no shipped plan for {task}; give one with --plan "
            f"(shipped ones: {', '.join(TASK_NAMES)})"
        )
    if goal is not None:
        found = replace(found, design=read_design(goal), success="built")
    return Building(found, read_plan(plan or shipped_plan(found.name), found.layout.n_cars))
