"""Validation of plans, lists of actions, policies and planners in physics: the whole job in one call."""

from __future__ import annotations

import html
import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.setup import Setup
from craftsim.discrete.files.design import read_design
from craftsim.discrete.files.plan import Plan, read_actions, read_plan
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import Task, as_task
from craftsim.errors import InputError
from craftsim.experiments.compare import Comparison, compare_runs, read_earlier
from craftsim.experiments.durations import write_durations
from craftsim.experiments.experiment import Experiment, Progress, RunOptions, Trial, TrialRecord
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.records import Finished
from craftsim.experiments.session import Session, open_session
from craftsim.experiments.statistics import Figures, campaign_figures
from craftsim.options import Physics, Rollouts, Trials, changed
from craftsim.planning import Planned, plan_building
from craftsim.rendering.trajectory import Trajectory
from craftsim.skills.executor import Observer
from craftsim.validation.choice import (
    PLANNER,
    PLAY,
    World,
    check_starts,
    items_of,
    plan_pilot,
    policy_pilot,
    subjects_of,
)
from craftsim.validation.forms import BUILDS, RUNS
from craftsim.validation.minimize import Counterexample, MinimizeProgress, minimize_failures
from craftsim.validation.play import Coverage
from craftsim.validation.policies import RANDOM
from craftsim.validation.replanning import Replanning
from craftsim.validation.rollout import PlanOrder, Run, Terms, do_run, roll_out

if TYPE_CHECKING:
    from pandas import DataFrame

ROLLOUTS: Final = Rollouts()
PHYSICS: Final = Physics()
TRIALS: Final = Trials()
_FORMER: Final = {"against": "baseline", "shrink": "minimize"}
"""Arguments of validate that were called otherwise."""


