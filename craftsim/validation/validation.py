"""Validation of plans, action lists, policies and planners in physics, in one call."""

from __future__ import annotations

import hashlib
import html
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final, NamedTuple, get_args

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.setup import Setup, check_start
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.plan import Plan, read_actions, read_plan
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules, RuleSet
from craftsim.discrete.tasks import TASK_NAMES, Task, as_task, free_play
from craftsim.errors import InputError, check_choice
from craftsim.experiments.compare import Comparison, compare_runs, read_earlier
from craftsim.experiments.experiment import Experiment, Progress, Trial, TrialRecord
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.session import open_session
from craftsim.experiments.statistics import Figures, campaign_figures, carried_out, distinct, write_durations
from craftsim.models.world import PhysicsWorld
from craftsim.options import Physics, Rollouts, Trials, changed
from craftsim.planning import Planned, plan_building
from craftsim.rendering.trajectory import Trajectory
from craftsim.skills.executor import Observer
from craftsim.skills.library import check_cars
from craftsim.storage.paths import exists, resolved
from craftsim.storage.writing import writable
from craftsim.training.policy import is_shipped_policy
from craftsim.validation.forms import BUILDS, RUNS
from craftsim.validation.minimize import Counterexample, MinimizeProgress, minimize_failures
from craftsim.validation.play import coverage_of
from craftsim.validation.policies import PLANNER, RANDOM, Policy, check_policy, policy_digest
from craftsim.validation.replanning import Replanning
from craftsim.validation.rollout import PLAY, By, PlanOrder, Run, do_run, roll_out, steps_of
from craftsim.validation.worlds import MAX_CARS, RandomWorlds

if TYPE_CHECKING:
    from pandas import DataFrame

ROLLOUTS: Final = Rollouts()
PHYSICS: Final = Physics()
TRIALS: Final = Trials()
REPLANNING: Final = Replanning()
_FORMER: Final = {"against": "baseline", "shrink": "minimize"}
AUTO: Final = "auto"
"""The plan that is made, and made again after a failure."""
SHIPPED: Final = "shipped"
"""Digest of everything that belongs to a version of craftsim."""

World = Task | Grid | RandomWorlds | str | Path
"""A task, a start without a goal, or a reference: a task's name, a file, ``module:factory``, or ``random``."""


def build_figures(records: Iterable[TrialRecord]) -> dict[str, Any]:
    """Return the metrics of all buildings of a run: the share ``built`` of all that finished, the number of each
    ending, of further plans and of disturbances, and the medians of the first plan's and of the real makespan in
    simulated seconds."""
    extras = [record["extra"] for record in carried_out(records)]
    different = [record["extra"]["ended"] == "built" for record in carried_out(distinct(records))]
    endings = Counter(extra["ended"] for extra in extras)
    times = [extra["makespan_s"] for extra in extras if extra["ended"] == "built"]
    return {
        "built": Proportion.of(sum(different), len(different)),
        "endings": dict(sorted(endings.items())),
        "replans": sum(extra["replans"] for extra in extras),
        "disturbed": sum(bool(extra["disturbed"]) for extra in extras),
        "planned_s": median(extra["planned_s"] for extra in extras) if extras else None,
        "real_s": median(times) if times else None,
    }


