"""The audit of the rules: each situation is tried in physics, and each row of situations gets a verdict on its rule."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from craftsim.audit.plan import PlanRow, corrections, distribute_trials, rows_by_flag
from craftsim.audit.situation import Situation, shipped
from craftsim.audit.stopping import (
    SOUND_SHARE,
    ErrorBound,
    RowRule,
    error_bounds,
    is_settled,
    outcomes_of,
)
from craftsim.checking.attempt import AGREEING, Verdict
from craftsim.checking.recipe import Recipe, perform_step, run_up
from craftsim.checking.setup import Seed, Setup, compile_world, set_up
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.errors import StartError
from craftsim.experiments.bundle import write_bundles
from craftsim.experiments.compare import Comparison, compare_runs, read_earlier
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial, TrialRecord
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.minimize import (
    Counterexample,
    MinimizeProgress,
    kind_of,
    minimize_failures,
)
from craftsim.experiments.records import RecordView
from craftsim.experiments.session import Session, open_session
from craftsim.experiments.statistics import (
    RESULTS,
    Figures,
    campaign_figures,
    capped_steps,
    distinct,
    retried,
    write_durations,
)
from craftsim.models.world import PhysicsWorld
from craftsim.validation.record_schemas import TRIAL_FORM

TRIALS_PER_BATCH: Final = 20
"""Trials sent to a worker together: those of few situations, so that each world is compiled about once."""
_TIMEOUT_S: Final = 120.0
MIN_TRIALS: Final = 20
"""With fewer trials the verdict of a row that is not settled is provisional."""
BOUNDED_RATES: Final = (0.8, SOUND_SHARE)
"""Success rates for which a report has the :class:`ErrorBound`."""
HYPOTHESES: Final[list[Mapping[str, Any]]] = shipped("suspects.yaml")
"""Hypotheses made before any trial: a question, and patterns of the names of the rows that decide it."""
_NOT_STANDING: Final = "does not stand"
_AT_ONCE: Final = "order=at-once"
"""Suffix of the names of rows that are evidence only."""


@dataclass(frozen=True, slots=True)
class AuditTrial:
    """The payload of one trial."""

    situation: Situation
    legal: bool
    number: int
    """Index within the situation; with the seed it decides physics and noise."""
    seed: int
    setup: Setup
    identical: int = 1
    """Number of trials that this one stands for, as nothing is drawn at random."""


def trials_of(rows: Sequence[PlanRow], trials: int, seed: int, setup: Setup) -> list[Trial]:
    """Return the trials of an audit: at least ``trials`` a row, and an empty one for a row without prediction.

    Where nothing is drawn at random all trials of a situation are identical, and the first stands for all.
    """
    items = []
    for row in rows:
        if row.no_prediction:
            items.append(Trial(row.name, row.name, seed, None))
            continue
        shared = list(distribute_trials(row, trials))
        numbers = Counter(situation.id for situation, _ in shared)
        for situation, number in shared:
            identical = 1
            if not setup.draws:
                identical = numbers[situation.id]
            if identical > 1 and number > 0:
                continue
            trial = AuditTrial(situation, row.legal, number, seed, setup, identical)
            items.append(
                Trial(f"{situation.id}#{number}", row.name, seed, trial, context=situation.id)
            )
    return items


def recipe_of(trial: AuditTrial) -> Recipe:
    """Return the recipe of a trial, whose attempts :func:`run_trial` judges."""
    digest = trial.situation.digest
    placed = trial.situation.placed(
        np.random.default_rng([trial.seed, digest])
    )  # one place for all its trials
    seed = Seed((trial.seed, digest, trial.number))
    return Recipe(blueprint_text(placed.grid), placed.steps(trial.legal), trial.setup, seed)


def run_trial(trial: AuditTrial | None) -> Result:
    """Run one trial and judge it. There are no attempts for None, and in a world that is not stable."""
    if trial is None:
        return Result(agrees=True)
    recipe = recipe_of(trial)
    problems = _problems(recipe.world, trial.setup)
    if problems:
        return Result(agrees=False, extra={"does_not_stand": list(problems)})
    attempts = perform_step(
        run_up(recipe, compiled_world(recipe.world, trial.setup)), recipe.steps[-1]
    )
    extra = {}
    if trial.identical > 1:
        extra = {"identical": trial.identical}
    agrees = all(attempt.agrees for attempt in attempts) == trial.legal
    return Result(agrees=agrees, attempts=attempts, extra=extra)


@lru_cache(maxsize=2)
def compiled_world(world: str, setup: Setup) -> PhysicsWorld:
    """Return the compiled world of a blueprint, shared by the trials that start from it."""
    return compile_world(Recipe(world).grid, setup)


@lru_cache(maxsize=1)
def _problems(text: str, setup: Setup) -> tuple[str, ...]:
    """Return how a blueprint's world, at rest in nominal physics, differs from it; empty if it does not."""
    grid = Recipe(text).grid
    world = compiled_world(text, setup)
    try:
        reading = set_up(
            grid, Setup(simulation=setup.simulation), reuse=world, watch_contacts=False
        ).reading
    except StartError as error:
        return (str(error),)
    if reading.problems or reading.grid.same_visible(grid):
        return reading.problems
    return ("the grid read from poses differs from the blueprint",)


