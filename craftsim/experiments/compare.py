"""Two runs of the same trials, paired by key: outcomes, durations, errors, forces and ranks with intervals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Verdict
from craftsim.errors import InputError
from craftsim.experiments.experiment import Experiment, Form, RunOptions, TrialRecord
from craftsim.experiments.intervals import (
    CONFIDENCE,
    Estimate,
    Proportion,
    RankAgreement,
    agreement_of,
    paired_difference,
)
from craftsim.experiments.records import Finished, RecordView, differences, read_finished
from craftsim.experiments.report_parts import bounds_text, changes_table, difference_text
from craftsim.experiments.session import Session
from craftsim.experiments.statistics import (
    ERRORS,
    Distribution,
    attempts_frame,
    carried_out,
    errors,
    repeated,
    trials_frame,
)
from craftsim.reports.json_file import document
from craftsim.reports.report import (
    Block,
    DataTable,
    Headline,
    KeyFigure,
    Report,
    Section,
    Tone,
    interval,
    numbers,
    percent,
)
from craftsim.storage.paths import resolved

if TYPE_CHECKING:
    from pandas import DataFrame

_SHOWN: Final = 6
_KS_AT_5_PERCENT: Final = 1.358
"""Kolmogorov's constant: times the root of (n + m) / (n m) it is the least distance that the test finds at 5 %."""


@dataclass(frozen=True)
class Paired:
    """Trials that were run under two settings, paired by their keys, and how many agree under which setting."""

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

    def words(self, first: str, second: str) -> str:
        """Return the counts as a sentence after "of"; the arguments name the settings."""
        return (
            f"{self.pairs} paired trials {self.both} agree with the rules in both, {self.only_first} only {first}, "
            f"{self.only_second} only {second}, {self.neither} in neither; McNemar's exact test: "
            f"p = {self.p_value:.3g}."
        )


@dataclass(frozen=True)
class Alike:
    """Paired actions of two runs: those of each trial, in order, up to the first that differs in kind."""

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
        named = ("durations", self.duration_ratio), ("errors", self.error_ratio)
        every = (*named, ("peak forces", self.peak_force_ratio))
        ratios = [f"{name} {ratio:.3f} times theirs" for name, ratio in every if ratio is not None]
        if not self.actions:
            return "No action is in both runs."
        lines = [
            f"Of {self.actions:,} actions {self.share:.2%} went as predicted in both or in neither, and "
            f"{self.legal.successes:,} of the {self.legal.trials:,} that the rules allow"
            + (f"; at the median {', '.join(ratios)}." if ratios else ".")
        ]
        lines += ["  {actions} {kind}: such as {example}".format(**one) for one in self.differences[:_SHOWN]]
        left = sum(one["actions"] for one in self.differences[_SHOWN:])
        if left:
            lines.append(f"  {left} of other kinds")
        return "\n".join(lines)


@dataclass(frozen=True)
class Comparison:
    """A run and an earlier one of the same trials under other settings; the earlier run is the first."""

    against: str
    changed: Mapping[str, tuple[Any, Any]]
    """Settings and versions that differ, by their dotted names: of the earlier run, and of this one."""
    trials: Paired
    actions: Alike

    def __str__(self) -> str:
        return f"Against {self.against}: of {self.trials.words('there', 'here')}\n{self.actions}"


@dataclass(frozen=True)
class RealityGap:
    """The agreement of a simulation, the first, and reality, or of any two runs, on the same trials."""

    changed: Mapping[str, tuple[Any, Any]]
    """Settings and versions that differ, by dotted name, as far as both declare them."""
    trials: Paired
    actions: Alike
    by_verb: Mapping[str, Mapping[str, Any]]
    """Of what the rules allow: the shares of the paired actions as predicted in both or in neither (``agreement``), in
    the simulation (``sim``) and in reality (``real``); and ``duration_ratio``, reality by simulation: the median over
    actions as predicted in both, with its exact 95 % interval."""
    error_shifts: Mapping[str, Mapping[str, Any]]
    """By the field of an attempt, in thousandths of its unit (millimetres or milliradians): the Distributions ``sim``
    and ``real`` over actions as predicted; ``distance`` and ``p_value`` of the Kolmogorov-Smirnov test."""
    plans: Sequence[Mapping[str, Any]]
    """Of each ``plan`` or policy in a world: its paired ``runs``, and the shares ``sim`` and ``real`` that reach the
    goal or, without a goal, agree."""
    ranks: RankAgreement | None
    """Rank agreement over these plans; None for fewer than three."""

    @property
    def agrees(self) -> bool:
        """Whether McNemar's test at 5 % finds no difference between pairs, of which there is one."""
        return self.trials.pairs > 0 and self.trials.p_value >= 1 - CONFIDENCE


