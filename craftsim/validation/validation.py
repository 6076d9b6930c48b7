"""Validation of plans, action lists, policies and planners in physics, in one call."""

from __future__ import annotations

import html
import math
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
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
from craftsim.experiments.experiment import Experiment, Progress, TrialRecord
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.session import open_session
from craftsim.experiments.statistics import Figures, campaign_figures, carried_out, write_durations
from craftsim.options import Physics, Rollouts, Trials, changed
from craftsim.planning import Planned, plan_building
from craftsim.rendering.trajectory import Trajectory
from craftsim.skills.executor import Observer
from craftsim.validation import choice
from craftsim.validation.choice import World
from craftsim.validation.forms import BUILDS, RUNS
from craftsim.validation.minimize import Counterexample, MinimizeProgress, minimize_failures
from craftsim.validation.play import coverage_of
from craftsim.validation.policies import RANDOM
from craftsim.validation.replanning import Replanning
from craftsim.validation.rollout import PlanOrder, do_run, roll_out

if TYPE_CHECKING:
    from pandas import DataFrame

ROLLOUTS: Final = Rollouts()
PHYSICS: Final = Physics()
TRIALS: Final = Trials()
REPLANNING: Final = Replanning()
_FORMER: Final = {"against": "baseline", "shrink": "minimize"}


def build_figures(records: Iterable[TrialRecord]) -> dict[str, Any]:
    """Return the metrics of all buildings of a run: the share ``built`` of all that finished, the number of each
    ending, of further plans and of disturbances, and the medians of the first plan's and of the real makespan in
    simulated seconds."""
    extras = [record["extra"] for record in carried_out(records)]
    endings = Counter(extra["ended"] for extra in extras)
    times = [extra["makespan_s"] for extra in extras if extra["ended"] == "built"]
    return {
        "built": Proportion.of(endings["built"], len(extras)),
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
        """Whether every run is as predicted, within all limits."""
        return self.n_agree == len(self.records)

    @property
    def n_agree(self) -> int:
        """Number of runs as predicted."""
        return sum(record["agrees"] for record in self.records)

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
        runs, legal = f"{self.n_agree} of {len(self.records)} runs agree", self.figures.matrix["legal"]
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
        >>> craftsim.validate("strip", policy="random", drive="reduced", trials=1, seed=3).agrees
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
    whole = all(isinstance(one, int | np.integer) and one > 0 for one in (trials, campaign.workers))
    if not whole or not timeout_s > 0:
        raise InputError("trials and workers must be whole numbers of at least 1, timeout_s above 0")
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
    subjects = choice.subjects_of(several, what.n_cars, what.n_blocks, what.max_steps)
    n_cars = subjects[0].n_cars if subjects else 0
    if plan == choice.AUTO:
        pilots = [choice.replanning_pilot(replanning, subjects)]
    elif plan is not None:
        read = plan if isinstance(plan, Plan) else read_plan(Path(plan), n_cars)
        pilots = [choice.plan_pilot(read, order)]
    elif actions is not None:
        pilots = [choice.plan_pilot(read_actions(Path(actions), n_cars), "sequential")]
    else:
        chosen = policy or (choice.PLAY if all(s.name == RANDOM for s in subjects) else choice.PLANNER)
        named = [chosen] if isinstance(chosen, str) or callable(chosen) else list(chosen)
        asked = subjects, order, physics.rules, timeout_s
        pilots = [choice.policy_pilot(one, *asked) for one in dict.fromkeys(named)]
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
    choice.check_starts(subjects, setup, seed)
    terms = {"out": folder and folder.resolve(), "observers": tuple(observers), "record": record}
    items = list(choice.items_of(subjects, pilots, trials, seed, setup, order=order, **terms))
    form = BUILDS if plan == choice.AUTO else RUNS
    experiment = Experiment("validate", seed, config, items, do_run, form, timeout_s)
    how = campaign.run(progress)
    earlier = read_earlier(experiment, folder, how)
    if plan == choice.AUTO:
        # Fail before the run starts if nothing can be built; finding out may take long.
        rng, rules, rounds = np.random.default_rng(seed), Rules(setup.rules), replanning.rounds
        first = as_task(items[0].job.world).for_episode(rng)
        plan_building(first.draw(rng), first, rules, rounds=rounds, time_s=math.inf, report=_enough)
    with open_session(experiment, folder, how) as session:
        records = session.run()
        figures = campaign_figures(records, seed)
        comparison = None if earlier is None else compare_runs(earlier, session)
        smallest = () if minimize is None else minimize_failures(session, records, minimize)
        found: dict[str, Any] = {"coverage": coverage_of(records), "smallest": smallest}
        if plan == choice.AUTO:
            found["builds"] = build_figures(records)
        session.write_report({"validation": figures, "paired": comparison, **found})
        if folder is not None:
            write_durations(folder, figures.durations)
    return Validation(records, figures, config, seed, comparison, **found)


def _enough(number: int, best: Planned | None) -> None:
    """Stop planning as soon as there is a plan."""
    if best is not None:
        raise KeyboardInterrupt


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
    subjects = choice.subjects_of([world])
    if plan is None:
        pilot = choice.policy_pilot(policy or choice.PLANNER, subjects, order, setup.rules)
    elif policy is not None:
        raise InputError("plan and policy exclude each other")
    else:
        pilot = choice.plan_pilot(read_plan(plan, subjects[0].n_cars), order)
    (item,) = choice.items_of(subjects, [pilot], 1, seed, setup, order=order, record=True)
    trajectory = roll_out(item.job).trajectory
    assert trajectory is not None
    return trajectory