@dataclass(frozen=True)
class BuildFigures:
    """What all buildings of a campaign came to; times are medians, in simulated seconds."""

    built: Proportion
    """Of all that came to an end, however many plans they took."""
    endings: dict[str, int]
    """How many were built, given up, or could not be read any more."""
    replans: int
    """Plans after the first ones, all together."""
    disturbed: int
    """Buildings in which the disturbance that was asked for came about."""
    planned_s: float | None
    """Makespan of the first plan by the table of durations."""
    real_s: float | None
    """From the start of the first action to the end of the last, of what was built."""

    @classmethod
    def of(cls, records: Iterable[TrialRecord]) -> BuildFigures:
        """Return the figures of the buildings in some records."""
        extras = [record["extra"] for record in records if record["error"] is None]
        endings = Counter(extra["ended"] for extra in extras)
        times = [extra["makespan_s"] for extra in extras if extra["ended"] == "built"]
        return cls(
            built=Proportion.of(endings["built"], len(extras)),
            endings=dict(sorted(endings.items())),
            replans=sum(extra["replans"] for extra in extras),
            disturbed=sum(bool(extra["disturbed"]) for extra in extras),
            planned_s=median(extra["planned_s"] for extra in extras) if extras else None,
            real_s=median(times) if times else None,
        )


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
    """One for each run, as in ``trials.jsonl``; read from there one at a time where there is a folder for results."""
    figures: Figures
    config: dict[str, Any]
    """What decided it, besides the seed."""
    seed: int
    items: Sequence[Trial]
    """What was run, parallel to the records."""
    comparison: Comparison | None = None
    """With an earlier run, where one was given."""
    coverage: Coverage | None = None
    """Of random play, where there was some."""
    smallest: tuple[Counterexample, ...] = ()
    """The first failure of each kind in its smallest world, where that was asked for."""
    builds: BuildFigures | None = None
    """Of buildings with re-planning."""

    @property
    def all_built(self) -> bool:
        """Whether every building of a run with re-planning was built."""
        return self.builds is not None and self.builds.endings.get("built", 0) == len(self.records)

    @property
    def agrees(self) -> bool:
        """Whether every run did in physics what the rules predict, within all limits."""
        return self.n_agree == len(self.records)

    @property
    def n_agree(self) -> int:
        """Number of runs that did."""
        return sum(record["agrees"] for record in self.records)

    @property
    def attempts(self) -> list[Attempt]:
        """Every action that was tried, in the order of the runs."""
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
        runs, legal = f"{self.n_agree} of {len(self.records)} runs agree", self.figures.matrix.legal
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
    **options: Any,
) -> Validation:
    """Run plans, lists of actions or policies in physics and judge every action on the poses that it ends with.

    Args:
        worlds: one or several: a task, a blueprint's path, a shipped task's name, ``module:factory``, a Grid; or
            ``random`` for worlds that each run draws anew.
        what: plan, list of actions or policies, and how they are carried out.
        physics: rules, what is drawn, gains, machines, drive and seed.
        campaign: how many trials are run and where.
        out: folder for report.json, trials.jsonl, durations.csv and replay bundles; nothing is written without.
        record: write a trajectory of each run into the folder ``trajectories`` of ``out``.
        observers: functions that are called with a run's world after every control period; they may look, not touch.
        progress: shows what is done.
        minimize: shows how the first failure of each kind is reduced to its smallest world; unless given, none is.
        options: any field of :class:`craftsim.options.Rollouts`, :class:`~craftsim.options.Physics` and
            :class:`~craftsim.options.Trials` by its name, such as ``policy``, ``randomize`` or ``trials``. Besides what
            the command line takes, ``plan`` may be a Plan, ``policy`` a function from the observations by agent to the
            actions by agent, ``gains`` Gains, ``machines`` Machines, ``noise`` and ``assume`` SensorNoise, and
            ``skills`` a mapping such as ``{Action.LIFT: MyLift}`` with subclasses of :class:`craftsim.Skill`.

    Raises:
        InputError: an argument, or a file that it names, is not as it should be.

    Example:
        >>> import craftsim
        >>> craftsim.validate("strip", policy="random", randomize="mild", trials=1, seed=3).agrees
        True
    """
    for old, new in _FORMER.items():
        if old in options:
            warnings.warn(f"{old}= of validate is called {new}= now", DeprecationWarning, stacklevel=2)
            options[new] = options.pop(old)
    minimize = options.pop("minimize", minimize)
    what, physics, campaign = changed((what, physics, campaign), options)
    plan, actions, policy, order = what.plan, what.actions, what.policy, what.order
    trials, seed, timeout_s = campaign.trials, physics.seed, what.timeout_s
    if trials < 1 or campaign.workers < 1 or not timeout_s > 0:
        raise InputError("trials and workers must be at least 1, timeout_s above 0")
    several = [worlds] if isinstance(worlds, World) else list(worlds)
    given = [name for name, value in (("plan", plan), ("actions", actions), ("policy", policy)) if value]
    if len(given) > 1:
        raise InputError(f"{given[0]} and {given[1]} exclude each other")
    if given and given[0] != "policy" and len(several) != 1:
        raise InputError(f"{given[0]} needs the one world that it is for")
    elsewhere = campaign.workers > 1 or campaign.engine != "local"
    if out is None and (elsewhere or campaign.resume or campaign.baseline or minimize or record):
        raise InputError(
            "several workers, an engine, resume, baseline, minimize and record need the folder 'out'"
        )
    subjects = subjects_of(several, what.n_cars, what.n_blocks, what.max_steps)
    if plan is not None:
        read = plan if isinstance(plan, Plan) else read_plan(Path(plan), subjects[0].n_cars)
        pilots = [plan_pilot(read, order)]
    elif actions is not None:
        pilots = [plan_pilot(read_actions(Path(actions), subjects[0].n_cars), "sequential")]
    else:
        default = PLAY if all(s.name == RANDOM for s in subjects) else PLANNER
        chosen = policy or default
        named = [chosen] if isinstance(chosen, str) or callable(chosen) else list(chosen)
        pilots = [
            policy_pilot(one, subjects, order, physics.rules, timeout_s) for one in dict.fromkeys(named)
        ]
    folder = None if out is None else Path(out)
    setup = physics.setup()
    config: dict[str, Any] = {
        "worlds": {subject.name: subject.digest for subject in subjects},
        "by": {pilot.name: pilot.digest for pilot in pilots},
        "trials": trials,
        "randomize": str(physics.randomize),
        "rules": physics.rules,
        "order": order,
        "record": record,
        "setup": setup,
        "digests": setup.digests,
    }
    check_starts(subjects, setup, seed)
    terms = Terms(seed, setup, None if folder is None else folder.resolve(), tuple(observers), record)
    items = list(items_of(subjects, pilots, trials, terms))
    experiment = Experiment("validate", seed, config, items, do_run, RUNS, timeout_s)
    how = campaign.run(progress)

    def find(session: Session, records: Sequence[TrialRecord]) -> dict[str, Any]:
        smallest = () if minimize is None else minimize_failures(session, records, minimize)
        return {"coverage": Coverage.of(records), "smallest": smallest}

    return _run(experiment, folder, how, read_earlier(experiment, folder, how), find)


