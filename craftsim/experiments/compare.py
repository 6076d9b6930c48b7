"""Two runs of the same trials, paired by key: outcomes, durations, errors, forces and ranks with intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import AGREEING
from craftsim.errors import InputError
from craftsim.experiments.experiment import Experiment, Form, RunOptions, TrialRecord
from craftsim.experiments.intervals import (
    CONFIDENCE,
    Estimate,
    Proportion,
    RankAgreement,
    agreement_of,
    least_detectable_of_pairs,
    paired_difference,
)
from craftsim.experiments.records import Finished, RecordView, differences, read_finished
from craftsim.experiments.session import Session
from craftsim.experiments.statistics import (
    Distribution,
    attempts_frame,
    carried_out,
    distinct,
    errors,
    repeated,
    trials_frame,
    without_keys,
)
from craftsim.storage.paths import resolved

if TYPE_CHECKING:
    from pandas import DataFrame

_KINDS_IN_TEXT: Final = 6
"""Kinds of differences that a text names."""


@dataclass(frozen=True)
class PairedTrials:
    """Trials that were run under two settings, paired by their keys, and how many agree under which setting.

    Two worlds, the grid and physics among them, are compared by it where both ran the same trials, and by
    :class:`craftsim.experiments.intervals.RankAgreement` over policies, whose success rates may come from elsewhere.
    """

    pairs: int
    unpaired: int
    """Trials of only one of the runs, left out."""
    both: int
    only_first: int
    only_second: int
    neither: int
    first: Proportion
    second: Proportion
    p_value: float
    """Two-sided p-value of McNemar's exact test."""

    @property
    def difference(self) -> Estimate:
        """Difference of the shares that agree, second minus first."""
        return paired_difference(self.only_first, self.only_second, self.pairs)

    @property
    def differ(self) -> bool:
        """Whether the interval of the difference excludes zero."""
        difference = self.difference
        if difference.low is None or difference.high is None:
            return False
        return not difference.low <= 0 <= difference.high

    @property
    def least_detectable(self) -> float:
        """The least difference that would be told from none in four of five comparisons of as many pairs."""
        return least_detectable_of_pairs(self.only_first, self.only_second, self.pairs)

    def words(self, first: str, second: str) -> str:
        """Return the counts as a sentence after "of"; the arguments name the settings."""
        return (
            f"{self.pairs} paired trials {self.both} agree with the rules in both, {self.only_first} only {first}, "
            f"{self.only_second} only {second}, {self.neither} in neither; McNemar's exact test: "
            f"p = {self.p_value:.3g}."
        )


@dataclass(frozen=True)
class PairedActions:
    """PairedTrials actions of two runs: those of each trial, in order, up to the first that differs in kind."""

    actions: int
    as_predicted_alike: int
    """Number as predicted in both runs or in neither."""
    legal: Proportion
    """The same among the actions that the rules allow."""
    duration_ratio: float | None
    """Second by first run, the median over actions as predicted in both; None without any."""
    error_ratio: float | None
    """The same of the car's distance from its cell's centre."""
    peak_force_ratio: float | None
    """The same of the largest force between two machines."""
    differences: Sequence[Mapping[str, Any]]
    """What was as predicted in only one of the runs, the most frequent first: the ``kind`` (verb, load, slope, and the
    two results), the number of ``actions``, and as an ``example`` the key of the first trial with such an action."""

    @property
    def share(self) -> float:
        """Share as predicted in both runs or in neither."""
        if self.actions:
            return self.as_predicted_alike / self.actions
        return 1.0

    def __str__(self) -> str:
        if not self.actions:
            return "No action is in both runs."
        medians = {
            "durations": self.duration_ratio,
            "errors": self.error_ratio,
            "peak forces": self.peak_force_ratio,
        }
        ratios = [
            f"{name} {ratio:.3f} times theirs"
            for name, ratio in medians.items()
            if ratio is not None
        ]
        at_the_median = ""
        if ratios:
            at_the_median = f"; at the median {', '.join(ratios)}"
        lines = [
            f"Of {self.actions:,} actions {self.share:.2%} went as predicted in both or in neither, and "
            f"{self.legal.successes:,} of the {self.legal.trials:,} that the rules allow{at_the_median}."
        ]
        for difference in self.differences[:_KINDS_IN_TEXT]:
            lines.append("  {actions} {kind}: such as {example}".format(**difference))
        unnamed = sum(difference["actions"] for difference in self.differences[_KINDS_IN_TEXT:])
        if unnamed:
            lines.append(f"  {unnamed} of other kinds")
        return "\n".join(lines)