class RuleVerdict(StrEnum):
    """The verdict on a rule in a situation."""

    UNSOUND = "unsound"
    """It allows what fails in physics."""
    CONSERVATIVE = "conservative"
    """It forbids what works in physics."""
    SOUND = "sound"
    """It allows what works."""
    RIGHTLY_FORBIDDEN = "rightly forbidden"
    """It forbids what fails in physics."""
    NO_PREDICTION = "no prediction"
    """It forbids an action without an intended effect, which cannot be tried."""
    NOT_TRIED = "not tried"
    """All trials ended with an error or in a world that cannot stand, or the solver did not converge in any."""


DISAGREEMENTS: Final = (RuleVerdict.UNSOUND, RuleVerdict.CONSERVATIVE)


@dataclass(frozen=True)
class AuditRow:
    """All trials of one action in one context, with 95 % intervals of the share as predicted, see Proportion."""

    action: str
    context: str
    legal: bool
    has_prediction: bool
    trials: int
    """Trials without error in which the solver converged; the worst attempt of each counts."""
    as_predicted: int
    retried: int
    """Those as predicted after a second try."""
    failed: int
    side_effect: int
    unsafe: int
    low: float
    high: float
    wilson_low: float
    wilson_high: float
    verdict: str
    reason: str
    """The most frequent reason why trials were not as predicted, with its count if there are others."""
    bundles: tuple[str, ...]
    numerics: int = 0
    """Trials in which the solver did not converge; they do not count for the rule."""
    errors: int = 0
    """Trials that ended with an exception, a timeout or a lost worker."""
    not_standing: int = 0
    """Trials in a world that cannot stand, where nothing was tried."""

    @property
    def name(self) -> str:
        """Name of the row, ``action/context``."""
        return f"{self.action}/{self.context}"

    @property
    def evidence(self) -> str:
        """The number of trials as predicted, and the reason of the others."""
        counts = f"{self.as_predicted} of {self.trials} as predicted"
        if self.reason:
            return f"{counts}; {self.reason}"
        return counts

    @property
    def provisional(self) -> bool:
        """Whether the verdict is one of fewer than :data:`MIN_TRIALS` trials, and not settled by them."""
        return 0 < self.trials < MIN_TRIALS and not is_settled(self.as_predicted, self.trials)


def verdict_counts(rows: Iterable[AuditRow]) -> dict[str, int]:
    """Return how many rows have each verdict, in the order of :class:`RuleVerdict`, zeros included."""
    counts = Counter(row.verdict for row in rows)
    return {str(judgement): counts[judgement] for judgement in RuleVerdict}


