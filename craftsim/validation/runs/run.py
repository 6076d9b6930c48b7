"""One run of a plan, of a list of actions or of a policy, in physics and by the rules alone."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from craftsim.checking.episode import Episode, OnAttempts, Recipe, Step, Watch, do, unwatched
from craftsim.checking.judge import Judge
from craftsim.checking.setup import Seed, SetUp, Setup, set_up
from craftsim.discrete.files.blueprint import blueprint_text, write_blueprint
from craftsim.discrete.files.plan import write_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import Task, as_task
from craftsim.envs.options import Options
from craftsim.envs.parallel import ParallelConstruction
from craftsim.envs.physics_backend import PhysicsBackend
from craftsim.envs.planner import PlannerPolicy
from craftsim.errors import StartError
from craftsim.experiments.bundle import write_bundle
from craftsim.experiments.experiment import Done
from craftsim.logs.files import LOG_SUFFIX, write_table
from craftsim.logs.log import Log
from craftsim.logs.recorder import LogRecorder
from craftsim.rendering.recorder import Recorder
from craftsim.rendering.trajectory import SUFFIX, TRAJECTORIES, Trajectory
from craftsim.skills.executor import Observer
from craftsim.storage.folders import directory_within
from craftsim.validation.play.play import Play, covered, play
from craftsim.validation.play.worlds import RandomWorlds
from craftsim.validation.runs.policies import PLANNER, Policy, make_policy
from craftsim.validation.runs.rebuilding import Rebuilding, rebuild
from craftsim.validation.runs.steps import PlanOrder, steps_of

BUNDLES: Final = "bundles"
WORLDS: Final = "worlds"
"""Folder of the random worlds and their plans."""


@dataclass(frozen=True)
class Terms:
    """What all runs of a validation have in common."""

    seed: int
    setup: Setup
    out: Path | None = None
    """Folder of the campaign, where bundles go."""
    observers: tuple[Observer, ...] = ()
    """Called with each run's PhysicsWorld after every control period."""
    record: bool = False
    """Whether to write a trajectory and the logs of each run."""
    set_up: SetUp = set_up
    """How a plan's world comes about: simulated here, or that of robots elsewhere."""


@dataclass(frozen=True, slots=True)
class Run:
    """What to run; goes to a worker."""

    key: str
    world: Task | str | RandomWorlds
    """A task, what names one, or worlds of which each episode draws its own."""
    steps: tuple[Step, ...] | None
    """What to do, whatever happens; None asks the policy, or plays at random."""
    policy: str | Policy
    episode: int
    """Decides, with the seed, all that is drawn; the same for all plans and policies, so that they can be compared."""
    terms: Terms
    play: PlanOrder | None = None
    """How random play is carried out; None where there is none."""
    rebuilding: Rebuilding | None = None
    """How it is planned, and planned again; None where it is not."""

    @property
    def file_name(self) -> str:
        """The key as a name of a file."""
        return re.sub(r"[^\w.-]+", "-", self.key)


@dataclass
class _Drawn:
    """The start of a run, and the seeds of all else that is drawn."""

    task: Task
    grid: Grid
    policy: int
    world: int
    """Seed of the environment that starts the same."""
    physics: Seed
    played: Play | None
    """The random play, where there is one."""

    @classmethod
    def of(cls, run: Run) -> _Drawn:
        world, policy = np.random.SeedSequence([run.terms.seed, run.episode]).spawn(2)
        number, policy_number = (int(s.generate_state(1)[0]) for s in (world, policy))
        # As an environment spawns them from the same seed.
        start, physics = (np.random.default_rng(s) for s in np.random.SeedSequence(number).spawn(2))
        task = (
            run.world.task(np.random.default_rng(number))
            if isinstance(run.world, RandomWorlds)
            else as_task(run.world)
        )
        task = task.for_episode(start)
        grid, played = task.draw(start), None
        if run.play is not None:
            rules, rng = Rules(run.terms.setup.rules), np.random.default_rng(policy_number)
            played = play(grid, rules, rng, task.max_steps + 2)
        return cls(task, grid, policy_number, number, Seed.drawn(physics), played)


def do_run(run: Run) -> Done:
    """Run in physics, and by the rules alone; write the bundle of the first disagreement, if there is one."""
    drawn = _Drawn.of(run)
    try:
        if run.terms.record:
            _save_recording(run, recording := _record(run, drawn, unwatched))
            episode = recording.episode
        else:
            episode = _run(run, drawn, unwatched)
    except StartError as error:
        if drawn.played is None:
            raise
        nothing = {"ticks": 0, "forbidden": 0, "makespan_s": 0.0}
        return Done(agrees=True, extra=nothing | {"does_not_stand": str(error)})
    extra: dict[str, Any] = {
        "ticks": episode.n_ticks,
        "forbidden": len(episode.forbidden),
        "makespan_s": episode.makespan_s,
    }
    if episode.reached is not None:
        extra |= {"grid_success": episode.reached_by_rules, "physics_success": episode.reached}
    if episode.ending is not None:
        extra |= episode.ending
    if drawn.played is not None:
        extra["coverage"] = covered(drawn.played, episode.attempts)
        _save_world(run, drawn.grid, drawn.played)
    # What a policy asks for, and the rules forbid at the car's turn, does nothing in either world; so does what random
    # play would have done had all before gone as predicted.
    follows = run.steps is not None
    return Done(
        agrees=episode.agrees and not (follows and episode.forbidden),
        # What is left of a plan when another one takes its place says nothing of any action.
        attempts=[
            a for a in episode.attempts if (a.legal or follows) and (run.rebuilding is None or a.performed)
        ],
        bundle=_bundle(run, episode),
        extra=extra,
    )