@dataclass(frozen=True)
class ControlArm:
    """Pairs of trials of one run, between which nothing is changed but what is drawn: what chance alone does."""

    trials: PairedTrials
    actions: PairedActions


@dataclass(frozen=True)
class Comparison:
    """A run and an earlier one of the same trials under other settings; the earlier run is the first."""

    against: str
    changed: Mapping[str, tuple[Any, Any]]
    """Settings and versions that differ, by their dotted names: of the earlier run, and of this one."""
    trials: PairedTrials
    actions: PairedActions
    control: ControlArm | None
    """Of the earlier run, see :func:`control_arm`."""

    def __str__(self) -> str:
        return f"Against {self.against}: of {self.trials.words('there', 'here')}\n{self.actions}"


@dataclass(frozen=True)
class RealityGap:
    """The agreement of a simulation, the first, and reality, or of any two runs, on the same trials."""

    changed: Mapping[str, tuple[Any, Any]]
    """Settings and versions that differ, by dotted name, as far as both declare them."""
    trials: PairedTrials
    actions: PairedActions
    control: ControlArm | None
    """Of the simulation, see :func:`control_arm`."""
    by_verb: Mapping[str, Mapping[str, Any]]
    """Of what the rules allow: the shares of the paired actions as predicted in both or in neither (``agreement``), in
    the simulation (``sim``) and in reality (``real``); ``duration_ratio``, reality by simulation: the median over
    actions as predicted in both, with its 95 % interval, which takes actions as independent; and ``duration_p``, of the
    sign test of whether trials take as long for them in both, in which a trial counts once."""
    error_shifts: Mapping[str, Mapping[str, Any]]
    """By the field of an attempt, in thousandths of its unit (millimetres or milliradians): the Distributions ``sim``
    and ``real`` over actions as predicted; ``distance`` and ``p_value`` of the Kolmogorov-Smirnov test,
    which takes them as independent."""
    plans: Sequence[Mapping[str, Any]]
    """Of each ``plan`` or policy in a world: its paired ``runs``, and the shares ``sim`` and ``real`` that reach the
    goal or, without a goal, agree."""
    ranks: RankAgreement | None
    """Rank agreement over these plans; None for fewer than three."""

    @property
    def agrees(self) -> bool:
        """Whether there are pairs, and neither their outcomes nor the durations of an action differ significantly."""
        return self.trials.pairs > 0 and not self.trials.differ and not self.other_durations

    @property
    def other_durations(self) -> list[str]:
        """Actions that take longer or shorter in one of the runs, at 5 % over all actions (Bonferroni)."""
        actions = []
        for verb, shares in self.by_verb.items():
            if shares["duration_p"] * len(self.by_verb) < 1 - CONFIDENCE:
                actions.append(verb)
        return actions


def read_earlier(experiment: Experiment, out: Path | None, options: RunOptions) -> Finished | None:
    """Return the baseline run, if one is given; call this before a run starts in ``out``.

    Raises InputError if the folder holds no run, or none with trials of this experiment.
    """
    folder = options.against
    seed = experiment.seed
    if folder is None:
        return None
    earlier = read_other(folder, out, experiment.command, experiment.form)
    earlier_seed = earlier.manifest.get("seed")
    if earlier_seed != seed:
        raise InputError(
            f"the run in {folder} has the seed {earlier_seed}, not {seed}, so that nothing is paired; "
            f"give --seed {earlier_seed}"
        )
    keys = {item.key for item in experiment.items}
    if not any(record["key"] in keys for record in earlier.records):
        raise InputError(
            f"the run in {folder} has no trial in common with this one, so there are no pairs to compare; "
            "run both with the same contexts, worlds, plans or policies"
        )
    return earlier


def read_other(folder: Path, out: Path | None, command: str, form: Form) -> Finished:
    """Return a finished run. Raises InputError without one, and for the folder of this run."""
    if out is not None and resolved(folder) == resolved(out):
        raise InputError(f"--baseline {folder} is the folder of this run; choose another --out")
    return read_finished(folder, command, form)