def judge(legal: bool, has_prediction: bool, trials: int, as_predicted: int) -> RuleVerdict:
    """Return the verdict on a rule from its trials, by :data:`SOUND_SHARE`."""
    if not has_prediction:
        return RuleVerdict.NO_PREDICTION
    if not trials:
        return RuleVerdict.NOT_TRIED
    works = as_predicted >= SOUND_SHARE * trials
    if legal:
        if works:
            return RuleVerdict.SOUND
        return RuleVerdict.UNSOUND
    if works:
        return RuleVerdict.CONSERVATIVE
    return RuleVerdict.RIGHTLY_FORBIDDEN


def audit_rows(records: Iterable[TrialRecord]) -> list[AuditRow]:
    """Return one row for each ``group`` of records, sorted by group.

    A group's name is the action, a slash and the context. A row is legal when all its attempts are; one whose trials
    have neither attempts nor errors has no prediction.
    """
    by_row = dict[str, list[_TrialSummary]]()
    for record in distinct(records):
        by_row.setdefault(record["group"], []).append(_summary(record))
    return [_audit_row(name, trials) for name, trials in sorted(by_row.items())]


class _TrialSummary(NamedTuple):
    """What a trial says of its row."""

    legal: bool
    result: str
    """That of the worst attempt, or why there is none; empty without a prediction."""
    reason: str
    bundle: str | None


_WRONG: Final = tuple(verdict for verdict in RESULTS if verdict not in AGREEING)
"""Results that have a reason."""


def _summary(record: TrialRecord) -> _TrialSummary:
    attempts = record["attempts"]
    legal = all(attempt["legal"] for attempt in attempts)
    result = ""
    reason = ""
    if "does_not_stand" in record["extra"]:
        result = _NOT_STANDING
    elif record["error"] is not None:
        result = "errors"
    elif attempts:
        worst = max(attempts, key=lambda attempt: RESULTS.index(Verdict(attempt["result"])))
        result = Verdict(worst["result"])
        reason = worst["reason"]
    return _TrialSummary(legal, result, reason, record["bundle"])


def _audit_row(name: str, trials: Sequence[_TrialSummary]) -> AuditRow:
    action, _, context = name.partition("/")
    counts = Counter(trial.result for trial in trials if trial.result)
    good = sum(counts[verdict] for verdict in AGREEING)
    n = sum(counts[result] for result in RESULTS) - counts[Verdict.NUMERICS]
    has_prediction = bool(counts)
    legal = has_prediction and all(trial.legal for trial in trials)
    share = Proportion.of(good, n)
    return AuditRow(
        action=action,
        context=context,
        legal=legal,
        has_prediction=has_prediction,
        trials=n,
        as_predicted=good,
        retried=counts[Verdict.RETRIED],
        failed=counts[Verdict.FAILED],
        side_effect=counts[Verdict.SIDE_EFFECT],
        unsafe=counts[Verdict.UNSAFE],
        low=share.low,
        high=share.high,
        wilson_low=share.wilson_low,
        wilson_high=share.wilson_high,
        verdict=judge(legal, has_prediction, n, good).value,
        reason=_commonest(
            [
                trial.reason
                for trial in trials
                if trial.result in RESULTS and trial.result not in AGREEING
            ]
        ),
        bundles=tuple(trial.bundle for trial in trials if trial.bundle),
        numerics=counts[Verdict.NUMERICS],
        errors=counts["errors"],
        not_standing=counts[_NOT_STANDING],
    )


def _commonest(reasons: Sequence[str]) -> str:
    """Return the first reason of the most frequent kind, with its count if there are others; empty for no reason."""
    kinds = Counter(map(kind_of, reasons))
    if not kinds:
        return ""
    ((commonest, n),) = kinds.most_common(1)
    reason = next(reason for reason in reasons if kind_of(reason) == commonest)
    if len(kinds) == 1:
        return reason
    return f"{reason} ({n} of {kinds.total()})"