@dataclass(frozen=True)
class Recording:
    """An episode, what moved in it, and what its cars were told and measured."""

    episode: Episode
    trajectory: Trajectory
    logs: Mapping[int, Log]
    """By car."""


def record_episode(run: Run, watch: Watch = unwatched) -> Recording:
    """Run in physics, and by the rules alone, and return the episode with what was recorded of it."""
    return _record(run, _Drawn.of(run), watch)


def _record(run: Run, drawn: _Drawn, watch: Watch) -> Recording:
    recorder, logs = Recorder(), list[LogRecorder]()

    def begin(judge: Judge) -> OnAttempts:
        recorder.begin(judge)
        logs.append(LogRecorder(judge.executor))
        return watch(judge)

    episode = _run(run, drawn, begin)
    trajectory = recorder.trajectory(run.key, episode.recipe, episode.attempts, drawn.task.design)
    return Recording(episode, trajectory, logs[-1].logs())


def _run(run: Run, drawn: _Drawn, watch: Watch) -> Episode:
    if run.play is not None and drawn.played is not None:
        return _follow(run, drawn, steps_of(drawn.played.ticks, run.play), watch)
    if run.rebuilding is not None:
        terms, seeds = run.terms, (drawn.physics, drawn.policy)
        return rebuild(
            *(drawn.task, drawn.grid, seeds, terms.setup, run.rebuilding, watch),
            *(terms.set_up, terms.observers),
        )
    if run.steps is not None:
        return _follow(run, drawn, run.steps, watch)
    return _rolled_out(run, drawn, watch)


def _follow(run: Run, drawn: _Drawn, steps: Sequence[Step], watch: Watch) -> Episode:
    """Carry out a plan, each step from what was read before it."""
    task, setup = drawn.task, run.terms.setup
    recipe = Recipe(blueprint_text(drawn.grid), (), setup, drawn.physics, tuple(task.goal_cells))
    judge = run.terms.set_up(drawn.grid, setup, drawn.physics, recipe.goals)
    judge.executor.observers.extend(run.terms.observers)
    if drawn.played is not None and not judge.grid.same_visible(drawn.grid):
        raise StartError("this world cannot be: it reads otherwise than it was drawn")
    on_attempts = watch(judge)
    found = []
    for step in steps:
        recipe = recipe.then(step)
        found.append(do(judge, step))
        on_attempts(found[-1])
        if judge.problems:
            break
    reached = by_rules = None
    if task.has_goal:
        reached = not judge.problems and task.succeeded(judge.grid)
        by_rules = task.succeeded(_predict(steps, drawn.grid, Rules(setup.rules)))
    return Episode(recipe, tuple(found), reached, by_rules, judge.physics.time_s, judge.problems)


def _predict(steps: Sequence[Step], grid: Grid, rules: Rules) -> Grid:
    """Return the world to which the rules alone lead."""
    for act in (act for step in steps for act in step.acts):
        action = Action[act.action]
        if rules.legal(grid, act.car, action):
            grid = rules.apply(grid, act.car, action)
    return grid


def _rolled_out(run: Run, drawn: _Drawn, watch: Watch) -> Episode:
    """Let a policy play an episode in physics, and one by the rules alone."""
    task, setup = drawn.task, run.terms.setup
    backend = PhysicsBackend(setup, None, task.goal_cells, watch_contacts=True)
    reached = _rollout(run, drawn, backend, watch)
    by_rules = _rollout(run, drawn, None, unwatched) if task.has_goal else None
    judge = backend.judge
    return Episode(
        backend.recipe,
        tuple(backend.ticks),
        reached if task.has_goal else None,
        by_rules,
        judge.physics.time_s,
        judge.problems,
    )


def _rollout(run: Run, drawn: _Drawn, backend: PhysicsBackend | None, watch: Watch) -> bool:
    """Play an episode; return whether it ends in success."""
    env = ParallelConstruction(drawn.task, Options("grid", rule_set=run.terms.setup.rules), backend)
    policy = run.policy
    if isinstance(policy, str):
        planner = policy == PLANNER
        policy = PlannerPolicy(env) if planner else make_policy(policy, drawn.policy, drawn.task)
    observations, _ = env.reset(seed=drawn.world)
    if backend is not None:
        backend.judge.executor.observers.extend(run.terms.observers)
        on_attempts = watch(backend.judge)
    success = False
    while env.agents:
        observations, _, _, _, infos = env.step(policy(observations))
        success = all(info["success"] for info in infos.values())
        if backend is not None:
            on_attempts(backend.ticks[-1])
    return success


def _bundle(run: Run, episode: Episode) -> str | None:
    """Write the bundle of the first step in which something allowed did not go as predicted; return its folder."""
    number = episode.first_disagreement
    if number is None or run.terms.out is None:
        return None
    folder = f"{BUNDLES}/{run.file_name}"
    write_bundle(run.terms.out / folder, run.key, episode.until(number), episode.steps[number])
    return folder


def _save_recording(run: Run, recording: Recording) -> None:
    assert run.terms.out is not None, "a campaign that records has a folder"
    folder = directory_within(run.terms.out, TRAJECTORIES)
    recording.trajectory.write(folder / f"{run.file_name}{SUFFIX}")
    write_table(folder / f"{run.file_name}{LOG_SUFFIX}", recording.logs)


def _save_world(run: Run, grid: Grid, played: Play) -> None:
    """Write a random world and its play as a blueprint and a plan, which ``craftsim validate`` takes again."""
    if run.terms.out is None or not any(played.ticks):
        return
    folder = directory_within(run.terms.out, WORLDS)
    write_blueprint(grid, folder / f"{run.file_name}.yaml")
    write_plan(played.ticks, folder / f"{run.file_name}.plan")
