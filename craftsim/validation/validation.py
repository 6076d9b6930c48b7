"""Validation of plans, action lists, policies and planners in physics, in one call."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final, get_args

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.setup import Setup
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError, check_choice
from craftsim.experiments.certificate import Certificate, CertificationRule, Decision
from craftsim.experiments.compare import Comparison, compare_runs, read_earlier
from craftsim.experiments.experiment import Experiment, Progress, TrialRecord
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.minimize import Counterexample, MinimizeProgress, minimize_failures
from craftsim.experiments.session import open_session
from craftsim.experiments.statistics import (
    Figures,
    campaign_figures,
    carried_out,
    distinct,
    write_durations,
)
from craftsim.planning import Planned, plan_building
from craftsim.skills.executor import Observer
from craftsim.skills.library import WENT_BACK
from craftsim.tasks import as_task
from craftsim.validation.options import Physics, Rollouts, RunTrials, changed
from craftsim.validation.play import coverage_of
from craftsim.validation.record_schemas import BUILD_FORM, RUN_FORM
from craftsim.validation.replanning import Replanning
from craftsim.validation.rollout import PlanOrder, run_job
from craftsim.validation.sources import (
    AUTO,
    ActionSource,
    RolloutWorld,
    WorldSource,
    action_sources,
    check_starts,
    rollout_trials,
    rollout_worlds,
)

if TYPE_CHECKING:
    from pandas import DataFrame

ROLLOUTS: Final = Rollouts()
_PHYSICS: Final = Physics()
_TRIALS: Final = RunTrials()
REPLANNING: Final = Replanning()
_NUMBERS: Final = "trials and workers must be whole numbers of at least 1, timeout_s above 0"


def build_figures(records: Iterable[TrialRecord]) -> dict[str, Any]:
    """Return the metrics of all buildings of a run: the share ``built`` of all that finished, the number of each
    ending, of further plans, of actions after whose failure a car went back, of loads that were seated again, and of
    disturbances, and the medians of the first plan's and of the real makespan in simulated seconds."""
    went_back = 0
    for record in carried_out(records):
        went_back += sum(attempt["skill"].endswith(WENT_BACK) for attempt in record["attempts"])
    extras = [record["extra"] for record in carried_out(records)]
    different = [record["extra"]["ended"] == "built" for record in carried_out(distinct(records))]
    endings = Counter(extra["ended"] for extra in extras)
    makespans_s = [extra["makespan_s"] for extra in extras if extra["ended"] == "built"]
    return {
        "built": Proportion.of(sum(different), len(different)),
        "endings": dict(sorted(endings.items())),
        "replans": sum(extra["replans"] for extra in extras),
        "went_back": went_back,
        "seated": sum(extra.get("seated", 0) for extra in extras),
        "disturbed": sum(bool(extra["disturbed"]) for extra in extras),
        "planned_s": _median([extra["planned_s"] for extra in extras]),
        "real_s": _median(makespans_s),
    }


def recovery_figures(records: Iterable[TrialRecord]) -> dict[str, int] | None:
    """Return what policies needed in all runs with recovery; None where there are none.

    Numbers of ``runs``, of those in which the planner went on in place of the policy (``planner_runs``), of its
    ``plans``, of actions after whose failure a car ``went_back``, and of loads that were ``seated`` again.
    """
    totals = dict.fromkeys(("runs", "planner_runs", "plans", "went_back", "seated"), 0)
    for record in carried_out(records):
        recovery = record["extra"].get("recovery")
        if recovery is None:
            continue
        totals["runs"] += 1
        totals["planner_runs"] += bool(recovery["replaces"])
        totals["plans"] += recovery["plans"]
        totals["seated"] += recovery["seated"]
        totals["went_back"] += sum(
            attempt["skill"].endswith(WENT_BACK) for attempt in record["attempts"]
        )
    if not totals["runs"]:
        return None
    return totals


def success_of(sources: Iterable[ActionSource]) -> Callable[[TrialRecord], bool]:
    """Return the function that says whether a run is a success for a certificate.

    A run of a plan is one if every action is as predicted, and the goal, if any, is built. That of a policy, or with
    replanning, is one if the goal is built, whatever happened on the way. One that does not finish is none.
    """
    plans = {source.name for source in sources if source.follows_plan}

    def succeeds(record: TrialRecord) -> bool:
        extra = record["extra"]
        if record["error"] is not None:
            return False
        if "ended" in extra:
            return bool(extra["ended"] == "built")
        builds = bool(extra.get("physics_success", True))
        if record["group"] in plans or "physics_success" not in extra:
            return builds and record["agrees"] and bool(record["attempts"])
        return builds

    return succeeds