def read_earlier(experiment: Experiment, out: Path | None, options: RunOptions) -> Finished | None:
    """Return the baseline run, if one is given; call this before a run starts in ``out``.

    Raises InputError if the folder holds no run, or none with trials of this experiment.
    """
    folder = options.against
    seed = experiment.seed
    if folder is None:
        return None
    found = read_other(folder, out, experiment.command, experiment.form)
    other = found.manifest.get("seed")
    if other != seed:
        raise InputError(
            f"the run in {folder} has the seed {other}, not {seed}, so that nothing is paired; give --seed {other}"
        )
    keys = {item.key for item in experiment.items}
    if not any(record["key"] in keys for record in found.records):
        raise InputError(
            f"the run in {folder} has no trial in common with this one, so there are no pairs to compare; "
            "run both with the same contexts, worlds, plans or policies"
        )
    return found


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
        compare_paired(first, second),
        alike(first, second),
    )


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the settings and versions that differ between two manifests, by dotted name."""
    old, new = ({key: manifest.get(key) for key in ("config", "versions")} for manifest in (before, after))
    return dict(differences(old, new))


def compare_paired(first: Iterable[TrialRecord], second: Iterable[TrialRecord]) -> Paired:
    """Compare two runs of the same trials; trials without attempts are left out."""
    first, second = paired_distinct(first, second)
    return _paired(_trials(first), _trials(second))


def alike(first: Iterable[TrialRecord], second: Iterable[TrialRecord]) -> Alike:
    """Compare the actions of two runs of the same trials."""
    first, second = paired_distinct(first, second)
    return _alike(_pairs(_attempts(first), _attempts(second)))


def compare_with_reality(sim: Finished, real: Finished, seed: int = 0) -> RealityGap:
    """Compare two runs on their common trials, paired by key; ``seed`` is that of the bootstrap.

    Raises InputError for runs without a common trial.
    """
    runs = paired_distinct(sim.records, real.records)
    trials, attempts = ([of(run) for run in runs] for of in (_trials, _attempts))
    shared = set(trials[0].key) & set(trials[1].key)
    if not shared:
        raise InputError(
            f"{sim.folder} and {real.folder} have no trial in common that both carried out, so that nothing is paired; "
            "both need the same worlds, plans or policies, and trials of the same numbers"
        )
    trials, attempts = ([one[one.key.isin(shared)] for one in both] for both in (trials, attempts))
    pairs = _pairs(*attempts)
    plans = _plans(*trials)
    return RealityGap(
        changed=changes(sim.manifest, real.manifest),
        trials=_paired(*trials),
        actions=_alike(pairs),
        by_verb={str(verb): _agreement(some) for verb, some in pairs[pairs.legal].groupby("verb_a")},
        error_shifts=_shifts(*(errors(one[one.legal]) for one in attempts)),
        plans=plans,
        ranks=agreement_of([plan["sim"] for plan in plans], [plan["real"] for plan in plans], seed),
    )


def paired_distinct(
    first: Iterable[TrialRecord], second: Iterable[TrialRecord]
) -> tuple[Iterable[TrialRecord], Iterable[TrialRecord]]:
    """Return the records of two runs whose pairs are distinct.

    A trial that was run once for several identical ones stands beside each of the other run's. Pairs that repeat
    another one in both runs are left out.
    """
    first, second = _standing_in(first, second), _standing_in(second, first)
    keys = repeated(first) & repeated(second)

    def without(records: Iterable[TrialRecord]) -> Iterable[TrialRecord]:
        return RecordView(records, lambda some: (record for record in some if record["key"] not in keys))

    return without(first), without(second)


def _standing_in(run: Iterable[TrialRecord], other: Iterable[TrialRecord]) -> Iterable[TrialRecord]:
    """Return a run's records, those for several identical trials once for each that the other run has."""
    present = {record["key"] for record in run}
    alone = {
        (record["context"], record["group"]): list[str]()
        for record in run
        if record["extra"].get("identical", 1) > 1
    }
    if not alone:
        return run
    for record in other:
        keys = alone.get((record["context"], record["group"]))
        if keys is not None and record["key"] not in present:
            keys.append(record["key"])

    def view(records: Iterable[TrialRecord]) -> Iterator[TrialRecord]:
        for record in records:
            yield record
            identical = record["extra"].get("identical", 1)
            if identical > 1:
                for key in alone[record["context"], record["group"]][: identical - 1]:
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