def judge_hypotheses(rows: Sequence[AuditRow], at_once: Sequence[AuditRow]) -> list[dict[str, Any]]:
    """Return the finding on each of :data:`HYPOTHESES`; the rows ``at_once`` count as evidence only.

    A finding holds its ``number``, the ``question``, the numbers of ``rows`` and ``trials``, the ``verdict``, and as
    ``evidence`` the clearest row of the most serious verdict, with its counts and reason.
    """
    findings = []
    for number, hypothesis in enumerate(HYPOTHESES, start=1):
        matching = _matching(rows, hypothesis["rows"])
        counts = {verdict: n for verdict, n in verdict_counts(matching).items() if n}
        evidence = []
        if matching:
            gravest = next(iter(counts))
            clearest = min((row for row in matching if row.verdict == gravest), key=_clarity)
            evidence.append(f"{clearest.name}: {clearest.evidence}")
        for row in _matching(at_once, hypothesis["rows"]):
            evidence.append(f"begun all at once, {row.name}: {row.evidence}")
        findings.append(
            {
                "number": number,
                "question": hypothesis["question"],
                "rows": len(matching),
                "trials": sum(row.trials for row in matching),
                "verdict": ", ".join(f"{n} {verdict}" for verdict, n in counts.items())
                or "not tried",
                "evidence": "; ".join(evidence),
            }
        )
    return findings


def _matching(rows: Iterable[AuditRow], patterns: Sequence[str]) -> list[AuditRow]:
    """Return the rows with trials whose names match any of some patterns."""
    matching = []
    for row in rows:
        if row.trials and any(fnmatchcase(row.name, pattern) for pattern in patterns):
            matching.append(row)
    return matching


def _clarity(row: AuditRow) -> tuple[int, str]:
    """Return a sort key: the rows of which most trials disagree with the rules first."""
    if row.legal:
        return row.as_predicted, row.name
    return row.trials - row.as_predicted, row.name


@dataclass(frozen=True)
class Audit:
    """The result of an audit."""

    records: Iterable[TrialRecord]
    rows: tuple[AuditRow, ...]
    """Rows of actions in sequence, or concurrent by the schedule; not those begun all at once."""
    suspects: Sequence[Mapping[str, Any]]
    figures: Figures
    config: dict[str, Any]
    seed: int
    corrections: Mapping[str, Sequence[str]]
    comparison: Comparison | None
    smallest: tuple[Counterexample, ...] = ()
    """The first failure of each kind in its smallest world, with the option ``minimize``."""
    error_bounds: Sequence[ErrorBound] = ()
    """For each of :data:`BOUNDED_RATES`, if any row has trials enough."""


def judged_by_rules(records: Iterable[TrialRecord]) -> Iterable[TrialRecord]:
    """Return the records without those of actions begun all at once, of which the rules say nothing."""

    def view(records: Iterable[TrialRecord]) -> Iterator[TrialRecord]:
        return (record for record in records if not record["group"].endswith(_AT_ONCE))

    return RecordView(records, view)