def build_all(
    task: Task,
    setup: Setup,
    asked: Replanning,
    *,
    trials: int,
    seed: int,
    out: Path,
    options: RunOptions,
    timeout_s: float = 600.0,
    record: bool = False,
) -> Validation:
    """Build what a task with a goal asks for many times, planning again where physics went another way.

    Args:
        task: has a goal.
        setup: configuration of the physics.
        asked: how often is planned, and what goes wrong on purpose.
        trials: how many times.
        seed: decides all that is drawn.
        out: folder for ``report.json``, ``trials.jsonl`` and bundles.
        options: how.
        timeout_s: after which a building counts as hanging.
        record: write a trajectory of each.

    Raises InputError where something does not fit together, and NoPlanError where there is no plan from the start.
    """
    subjects = subjects_of([task])
    check_starts(subjects, setup, seed)
    config: dict[str, Any] = {
        "world": subjects[0].digest,
        "trials": trials,
        "asked": asked,
        "record": record,
        "setup": setup,
        "digests": setup.digests,
    }
    terms = Terms(seed, setup, out.resolve(), record=record)
    runs = [Run(f"{task.name}/{episode:04d}", task, asked, episode, terms) for episode in range(trials)]
    items = [Trial(run.key, "built", seed, run, task.name, run.episode) for run in runs]
    experiment = Experiment("build", seed, config, items, do_run, BUILDS, timeout_s)
    earlier = read_earlier(experiment, out, options)
    # Whether anything can be built is said before anything is begun; it may take long to find out.
    rng, rules = np.random.default_rng(seed), Rules(setup.rules)
    first = task.for_episode(rng)
    plan_building(first.draw(rng), first, rules, rounds=asked.rounds, time_s=math.inf, report=_enough)
    return _run(
        experiment, out, options, earlier, lambda session, records: {"builds": BuildFigures.of(records)}
    )


def _enough(number: int, best: Planned | None) -> None:
    """Stop planning as soon as there is a plan."""
    if best is not None:
        raise KeyboardInterrupt


def _run(
    experiment: Experiment,
    folder: Path | None,
    how: RunOptions,
    earlier: Finished | None,
    find: Callable[[Session, Sequence[TrialRecord]], Mapping[str, Any]],
) -> Validation:
    """Run an experiment, and report on it with what else is found in it, by the names of Validation's fields."""
    with open_session(experiment, folder, how) as session:
        records = session.run()
        figures = campaign_figures(records, experiment.seed)
        comparison = None if earlier is None else compare_runs(earlier, session)
        found = find(session, records)
        session.write_report({"validation": figures, "paired": comparison, **found})
        if folder is not None:
            write_durations(folder, figures.durations)
    config = dict(experiment.config)
    return Validation(records, figures, config, experiment.seed, experiment.items, comparison, **found)


def read_goal(start: str, goal: Path | None) -> Task:
    """Return a task, whose goal is another design if a file of one is given.

    Raises InputError for files that are wrong or do not fit, and for what has no goal.
    """
    task = as_task(start)
    if goal is not None:
        design = read_design(goal)
        return replace(task, design=design, success="built")
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
    """Run a plan or a policy in a world once, and return what moved; the shipped plan unless one is given.

    Raises InputError where there is none, and where a file is not as it should be.
    """
    if plan is not None and policy is not None:
        raise InputError("plan and policy exclude each other")
    subjects = subjects_of([world])
    if plan is not None:
        pilot = plan_pilot(read_plan(plan, subjects[0].n_cars), order)
    else:
        pilot = policy_pilot(policy or PLANNER, subjects, order, setup.rules)
    (item,) = items_of(subjects, [pilot], 1, Terms(seed, setup))
    trajectory = roll_out(item.job, record=True).trajectory
    assert trajectory is not None
    return trajectory