@dataclass(frozen=True, repr=False)
class Validation:
    """The result of a validation.

    Example:
        >>> import craftsim
        >>> result = craftsim.validate("strip", trials=1)
        >>> result
        Validation(1 of 1 runs agree, 22 of 22 actions as predicted)
        >>> int((result.to_frame()["verb"] == "LIFT").sum())
        4
    """

    records: Sequence[TrialRecord]
    """One for each run, as in ``trials.jsonl``; read lazily if there is an output folder."""
    figures: Figures
    config: dict[str, Any]
    """The configuration, without the seed."""
    seed: int
    comparison: Comparison | None = None
    """Comparison with the baseline run, if given."""
    coverage: dict[str, Any] | None = None
    """Coverage of random play, if any, as of :func:`craftsim.validation.play.coverage_of`."""
    smallest: tuple[Counterexample, ...] = ()
    """The first failure of each kind in its smallest world, with the option ``minimize``."""
    builds: dict[str, Any] | None = None
    """Metrics of buildings with replanning, as of :func:`build_figures`."""

    @property
    def all_built(self) -> bool:
        """Whether every building with replanning was built."""
        return self.builds is not None and self.builds["endings"].get("built", 0) == len(self.records)

    @property
    def agrees(self) -> bool:
        """Whether every run with an action to judge is as predicted, within all limits, and there is one."""
        return 0 < self.n_agree == self.n_judged

    @property
    def n_agree(self) -> int:
        """Number of runs with an action to judge that are as predicted."""
        return sum(record["agrees"] and bool(record["attempts"]) for record in self.records)

    @property
    def n_judged(self) -> int:
        """Number of runs with an action to judge, and of those that did not finish."""
        return sum(bool(record["attempts"]) or record["error"] is not None for record in self.records)

    @property
    def attempts(self) -> list[Attempt]:
        """All attempts, in the order of the runs."""
        return [Attempt.of(attempt) for record in self.records for attempt in record["attempts"]]

    def to_frame(self) -> DataFrame:
        """Return a table with a row for each action: its run's world, plan and episode, and the fields of Attempt."""
        from pandas import DataFrame

        rows = [
            {"world": r["context"], "by": r["group"], "episode": r["episode"], **attempt}
            for r in self.records
            for attempt in r["attempts"]
        ]
        columns = ["world", "by", "episode", *Attempt.__dataclass_fields__]
        return DataFrame(rows, columns=columns)

    def __repr__(self) -> str:
        runs, legal = f"{self.n_agree} of {self.n_judged} runs agree", self.figures.matrix["legal"]
        return f"Validation({runs}, {legal.as_predicted} of {legal.trials} actions as predicted)"

    def _repr_html_(self) -> str:
        frame = self.to_frame()
        counts = frame.groupby(["world", "by", "verb"])["result"].value_counts().unstack(fill_value=0)
        return f"<p><b>{html.escape(repr(self))}</b></p>{counts.to_html()}"