def _paired(first: DataFrame, second: DataFrame) -> Paired:
    from statsmodels.stats.contingency_tables import mcnemar

    one = first[first.attempts > 0].set_index("key").agrees
    other = second[second.attempts > 0].set_index("key").agrees
    keys = one.index.intersection(other.index)
    agree = one[keys].to_numpy(), other[keys].to_numpy()
    both, only_first, only_second, neither = (
        int((first & second).sum()) for first in (agree[0], ~agree[0]) for second in (agree[1], ~agree[1])
    )
    return Paired(
        len(keys),
        len(one) + len(other) - 2 * len(keys),
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
    same = (pairs.tick_a == pairs.tick_b) & (pairs.car_a == pairs.car_b) & (pairs.action_a == pairs.action_b)
    pairs = pairs[same.groupby(pairs.key).cummin().astype(bool)]
    good = {f"good_{run}": pairs[f"result_{run}"] == Verdict.AS_PREDICTED for run in "ab"}
    return pairs.assign(**good, alike=good["good_a"] == good["good_b"], legal=pairs.legal_a & pairs.legal_b)


def _alike(pairs: DataFrame) -> Alike:
    legal = pairs[pairs.legal]
    both = pairs[pairs.good_a & pairs.good_b]
    apart = pairs[~pairs.alike]
    kinds = apart.key.groupby([_kind(row) for row in apart.itertuples()])
    found = [(-len(keys), str(kind), str(keys.iloc[0])) for kind, keys in kinds]
    names = ("duration_s", "car_error_m", "peak_force_n")
    durations, errors, forces = (_median(_ratios(both, name)).value for name in names)
    return Alike(
        len(pairs),
        int(pairs.alike.sum()),
        Proportion.of(int(legal.alike.sum()), len(legal)),
        durations,
        errors,
        forces,
        [{"kind": kind, "actions": -n, "example": example} for n, kind, example in sorted(found)],
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
    known = pairs[(pairs[f"{name}_a"] > 0) & pairs[f"{name}_b"].notna()]
    return (known[f"{name}_b"] / known[f"{name}_a"]).tolist()


def _agreement(pairs: DataFrame) -> dict[str, Any]:
    ratios = _ratios(pairs[pairs.good_a & pairs.good_b], "duration_s")
    shares = {"agreement": "alike", "sim": "good_a", "real": "good_b"}
    return {
        **{name: Proportion.of(int(pairs[column].sum()), len(pairs)) for name, column in shares.items()},
        "duration_ratio": _median(ratios),
    }


def _median(values: Sequence[float]) -> Estimate:
    """Return a median with the interval that the sign test gives, whatever the distribution."""
    from scipy.stats import quantile_test

    if not values:
        return Estimate(None, None, None)
    interval = quantile_test(values, p=0.5).confidence_interval(CONFIDENCE)
    low, high = (float(bound) if np.isfinite(bound) else None for bound in interval)
    return Estimate(float(np.median(values)), low, high)


def _shifts(sim: Mapping[str, Any], real: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    from scipy.stats import ks_2samp

    found = {}
    for name, values in sim.items():
        one = Distribution.of(values)
        other = Distribution.of(real[name])
        if one is not None and other is not None:
            test = ks_2samp(values, real[name])
            tested = {"distance": float(test.statistic), "p_value": float(test.pvalue)}
            found[name] = {"sim": one, "real": other, **tested}
    return found


def _plans(sim: DataFrame, real: DataFrame) -> list[dict[str, Any]]:
    one = sim.physics.fillna(sim.agrees.astype(float)).groupby(
        sim.context.astype(str) + ": " + sim.group.astype(str)
    )
    other = real.physics.fillna(real.agrees.astype(float)).groupby(
        real.context.astype(str) + ": " + real.group.astype(str)
    )
    shares = other.mean()
    rows = [(str(name), len(x), float(x.sum()) / len(x), float(shares[name])) for name, x in one]
    return [dict(zip(("plan", "runs", "sim", "real"), row, strict=True)) for row in rows]


def gap_report(gap: RealityGap, sim: Path, real: Path, seed: int) -> Report:
    """Return the report of how two runs, such as a simulation and reality, agree; ``seed`` is the bootstrap's."""
    if gap.agrees:
        badge = "No significant difference"
        tone = Tone.CAUTION
    else:
        badge = "Differs"
        tone = Tone.BAD
    if not gap.trials.pairs:
        badge = "Nothing to compare"
        tone = Tone.CAUTION
    return Report(
        "Two runs",
        f"{sim} and {real}",
        Headline(badge, tone, difference_text(gap.trials, "the first run", "the second")),
        [
            KeyFigure(percent(p.rate), f"agree in {where}", interval(p.wilson_low, p.wilson_high))
            for where, p in (("the first run", gap.trials.first), ("the second", gap.trials.second))
        ],
        [_outcomes(gap), _verb_section(gap), _error_section(gap.error_shifts), _plan_section(gap)],
        document=document({"compare": gap}, command="compare", seed=seed, config={"sim": sim, "real": real}),
        exit_code=0 if gap.agrees else 1,
    )


def _outcomes(gap: RealityGap) -> Section:
    text = f"Of {gap.trials.words('in the first run', 'in the second')}"
    table = changes_table(gap.changed, "first", "second")
    lead = "The same trials in both, paired by their names."
    return Section("outcomes", "Outcomes", lead, [text, table], True)


def _verb_section(gap: RealityGap) -> Section:
    table = DataTable(
        numbers("action", "pairs", "alike (95 %)", "good: first", "second", "duration ratio (95 %)"),
        [
            (
                *(verb, one["agreement"].trials, _share_text(one["agreement"])),
                *(f"{p.successes}/{p.trials}" for p in (one["sim"], one["real"])),
                _estimate_text(one["duration_ratio"]),
            )
            for verb, one in gap.by_verb.items()
        ],
        "By action",
        "Alike: as predicted in both or in neither; duration ratio: the second run by the first, median.",
    )
    return Section("verbs", "By action", "Of what the rules allow.", [table], True)


def _error_section(shifts: Mapping[str, Mapping[str, Any]]) -> Section:
    table = DataTable(
        numbers("error", "first median", "95th", "second median", "95th", "KS distance", "detectable", "p"),
        [
            (
                ERRORS[name],
                *(f"{value:.3f}" for d in (one["sim"], one["real"]) for value in (d.median, d.p95)),
                *(f"{one['distance']:.3f}", f"{_least_distance(one['sim'].n, one['real'].n):.3f}"),
                f"{one['p_value']:.2g}",
            )
            for name, one in shifts.items()
        ],
        "Errors",
        "Of actions as predicted. Detectable: the least distance of Kolmogorov and Smirnov that their test finds at 5 "
        "% among so many.",
    )
    return Section("errors", "Errors", "How errors are distributed in both.", [table], True)


def _least_distance(n: int, m: int) -> float:
    return min(1.0, _KS_AT_5_PERCENT * math.sqrt((n + m) / (n * m)))


def _plan_section(gap: RealityGap) -> Section:
    table = DataTable(
        numbers("world: plan or policy", "runs", "success: first", "second"),
        [
            (
                *(one["plan"], runs := one["runs"]),
                *(_share_text(Proportion.of(round(rate * runs), runs)) for rate in (one["sim"], one["real"])),
            )
            for one in gap.plans
        ],
        "Plans and policies",
    )
    ranks = "Ranks: at least three plans are needed."
    if gap.ranks is not None:
        ranks = (
            f"Ranks of {gap.ranks.policies} plans: Pearson {_estimate_text(gap.ranks.pearson)}, Spearman "
            f"{_estimate_text(gap.ranks.spearman)}, mean maximum rank violation {gap.ranks.mmrv:.3f}"
        )
    blocks: list[Block] = [*([table] if gap.plans else []), ranks]
    return Section("plans", "Plans and policies", "Success, and whether both rank alike.", blocks, True)


def _share_text(p: Proportion) -> str:
    if p.rate is None:
        return "-"
    return f"{p.rate:.2f} ({p.wilson_low:.2f} to {p.wilson_high:.2f})"


def _estimate_text(one: Estimate) -> str:
    if one.value is None:
        return "not defined"
    return f"{one.value:.2f} ({bounds_text(one)})"
