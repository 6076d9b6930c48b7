"""Validation of plans, lists of actions and policies in physics: the whole job in one call."""

from __future__ import annotations

import html
import warnings
from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from craftsim.checking.attempt import Attempt
from craftsim.discrete.files.plan import Plan
from craftsim.errors import InputError
from craftsim.experiments.compare import Comparison, compare_runs, read_earlier
from craftsim.experiments.durations import write_durations
from craftsim.experiments.experiment import Experiment, Item, Progress, TrialRecord
from craftsim.experiments.session import open_session
from craftsim.experiments.statistics import Figures, campaign_figures
from craftsim.options import Physics, Rollouts, Trials, changed
from craftsim.skills.executor import Observer
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
from craftsim.validation.runs.policies import RANDOM
from craftsim.validation.runs.run import Terms, do_run
from craftsim.validation.shrinking.campaign import ShrinkProgress, Shrunk, shrink_failures

if TYPE_CHECKING:
    from pandas import DataFrame

COMMAND: Final = "validate"
ROLLOUTS: Final = Rollouts()
PHYSICS: Final = Physics()
TRIALS: Final = Trials()
_FORMER: Final = {"against": "baseline", "shrink": "minimize"}
"""Arguments of validate that were called otherwise."""


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
    what: Rollouts = ROLLOUTS,
    physics: Physics = PHYSICS,
    campaign: Trials = TRIALS,
    *,
    out: str | Path | None = None,
    record: bool = False,
    observers: Iterable[Observer] = (),
    progress: Progress = lambda total: nullcontext(lambda record: None),
    minimize: ShrinkProgress | None = None,
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
        pilots = [plan_pilot(plan if isinstance(plan, Plan) else Path(plan), subjects[0], order)]
    elif actions is not None:
        pilots = [actions_pilot(Path(actions), subjects[0])]
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
    experiment = Experiment(COMMAND, seed, config, items, do_run, RUNS, timeout_s)
    how = campaign.run(progress)
    earlier = read_earlier(experiment, folder, how)
    with open_session(experiment, folder, how) as session:
        records = session.run()
        figures, coverage = campaign_figures(records, seed), Coverage.of(records)
        comparison = None if earlier is None else compare_runs(earlier, session)
        smallest = () if minimize is None else shrink_failures(session, records, minimize)
        found = {"validation": figures, "paired": comparison, "coverage": coverage, "smallest": smallest}
        session.write_report(found)
        if folder is not None:
            write_durations(folder, figures.durations)
    return Validation(records, figures, config, seed, items, comparison, coverage, smallest)