def validate(
    worlds: World | Iterable[World],
    what: Rollouts = ROLLOUTS,
    physics: Physics = PHYSICS,
    campaign: Trials = TRIALS,
    *,
    out: str | Path | None = None,
    record: bool = False,
    observers: Iterable[Observer] = (),
    progress: Progress = lambda total: nullcontext(lambda record: None),
    minimize: MinimizeProgress | None = None,
    replanning: Replanning = REPLANNING,
    **options: Any,
) -> Validation:
    """Run plans, action lists or policies in physics and compare every action with its prediction.

    Args:
        worlds: one or several: a task, the path of a blueprint, the name of a task, ``module:factory``, a Grid; or
            ``random`` for a new random world in each run.
        what: plan, action list or policies, and their execution.
        physics: rules, randomization, gains, machines, drive and seed.
        campaign: number of trials and workers.
        out: folder for report.json, trials.jsonl, durations.csv and replay bundles; without it nothing is written.
        record: write a trajectory of each run into the folder ``trajectories`` of ``out``.
        observers: functions called with a run's world after every control period; they must not change it.
        progress: progress display.
        minimize: progress of the minimization of the first failure of each kind; None for no minimization.
        replanning: numbers of plans, and the disturbance, for the plan ``auto``.
        options: any field of :class:`craftsim.options.Rollouts`, :class:`~craftsim.options.Physics` and
            :class:`~craftsim.options.Trials` by name, such as ``policy``, ``randomize`` or ``trials``. In addition to
            the values on the command line, ``plan`` may be a Plan, ``policy`` a function from the
            observations by agent to the actions by agent, ``gains`` Gains, ``machines`` Machines, ``noise`` and
            ``assume`` SensorNoise, and ``skills`` a mapping such as
            ``{Action.LIFT: MyLift}`` with subclasses of :class:`craftsim.Skill`.

    Raises:
        InputError: an argument, or a file that it names, is invalid.

    Example:
        >>> import craftsim
        >>> craftsim.validate("strip", policy="random", trials=1, seed=3).agrees
        True
    """
    for old, new in _FORMER.items():
        if old in options:
            warnings.warn(f"{old}= of validate is called {new}= now", DeprecationWarning, stacklevel=2)
            options[new] = options.pop(old)
    minimize = options.pop("minimize", minimize)
    what, physics, campaign = changed((what, physics, campaign), options)
    plan, actions, policy, order = what.plan, what.actions, what.policy, what.order
    check_choice("order", order, get_args(PlanOrder))
    trials, seed, timeout_s = campaign.trials, physics.seed, what.timeout_s
    whole = all(isinstance(one, int | np.integer) and one > 0 for one in (trials, campaign.workers))
    if not whole or not timeout_s > 0:
        raise InputError("trials and workers must be whole numbers of at least 1, timeout_s above 0")
    several = [worlds] if isinstance(worlds, World) else list(worlds)
    given = [name for name, value in (("plan", plan), ("actions", actions), ("policy", policy)) if value]
    if len(given) > 1:
        raise InputError(f"--{given[0]} and --{given[1]} exclude each other; give one of them")
    if given and given[0] != "policy" and len(several) != 1:
        raise InputError(f"{given[0]} needs the one world that it is for")
    elsewhere = campaign.workers > 1 or campaign.engine != "local"
    if out is None and (elsewhere or campaign.resume or campaign.baseline or minimize or record):
        raise InputError(
            "several workers, an engine, resume, baseline, minimize and record need the folder 'out'"
        )
    every = rollout_worlds(several, what.n_cars, what.n_blocks, what.max_steps)
    n_cars = every[0].n_cars if every else 0
    if plan == AUTO:
        sources = [replanning_source(replanning, every)]
    elif plan is not None:
        read = plan if isinstance(plan, Plan) else read_plan(Path(plan), n_cars)
        sources = [plan_source(read, order)]
    elif actions is not None:
        sources = [plan_source(read_actions(Path(actions), n_cars), "sequential")]
    else:
        chosen = policy or (PLAY if all(one.name == RANDOM for one in every) else PLANNER)
        named = [chosen] if isinstance(chosen, str) or callable(chosen) else list(chosen)
        asked = every, order, physics.rules, timeout_s
        sources = [policy_source(one, *asked) for one in dict.fromkeys(named)]
    folder = None if out is None else Path(out)
    setup = physics.setup()
    config: dict[str, Any] = {
        "worlds": {one.name: one.digest for one in every},
        "by": {one.name: one.digest for one in sources},
        "trials": trials,
        "randomize": str(physics.randomize),
        "rules": physics.rules,
        "order": order,
        "record": record,
        "setup": setup,
        "digests": setup.digests,
    }
    check_starts(every, setup, seed)
    terms = {"out": folder and folder.resolve(), "observers": tuple(observers), "record": record}
    items = list(items_of(every, sources, trials, seed, setup, order=order, **terms))
    form = BUILDS if plan == AUTO else RUNS
    experiment = Experiment("validate", seed, config, items, do_run, form, timeout_s)
    how = campaign.run(progress)
    earlier = read_earlier(experiment, folder, how)
    if plan == AUTO:
        # Fail before the run starts if nothing can be built; finding out may take long.
        rng, rules, rounds = np.random.default_rng(seed), Rules(setup.rules), replanning.rounds
        first = as_task(items[0].job.world).for_episode(rng)
        plan_building(first.draw(rng), first, rules, rounds=rounds, time_s=timeout_s, report=_enough)
    with open_session(experiment, folder, how) as session:
        records = session.run()
        figures = campaign_figures(records, seed)
        comparison = None if earlier is None else compare_runs(earlier, session)
        smallest = () if minimize is None else minimize_failures(session, records, minimize)
        found: dict[str, Any] = {"coverage": coverage_of(records), "smallest": smallest}
        if plan == AUTO:
            found["builds"] = build_figures(records)
        session.write_report({"validation": figures, "paired": comparison, **found})
        if folder is not None:
            write_durations(folder, figures.durations)
    return Validation(records, figures, config, seed, comparison, **found)


def _enough(number: int, best: Planned | None) -> bool:
    """Return whether there is a plan, for planning to stop."""
    return best is not None


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
    world: World,
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
    every = rollout_worlds([world])
    if plan is None:
        source = policy_source(policy or PLANNER, every, order, setup.rules)
    elif policy is not None:
        raise InputError("--plan and --policy exclude each other; give one of them")
    else:
        source = plan_source(read_plan(plan, every[0].n_cars), order)
    (item,) = items_of(every, [source], 1, seed, setup, order=order, record=True)
    trajectory = roll_out(item.job).trajectory
    assert trajectory is not None
    return trajectory


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
    by: By
    plans: Mapping[str, By] = {}