def run_audit(
    plan: Sequence[PlanRow],
    setup: Setup,
    trials: int,
    seed: int,
    out: Path,
    *,
    selection: Mapping[str, Any],
    options: RunOptions,
    batch: int = TRIALS_PER_BATCH,
    stop: bool = False,
    minimize: MinimizeProgress | None = None,
) -> Audit:
    """Try the rows of a plan in physics, and write report.json, durations.csv and replay bundles into a folder.

    Each row has at least ``trials`` trials, and each of its situations one; with ``stop`` only as many as settle its
    verdict, see :class:`RowRule`. ``selection`` has the options that chose the rows, for the report; ``batch`` trials
    are sent to a worker together; ``minimize`` is the progress of a minimization, if any.
    """
    config = {
        **selection,
        "trials": trials,
        "stop": stop,
        "rules": setup.rules,
        **setup.provenance,
    }
    items = trials_of(plan, trials, seed, setup)
    experiment = Experiment("audit", seed, config, items, run_trial, TRIAL_FORM, _TIMEOUT_S, batch)
    earlier = read_earlier(experiment, out, options)
    with open_session(experiment, out, options) as session:
        rule = None
        if stop:
            rule = RowRule(plan)
        tried = session.run(rule)
        records = _with_bundles(tried, _bundle_disagreements(session, tried))
        smallest: tuple[Counterexample, ...] = ()
        if minimize is not None:
            smallest = minimize_failures(session, records, minimize)
        all_rows = audit_rows(records)
        at_once = tuple(row for row in all_rows if row.context.endswith(_AT_ONCE))
        rows = tuple(row for row in all_rows if row not in at_once)
        suspects = judge_hypotheses(rows, at_once)
        unsound = {row.name for row in rows if row.verdict == RuleVerdict.UNSOUND}
        flags_by_row = corrections((row for row in plan if row.name in unsound), setup.rules)
        figures = campaign_figures(judged_by_rules(records), seed)
        comparison = None
        if earlier is not None:
            comparison = compare_runs(earlier, session, judged_by_rules)
        bounds = error_bounds(outcomes_of(items, judged_by_rules(tried)), BOUNDED_RATES)
        audit_figures = {
            "verdicts": verdict_counts(rows),
            "provisional": sum(row.provisional for row in rows),
            "error_bounds": bounds,
            "contexts": sum(len(row.members) for row in plan),
            "corrections": rows_by_flag(flags_by_row),
            "rows": _row_figures(rows, plan, flags_by_row),
            "at_once": at_once,
            "suspects": suspects,
            "capped_steps": capped_steps(records),
            "retried": retried(records),
        }
        session.write_report(
            {
                "audit": audit_figures,
                "validation": figures,
                "paired": comparison,
                "smallest": smallest,
            }
        )
        write_durations(out, figures.durations)
    return Audit(
        records, rows, suspects, figures, config, seed, flags_by_row, comparison, smallest, bounds
    )


def _with_bundles(
    records: Iterable[TrialRecord], bundles: Mapping[int, str]
) -> Iterable[TrialRecord]:
    """Return a view of records with these replay bundles, by the index of the record."""

    def view(records: Iterable[TrialRecord]) -> Iterator[TrialRecord]:
        for record in records:
            yield {**record, "bundle": bundles.get(record["index"], record["bundle"])}

    return RecordView(records, view)


def _row_figures(
    rows: Iterable[AuditRow], plan: Iterable[PlanRow], flags_by_row: Mapping[str, Sequence[str]]
) -> list[dict[str, Any]]:
    """Return what ``report.json`` has of each row."""
    planned = {row.name: row for row in plan}
    row_figures = []
    for row in rows:
        row_figures.append(
            {
                **asdict(row),
                "contexts": len(planned[row.name].members),
                "clearance_mm": planned[row.name].clearance_mm,
                "corrections": flags_by_row.get(row.name, ()),
            }
        )
    return row_figures


def _bundle_disagreements(session: Session, records: Sequence[TrialRecord]) -> dict[int, str]:
    """Write the replay bundle of the first disagreement of each unsound or conservative row.

    Returns the folders of the bundles, relative to the run's, by the index of the record.
    """
    rows = [row for row in audit_rows(records) if not row.context.endswith(_AT_ONCE)]
    disagreeing = {row.name for row in rows if row.verdict in DISAGREEMENTS}
    first: dict[str, int] = {}
    for record in records:
        if record["group"] in disagreeing and record["attempts"] and not record["agrees"]:
            first.setdefault(record["group"], record["index"])
    items = session.experiment.items
    return write_bundles(
        session, {index: partial(recipe_of, items[index].job) for index in first.values()}
    )
