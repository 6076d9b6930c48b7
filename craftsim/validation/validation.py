"""Validation of plans, lists of actions and policies in physics: the whole job in one call."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from craftsim.checking.attempt import Attempt
from craftsim.checking.setup import Randomize, setup_of
from craftsim.discrete.files.plan import Plan
from craftsim.discrete.rules import RuleSet
from craftsim.errors import InputError
from craftsim.experiments.compare import Comparison, compare_runs, read_earlier
from craftsim.experiments.durations import write_durations
from craftsim.experiments.experiment import Experiment, Item, Progress, RunOptions, TrialRecord
from craftsim.experiments.session import open_session
from craftsim.experiments.statistics import Figures, campaign_figures
from craftsim.mjcf.parameters import Drive, Machines
from craftsim.models.sensing import SensorNoise
from craftsim.skills.executor import Observer
from craftsim.skills.gains import Gains
from craftsim.skills.library import SkillChoice
from craftsim.validation.forms import RUNS
from craftsim.validation.play.play import Coverage
from craftsim.validation.runs.choice import (
    PLANNER,
    PLAY,
    World,
    actions_pilot,
    check_starts,
    items_of,
    plan_pilot,
    policy_pilot,
    subjects_of,
)
from craftsim.validation.runs.policies import RANDOM, Policy
from craftsim.validation.runs.run import Terms, do_run
from craftsim.validation.runs.steps import PlanOrder
from craftsim.validation.shrinking.campaign import ShrinkProgress, Shrunk, shrink_failures
from craftsim.workers.pool import Engine

if TYPE_CHECKING:
    from pandas import DataFrame

COMMAND: Final = "validate"


@dataclass(frozen=True, repr=False)
class Validation:
    """The result of a validation.

    Example:
        >>> import craftsim
        >>> result = craftsim.validate("strip")
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
    items: Sequence[Item]
    """What was run, parallel to the records."""
    comparison: Comparison | None = None
    """With an earlier run, where one was given."""
    coverage: Coverage | None = None
    """Of random play, where there was some."""
    smallest: tuple[Shrunk, ...] = ()
    """The first failure of each kind in its smallest world, where that was asked for."""

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
    *,
    plan: str | Path | Plan | None = None,
    actions: str | Path | None = None,
    policy: str | Policy | Iterable[str] | None = None,
    rules: RuleSet = "physical",
    randomize: Randomize | str | Path = "none",
    gains: Gains | str | Path | None = None,
    machines: Machines | str | Path | None = None,
    noise: SensorNoise | str | Path | None = None,
    assume: SensorNoise | str | Path | None = None,
    drive: Drive | None = None,
    skills: SkillChoice | None = None,
    order: PlanOrder = "ticks",
    trials: int = 1,
    seed: int = 0,
    workers: int = 1,
    engine: Engine = "local",
    timeout_s: float = 600.0,
    out: str | Path | None = None,
    resume: bool = False,
    against: str | Path | None = None,
    n_cars: int | None = None,
    n_blocks: int | None = None,
    max_steps: int | None = None,
    observers: Iterable[Observer] = (),
    progress: Progress = lambda total: nullcontext(lambda record: None),
    shrink: ShrinkProgress | None = None,
    record: bool = False,
) -> Validation:
    """Run plans, lists of actions or policies in physics and judge every action on the poses that it ends with.

    Args:
        worlds: one or several: a task, a blueprint's path, a shipped task's name, ``module:factory``, a Grid; or
            ``random`` for worlds that each run draws anew.
        plan: to be carried out in the one world; the shipped plan of shipped tasks unless anything else is given.
        actions: file of actions to be tried one after the other in the one world.
        policy: ``play`` (random play by the rules that prefers the rare; the default in ``random`` worlds), ``random``,
            ``planner``, ``module:function``, what ``craftsim train`` wrote, or a function from the
            observations by agent to the actions by agent; several names are compared with each other.
        rules: the rule set that predicts, and by which policies may act.
        randomize: what is drawn of physics, floor, machines, motors and sensors: a preset's name, or a file;
            sets the limits of the errors, too.
        gains: of the skills, or a file of them.
        machines: parameters of the machines, or a file of them, which may hold gains, too.
        noise: of the sensors and motors, or a file of it, in place of that of ``randomize``.
        assume: what the cars take that noise to be before they find out, whatever it is: none, mild, strong, noise, or
            a file of it; ASSUMED of :mod:`craftsim.models.sensing` unless given.
        drive: rollers or reduced; that of the machines unless given.
        skills: of your own in place of built-in ones, ``{Action.LIFT: MyLift}`` with subclasses of
            :class:`craftsim.Skill`, for one car ``{0: {Action.LIFT: MyLift}}``, or ``module:NAME`` of such a mapping.
        order: how plans are carried out.
        trials: how many runs of each; under ``randomize="none"`` in a fixed world all are alike.
        seed: decides all that is drawn; the same for every plan and policy.
        workers: processes to share the work; results do not depend on it.
        engine: processes of this machine, or an existing Ray cluster.
        timeout_s: after which a run counts as hanging; in force where there is a folder for results.
        out: folder for report.json, trials.jsonl, durations.csv and replay bundles; nothing is written without.
        resume: go on with what an interrupted validation has left in ``out``.
        against: folder of an earlier validation under other settings, to compare run by run.
        n_cars: other than a named world's number of cars; those that its start does not list are drawn at random.
        n_blocks: the same for blocks.
        max_steps: length of an episode in ``random`` worlds, less two ticks.
        observers: functions that are called with a run's world after every control period; they may look, not touch.
        progress: shows what is done.
        shrink: shows how the first failure of each kind is shrunk to its smallest world; unless given, none is.
        record: write a trajectory of each run into the folder ``trajectories`` of ``out``.

    Raises:
        InputError: an argument, or a file that it names, is not as it should be.

    Example:
        >>> import craftsim
        >>> craftsim.validate("strip", policy="random", randomize="mild", seed=3).agrees
        True
    """
    if trials < 1 or workers < 1 or not timeout_s > 0:
        raise InputError("trials and workers must be at least 1, timeout_s above 0")
    several = [worlds] if isinstance(worlds, World) else list(worlds)
    given = [name for name, value in (("plan", plan), ("actions", actions), ("policy", policy)) if value]
    if len(given) > 1:
        raise InputError(f"{given[0]} and {given[1]} exclude each other")
    if given and given[0] != "policy" and len(several) != 1:
        raise InputError(f"{given[0]} needs the one world that it is for")
    if out is None and (workers > 1 or engine != "local" or resume or against or shrink or record):
        raise InputError(
            "several workers, an engine, resume, against, shrink and record need the folder 'out'"
        )
    subjects = subjects_of(several, n_cars, n_blocks, max_steps)
    if plan is not None:
        pilots = [plan_pilot(plan if isinstance(plan, Plan) else Path(plan), subjects[0], order)]
    elif actions is not None:
        pilots = [actions_pilot(Path(actions), subjects[0])]
    else:
        default = PLAY if all(s.name == RANDOM for s in subjects) else PLANNER
        chosen = policy or default
        named = [chosen] if isinstance(chosen, str) or callable(chosen) else list(chosen)
        pilots = [policy_pilot(one, subjects, order, rules, timeout_s) for one in dict.fromkeys(named)]
    folder = None if out is None else Path(out)
    setup = setup_of(randomize, rules, gains, machines, noise, assume, drive, skills)
    config: dict[str, Any] = {
        "worlds": {subject.name: subject.digest for subject in subjects},
        "by": {pilot.name: pilot.digest for pilot in pilots},
        "trials": trials,
        "randomize": str(randomize),
        "rules": rules,
        "order": order,
        "record": record,
        "setup": setup,
        "digests": setup.digests,
    }
    check_starts(subjects, setup, seed)
    terms = Terms(seed, setup, None if folder is None else folder.resolve(), tuple(observers), record)
    items = list(items_of(subjects, pilots, trials, terms))
    experiment = Experiment(COMMAND, seed, config, items, do_run, RUNS, timeout_s)
    earlier_run = None if against is None else Path(against)
    options = RunOptions(workers, engine, resume, earlier_run, progress)
    earlier = read_earlier(experiment, folder, options)
    with open_session(experiment, folder, options) as session:
        records = session.run()
        figures, coverage = campaign_figures(records, seed), Coverage.of(records)
        comparison = None if earlier is None else compare_runs(earlier, session)
        smallest = () if shrink is None else shrink_failures(session, records, shrink)
        found = {"validation": figures, "paired": comparison, "coverage": coverage, "smallest": smallest}
        session.write_report(found)
        if folder is not None:
            write_durations(folder, figures.durations)
    return Validation(records, figures, config, seed, items, comparison, coverage, smallest)