def rollout_worlds(
    worlds: Iterable[World],
    n_cars: int | None = None,
    n_blocks: int | None = None,
    max_steps: int | None = None,
) -> list[RolloutWorld]:
    """Return the worlds for some references.

    ``n_cars`` and ``n_blocks`` set the numbers of things placed at random, ``max_steps`` the length of an episode in
    ``random`` worlds. Raises InputError for an unknown world, and for two of one name.
    """
    found = [_rollout_world(world, n_cars, n_blocks, max_steps) for world in worlds]
    for name, number in Counter(one.name for one in found).items():
        if number > 1:
            raise InputError(f"two worlds are called '{name}'; rename one, or run them one after the other")
    return found


def _rollout_world(
    world: World, n_cars: int | None, n_blocks: int | None, max_steps: int | None
) -> RolloutWorld:
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


def check_starts(worlds: Sequence[RolloutWorld], setup: Setup, seed: int) -> None:
    """Raise StartError for a user's world in which solids overlap, and InputError for a skill for a missing car."""
    for _, world, _, n_cars in worlds:
        if isinstance(world, RandomWorlds):
            continue
        check_cars(setup.skills, n_cars)
        if world not in TASK_NAMES:
            start = as_task(world).draw(np.random.default_rng(seed))
            check_start(PhysicsWorld(start, setup.simulation, machines=setup.machines))


def plan_source(plan: Plan, order: PlanOrder) -> ActionSource:
    """Return the source of a fixed plan."""
    said = (plan.ticks, *plan.after.items()) if plan.after else plan.ticks
    steps = steps_of(plan.ticks, order, plan.after)
    return ActionSource(writable(plan.path.stem), _digest(repr(said).encode()), steps)


def replanning_source(replanning: Replanning, worlds: Sequence[RolloutWorld]) -> ActionSource:
    """Return the source that plans, and plans again after a failure. Raises InputError for a world without a goal."""
    for one in worlds:
        if not one.has_goal:
            raise InputError(f"{one.name} has no goal to plan for; give a design with --goal")
    return ActionSource(AUTO, _digest(repr(replanning).encode()), replanning)


def policy_source(
    policy: str | Policy,
    worlds: Sequence[RolloutWorld],
    order: PlanOrder,
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
        return ActionSource(PLAY, SHIPPED, PLAY)
    if policy != PLANNER:
        own = exists(policy) and not is_shipped_policy(policy)
        place = str(resolved(policy)) if own else policy
        for _, world, _, _ in worlds:
            task = world.task(np.random.default_rng(0)) if isinstance(world, RandomWorlds) else as_task(world)
            check_policy(place, task, rules, timeout_s)
        return ActionSource(writable(policy), policy_digest(place), place)
    for one in worlds:
        if not one.has_goal:
            raise InputError(
                f"there is no shipped plan for {one.name}, and no goal to plan for; "
                "give a plan with --plan, or a --policy"
            )
    shipped = [one for one in worlds if one.world in TASK_NAMES]
    plans = {s.name: steps_of(read_plan(shipped_plan(s.name), s.n_cars).ticks, order) for s in shipped}
    return ActionSource(PLANNER, SHIPPED, PLANNER, plans)


def items_of(
    worlds: Sequence[RolloutWorld],
    sources: Sequence[ActionSource],
    trials: int,
    seed: int,
    setup: Setup,
    **terms: Any,
) -> Iterator[Trial]:
    """Yield all trials: every source of actions in every world; ``terms`` are further fields of :class:`Run`.

    Where nothing is drawn at random all trials are identical, and the first stands for all.
    """
    fixed = set[str]()
    if trials > 1 and not setup.draws:
        fixed = {one.name for one in worlds if one.is_fixed}
    for episode, (name, world, *_), source in product(range(trials), worlds, sources):
        key, by = f"{name}/{source.name}/{episode:04d}", source.plans.get(name, source.by)
        identical = 1
        if name in fixed and isinstance(by, tuple):
            if episode > 0:
                continue
            identical = trials
        run = Run(
            key=key, world=world, by=by, episode=episode, identical=identical, seed=seed, setup=setup, **terms
        )
        yield Trial(key, source.name, seed, run, name, episode)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