def compare_runs(
    earlier: Finished,
    session: Session,
    chosen: Callable[[Iterable[TrialRecord]], Iterable[TrialRecord]] = lambda records: records,
) -> Comparison:
    """Compare the records of a run with those of its baseline; ``chosen`` selects records."""
    first = chosen(earlier.records)
    second = chosen(session.records)
    return Comparison(
        str(earlier.folder),
        changes(earlier.manifest, session.manifest),
        compare_trials(first, second),
        compare_actions(first, second),
        control_arm(earlier.manifest, first),
    )


def control_arm(manifest: Mapping[str, Any], records: Iterable[TrialRecord]) -> ControlArm | None:
    """Return each trial of a run beside the next one of the same plan or policy and world, which costs no trial.

    Both are draws of one distribution. None where there are no such pairs: nothing is drawn at random, or outcomes
    ended the run (``--certify``, an audit that stops), so that its last trials fail more often than others.
    """
    config = manifest.get("config") or {}
    if config.get("stop") or config.get("certify") is not None:
        return None
    records = distinct(records)
    trials = _trials(records)
    attempts = _attempts(records)
    places = trials.context.astype(str) + "/" + trials.group.astype(str)
    numbers = places.groupby(places).cumcount()
    pairs = (places + "/" + (numbers // 2).astype(str)).to_numpy()
    pair_by_key = dict(zip(trials.key, pairs, strict=True))
    trials_of_halves = []
    attempts_of_halves = []
    for half in range(2):
        half_trials = trials[numbers % 2 == half]
        half_attempts = _of_trials(attempts, set(half_trials.key))
        trials_of_halves.append(half_trials.assign(key=half_trials.key.map(pair_by_key)))
        attempts_of_halves.append(half_attempts.assign(key=half_attempts.key.map(pair_by_key)))
    paired = _paired(*trials_of_halves)
    if not paired.pairs:
        return None
    return ControlArm(paired, _compare_actions(_pairs(*attempts_of_halves)))


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the settings and versions that differ between two manifests, by dotted name."""
    return dict(differences(_conditions(before), _conditions(after)))


def _conditions(manifest: Mapping[str, Any]) -> dict[str, Any]:
    return {"config": manifest.get("config"), "versions": manifest.get("versions")}


def compare_trials(first: Iterable[TrialRecord], second: Iterable[TrialRecord]) -> PairedTrials:
    """Compare two runs of the same trials; trials without attempts are left out."""
    first, second = paired_distinct(first, second)
    return _paired(_trials(first), _trials(second))


def compare_actions(first: Iterable[TrialRecord], second: Iterable[TrialRecord]) -> PairedActions:
    """Compare the actions of two runs of the same trials."""
    first, second = paired_distinct(first, second)
    return _compare_actions(_pairs(_attempts(first), _attempts(second)))


def compare_with_reality(
    sim: Finished, real: Finished, seed: int = 0, *, control: bool = True
) -> RealityGap:
    """Compare two runs on their common trials, paired by key; ``seed`` is that of the bootstrap.

    With ``control`` the simulation has a :func:`control_arm` beside it. Raises InputError for runs without a common
    trial.
    """
    sim_records, real_records = paired_distinct(sim.records, real.records)
    sim_trials = _trials(sim_records)
    real_trials = _trials(real_records)
    shared = set(sim_trials.key) & set(real_trials.key)
    if not shared:
        raise InputError(
            f"{sim.folder} and {real.folder} have no trial in common that both carried out, so that nothing is paired; "
            "both need the same worlds, plans or policies, and trials of the same numbers"
        )
    sim_trials = _of_trials(sim_trials, shared)
    real_trials = _of_trials(real_trials, shared)
    sim_attempts = _of_trials(_attempts(sim_records), shared)
    real_attempts = _of_trials(_attempts(real_records), shared)
    pairs = _pairs(sim_attempts, real_attempts)
    by_verb = pairs[pairs.legal].groupby("verb_a")
    plans = _plans(sim_trials, real_trials)
    arm = None
    if control:
        arm = control_arm(sim.manifest, sim.records)
    return RealityGap(
        changed=changes(sim.manifest, real.manifest),
        trials=_paired(sim_trials, real_trials),
        actions=_compare_actions(pairs),
        control=arm,
        by_verb={str(verb): _agreement(pairs_of_verb) for verb, pairs_of_verb in by_verb},
        error_shifts=_shifts(
            errors(sim_attempts[sim_attempts.legal]), errors(real_attempts[real_attempts.legal])
        ),
        plans=plans,
        ranks=agreement_of([plan["sim"] for plan in plans], [plan["real"] for plan in plans], seed),
    )


def _of_trials(frame: DataFrame, keys: Set[str]) -> DataFrame:
    """Return the rows of these trials."""
    return frame[frame.key.isin(keys)]


def paired_distinct(
    first: Iterable[TrialRecord], second: Iterable[TrialRecord]
) -> tuple[Iterable[TrialRecord], Iterable[TrialRecord]]:
    """Return the records of two runs whose pairs are distinct.

    A trial that was run once for several identical ones stands beside each of the other run's. Pairs that repeat
    another one in both runs are left out.
    """
    all_first = _standing_in(first, second)
    all_second = _standing_in(second, first)
    keys = repeated(all_first) & repeated(all_second)
    return without_keys(all_first, keys), without_keys(all_second, keys)


def _standing_in(
    run: Iterable[TrialRecord], other_run: Iterable[TrialRecord]
) -> Iterable[TrialRecord]:
    """Return a run's records, those for several identical trials once for each that the other run has."""
    present = {record["key"] for record in run}
    missing_keys = dict[tuple[str | None, str], list[str]]()
    for record in run:
        if record["extra"].get("identical", 1) > 1:
            missing_keys[record["context"], record["group"]] = []
    if not missing_keys:
        return run
    for record in other_run:
        keys = missing_keys.get((record["context"], record["group"]))
        if keys is not None and record["key"] not in present:
            keys.append(record["key"])

    def view(records: Iterable[TrialRecord]) -> Iterator[TrialRecord]:
        for record in records:
            yield record
            identical = record["extra"].get("identical", 1)
            if identical > 1:
                for key in missing_keys[record["context"], record["group"]][: identical - 1]:
                    yield {**record, "key": key}

    return RecordView(run, view)


def _trials(run: Iterable[TrialRecord]) -> DataFrame:
    return trials_frame(run).assign(key=_keys(run))


def _attempts(run: Iterable[TrialRecord]) -> DataFrame:
    frame = attempts_frame(run)
    texts = dict.fromkeys(("action", "verb", "load", "result"), object)
    return frame.assign(key=_keys(run)[frame.trial.to_numpy()]).astype(texts)


def _keys(run: Iterable[TrialRecord]) -> NDArray[np.object_]:
    return np.array([record["key"] for record in carried_out(run)], object)


def _paired(first: DataFrame, second: DataFrame) -> PairedTrials:
    from statsmodels.stats.contingency_tables import mcnemar

    first_agreeing = first[first.attempts > 0].set_index("key").agrees
    second_agreeing = second[second.attempts > 0].set_index("key").agrees
    keys = first_agreeing.index.intersection(second_agreeing.index)
    first_agrees = first_agreeing[keys].to_numpy()
    second_agrees = second_agreeing[keys].to_numpy()
    both = int((first_agrees & second_agrees).sum())
    only_first = int((first_agrees & ~second_agrees).sum())
    only_second = int((~first_agrees & second_agrees).sum())
    neither = int((~first_agrees & ~second_agrees).sum())
    return PairedTrials(
        len(keys),
        len(first_agreeing) + len(second_agreeing) - 2 * len(keys),
        both,
        only_first,
        only_second,
        neither,
        Proportion.of(both + only_first, len(keys)),
        Proportion.of(both + only_second, len(keys)),
        float(mcnemar([[both, only_first], [only_second, neither]], exact=True).pvalue),
    )


def _pairs(first: DataFrame, second: DataFrame) -> DataFrame:
    """Return a row for each paired action, up to the first of its trial that differs in kind: ``key``, the columns of
    both runs with the suffixes ``_a`` and ``_b``, ``good_a`` and ``good_b`` for as predicted, and whether both are
    ``alike``."""
    pairs = second.merge(first, on=["key", "number"], suffixes=("_b", "_a"))
    same = (
        (pairs.tick_a == pairs.tick_b)
        & (pairs.car_a == pairs.car_b)
        & (pairs.action_a == pairs.action_b)
    )
    pairs = pairs[same.groupby(pairs.key).cummin().astype(bool)]
    good_a = pairs.result_a.isin(AGREEING)
    good_b = pairs.result_b.isin(AGREEING)
    legal = pairs.legal_a & pairs.legal_b
    return pairs.assign(good_a=good_a, good_b=good_b, alike=good_a == good_b, legal=legal)


def _compare_actions(pairs: DataFrame) -> PairedActions:
    legal = pairs[pairs.legal]
    good = pairs[pairs.good_a & pairs.good_b]
    differing = pairs[~pairs.alike]
    kinds = [_kind(row) for row in differing.itertuples()]
    differences: list[dict[str, Any]] = []
    for kind, keys in differing.key.groupby(kinds):
        differences.append({"kind": str(kind), "actions": len(keys), "example": str(keys.iloc[0])})
    differences.sort(key=lambda difference: (-difference["actions"], difference["kind"]))
    return PairedActions(
        actions=len(pairs),
        as_predicted_alike=int(pairs.alike.sum()),
        legal=Proportion.of(int(legal.alike.sum()), len(legal)),
        duration_ratio=_median(_ratios(good, "duration_s")).value,
        error_ratio=_median(_ratios(good, "car_error_m")).value,
        peak_force_ratio=_median(_ratios(good, "peak_force_n")).value,
        differences=differences,
    )


def _kind(row: Any) -> str:
    """Return the kind of a difference between two attempts, as text."""
    load = ""
    if row.load_a != "none":
        load = f" with a {row.load_a}"
    slope = " on a slope" * row.slope_a
    forbidden = ", forbidden" * (not row.legal_a)
    return f"{row.verb_a}{load}{slope}{forbidden}: {row.result_a} there, {row.result_b} here"


def _ratios(pairs: DataFrame, name: str) -> list[float]:
    positive = pairs[(pairs[f"{name}_a"] > 0) & pairs[f"{name}_b"].notna()]
    return (positive[f"{name}_b"] / positive[f"{name}_a"]).tolist()


def _agreement(pairs: DataFrame) -> dict[str, Any]:
    good = pairs[pairs.good_a & pairs.good_b]
    shares = {"agreement": "alike", "sim": "good_a", "real": "good_b"}
    agreement: dict[str, Any] = {
        "duration_ratio": _median(_ratios(good, "duration_s")),
        "duration_p": _sign_test(good),
    }
    for name, column in shares.items():
        agreement[name] = Proportion.of(int(pairs[column].sum()), len(pairs))
    return agreement


def _sign_test(pairs: DataFrame) -> float:
    """Return the p-value of whether trials take as long for their actions in one run as in the other.

    Actions of a trial share its physics, so a trial counts once; one that takes equally long in both says nothing.
    """
    from scipy.stats import binomtest

    by_trial = pairs.groupby("key")[["duration_s_a", "duration_s_b"]].sum()
    longer = int((by_trial.duration_s_b > by_trial.duration_s_a).sum())
    shorter = int((by_trial.duration_s_b < by_trial.duration_s_a).sum())
    if longer + shorter == 0:
        return 1.0
    return float(binomtest(longer, longer + shorter).pvalue)


def _median(values: Sequence[float]) -> Estimate:
    """Return a median with the interval that the sign test gives, whatever the distribution."""
    from scipy.stats import quantile_test

    if not values:
        return Estimate(None, None, None)
    interval = quantile_test(values, p=0.5).confidence_interval(CONFIDENCE)
    return Estimate(float(np.median(values)), _finite(interval.low), _finite(interval.high))


def _finite(bound: float) -> float | None:
    if np.isfinite(bound):
        return float(bound)
    return None


def _shifts(sim: Mapping[str, Any], real: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    from scipy.stats import ks_2samp

    shifts = {}
    for name, values in sim.items():
        sim_errors = Distribution.of(values)
        real_errors = Distribution.of(real[name])
        if sim_errors is not None and real_errors is not None:
            test = ks_2samp(values, real[name])
            shifts[name] = {
                "sim": sim_errors,
                "real": real_errors,
                "distance": float(test.statistic),
                "p_value": float(test.pvalue),
            }
    return shifts


def _plans(sim: DataFrame, real: DataFrame) -> list[dict[str, Any]]:
    real_shares = _success_by_plan(real).mean()
    plans = []
    for name, successes in _success_by_plan(sim):
        share = float(successes.sum()) / len(successes)
        plans.append(
            {
                "plan": str(name),
                "runs": len(successes),
                "sim": share,
                "real": float(real_shares[name]),
            }
        )
    return plans


def _success_by_plan(trials: DataFrame) -> Any:
    """Return whether each trial reaches the goal or, without a goal, agrees, grouped by world and plan or policy."""
    success = trials.physics.fillna(trials.agrees.astype(float))
    return success.groupby(trials.context.astype(str) + ": " + trials.group.astype(str))