def _median(values: Sequence[float]) -> float | None:
    if not values:
        return None
    return median(values)


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
    recovery: dict[str, int] | None = None
    """What policies needed with recovery, as of :func:`recovery_figures`."""
    certificates: tuple[Certificate, ...] = ()
    """With the option ``certify``: what is certain of each plan or policy."""

    @property
    def report_figures(self) -> dict[str, Any]:
        """The figures of ``report.json``."""
        figures: dict[str, Any] = {
            "validation": self.figures,
            "paired": self.comparison,
            "coverage": self.coverage,
            "smallest": self.smallest,
        }
        if self.builds is not None:
            figures["builds"] = self.builds
        if self.recovery is not None:
            figures["recovery"] = self.recovery
        if self.certificates:
            figures["certificates"] = self.certificates
        return figures

    @property
    def all_certified(self) -> bool:
        """Whether every certificate that was asked for says yes."""
        return all(certificate.decision == Decision.YES for certificate in self.certificates)

    @property
    def all_built(self) -> bool:
        """Whether every building with replanning was built."""
        return self.builds is not None and self.builds["endings"].get("built", 0) == len(
            self.records
        )

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
        return sum(
            bool(record["attempts"]) or record["error"] is not None for record in self.records
        )

    @property
    def attempts(self) -> list[Attempt]:
        """All attempts, in the order of the runs."""
        attempts = []
        for record in self.records:
            for attempt in record["attempts"]:
                attempts.append(Attempt.of(attempt))
        return attempts

    def to_frame(self) -> DataFrame:
        """Return a table with a row for each action: its run's world, plan and episode, and the fields of Attempt."""
        from pandas import DataFrame

        rows = []
        for r in self.records:
            for attempt in r["attempts"]:
                rows.append(
                    {"world": r["context"], "by": r["group"], "episode": r["episode"], **attempt}
                )
        columns = ["world", "by", "episode", *Attempt.__dataclass_fields__]
        return DataFrame(rows, columns=columns)

    def __repr__(self) -> str:
        runs = f"{self.n_agree} of {self.n_judged} runs agree"
        legal = self.figures.matrix["legal"]
        return f"Validation({runs}, {legal.as_predicted} of {legal.trials} actions as predicted)"

    def _repr_html_(self) -> str:
        frame = self.to_frame()
        counts = (
            frame.groupby(["world", "by", "verb"])["result"].value_counts().unstack(fill_value=0)
        )
        return f"<p><b>{html.escape(repr(self))}</b></p>{counts.to_html()}"


def validate(
    worlds: WorldSource | Iterable[WorldSource],
    rollouts: Rollouts = ROLLOUTS,
    physics: Physics = _PHYSICS,
    campaign: RunTrials = _TRIALS,
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
        rollouts: plan, action list or policies, and their execution.
        physics: rules, randomization, gains, machines, drive and seed.
        campaign: number of trials and workers.
        out: folder for report.json, trials.jsonl, durations.csv and replay bundles; without it nothing is written.
        record: write a trajectory of each run into the folder ``trajectories`` of ``out``.
        observers: functions called with a run's world after every control period; they must not change it.
        progress: progress display.
        minimize: progress of the minimization of the first failure of each kind; None for no minimization.
        replanning: numbers of plans, and the disturbance, for the plan ``auto``.
        options: any field of ``Rollouts``, ``Physics`` and ``RunTrials`` in :mod:`craftsim.validation.options` by
            name, such as ``policy``, ``randomize`` or ``trials``. In addition to the values on the command line,
            ``plan`` may be a Plan, ``policy`` a function from the observations by agent to the actions by agent,
            ``gains`` Gains, ``machines`` Machines, ``noise`` and ``assume`` SensorNoise, and ``skills`` a mapping
            such as ``{Action.LIFT: MyLift}`` with subclasses of :class:`craftsim.Skill`.

    Raises:
        InputError: an argument, or a file that it names, is invalid.

    Example:
        >>> import craftsim
        >>> craftsim.validate("strip", policy="random", trials=1, seed=3).agrees
        True
    """
    minimize = options.pop("minimize", minimize)
    rollouts, physics, campaign = changed((rollouts, physics, campaign), options)
    if isinstance(worlds, WorldSource):
        references = [worlds]
    else:
        references = list(worlds)
    _check_options(rollouts, campaign, len(references))
    _check_folder(out, campaign, record or minimize is not None)
    chosen_worlds = rollout_worlds(
        references, rollouts.n_cars, rollouts.n_blocks, rollouts.max_steps
    )
    setup = physics.setup()
    if rollouts.plan == AUTO and rollouts.replans is not None:
        replanning = replace(replanning, replans=rollouts.replans)
    sources = action_sources(rollouts, chosen_worlds, setup.rules, replanning)
    recovers = bool(rollouts.replans) and rollouts.plan != AUTO
    if recovers:
        _check_recovery(sources, chosen_worlds)
        setup = replace(setup, recovers=True)
    if campaign.certify is not None and not setup.draws and all(w.is_fixed for w in chosen_worlds):
        raise InputError(
            "with --randomize none all runs are alike and say nothing of a success rate; --certify needs a "
            "randomization, such as mild"
        )
    check_starts(chosen_worlds, setup, physics.seed)
    folder = None
    resolved_folder = None
    if out is not None:
        folder = Path(out)
        resolved_folder = folder.resolve()
    order = rollouts.order
    if rollouts.actions is not None:
        order = "sequential"
    trials = rollout_trials(
        chosen_worlds,
        sources,
        campaign.most_trials,
        physics.seed,
        setup,
        order=order,
        out=resolved_folder,
        observers=tuple(observers),
        record=record,
        replans=rollouts.replans if recovers else 0,
    )
    replans = rollouts.plan == AUTO
    form = RUN_FORM
    if replans:
        form = BUILD_FORM
    experiment = Experiment(
        "validate",
        physics.seed,
        _configuration(chosen_worlds, sources, rollouts, physics, campaign, setup, record),
        list(trials),
        run_job,
        form,
        rollouts.timeout_s,
    )
    run_options = campaign.run(progress)
    earlier = read_earlier(experiment, folder, run_options)
    if replans:
        _check_plan_exists(experiment, setup, replanning)
    with open_session(experiment, folder, run_options) as session:
        rule = None
        if campaign.certify is not None:
            rule = CertificationRule(campaign.certify, campaign.confidence, success_of(sources))
        records = session.run(rule)
        certificates: tuple[Certificate, ...] = ()
        if rule is not None:
            certificates = tuple(rule.certificates())
        figures = campaign_figures(records, physics.seed)
        comparison = None
        if earlier is not None:
            comparison = compare_runs(earlier, session)
        coverage = coverage_of(records)
        smallest: tuple[Counterexample, ...] = ()
        if minimize is not None:
            smallest = minimize_failures(session, records, minimize)
        builds = None
        if replans:
            builds = build_figures(records)
        result = Validation(
            records,
            figures,
            dict(experiment.config),
            physics.seed,
            comparison,
            coverage,
            smallest,
            builds,
            recovery_figures(records),
            certificates,
        )
        session.write_report(result.report_figures)
        if folder is not None:
            write_durations(folder, figures.durations)
    return result


def _check_options(rollouts: Rollouts, campaign: RunTrials, n_worlds: int) -> None:
    """Raise InputError for options that are invalid, or exclude each other."""
    check_choice("order", rollouts.order, get_args(PlanOrder))
    for number in (campaign.most_trials, campaign.workers):
        if not isinstance(number, int | np.integer) or number < 1:
            raise InputError(_NUMBERS)
    if not rollouts.timeout_s > 0:
        raise InputError(_NUMBERS)
    options = {"plan": rollouts.plan, "actions": rollouts.actions, "policy": rollouts.policy}
    chosen = [name for name, value in options.items() if value]
    if len(chosen) > 1:
        raise InputError(f"--{chosen[0]} and --{chosen[1]} exclude each other; give one of them")
    if chosen and chosen[0] != "policy" and n_worlds != 1:
        raise InputError(f"{chosen[0]} needs the one world that it is for")


def _check_recovery(sources: Iterable[ActionSource], worlds: Iterable[RolloutWorld]) -> None:
    """Raise InputError for further plans where no policy is played, or in a world without a goal."""
    for source in sources:
        if source.follows_plan:
            raise InputError(
                f"--replans does not go with {source.name}; it goes with --plan auto, and with a --policy for which "
                "the planner goes on"
            )
    for world in worlds:
        if not world.has_goal:
            raise InputError(
                f"{world.name} has no goal to plan for; leave out --replans, or choose another world"
            )


def _check_folder(out: str | Path | None, campaign: RunTrials, writes: bool) -> None:
    """Raise InputError for a run that needs a folder, and has none; one that ``writes`` needs one."""
    if out is not None:
        return
    is_distributed = campaign.workers > 1 or campaign.engine != "local"
    if is_distributed or campaign.resume or campaign.baseline or writes:
        raise InputError(
            "several workers, an engine, resume, baseline, minimize and record need the folder 'out'"
        )


def _configuration(
    worlds: Iterable[RolloutWorld],
    sources: Iterable[ActionSource],
    rollouts: Rollouts,
    physics: Physics,
    campaign: RunTrials,
    setup: Setup,
    record: bool,
) -> dict[str, Any]:
    """Return all that determines the results of a validation, without the seed."""
    return {
        "worlds": {world.name: world.digest for world in worlds},
        "by": {source.name: source.digest for source in sources},
        "trials": campaign.most_trials,
        "certify": campaign.certify,
        "confidence": campaign.confidence,
        "randomize": str(physics.randomize),
        "rules": setup.rules,
        "order": rollouts.order,
        "record": record,
        **setup.provenance,
    }


def _check_plan_exists(experiment: Experiment, setup: Setup, replanning: Replanning) -> None:
    """Raise NoPlanError where nothing can be built, before the run starts: its trials would take long to find out."""
    rng = np.random.default_rng(experiment.seed)
    task = as_task(experiment.items[0].job.world).for_episode(rng)
    plan_building(
        task.draw(rng),
        task,
        Rules(setup.rules),
        rounds=replanning.rounds,
        time_s=experiment.timeout_s,
        report=_has_plan,
    )


def _has_plan(attempts: int, best: Planned | None) -> bool:
    """Return whether there is a plan, which ends the search."""
    return best is not None
