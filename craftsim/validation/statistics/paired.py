"""Comparing two settings on the same trials: McNemar's test."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from craftsim.errors import InputError
from craftsim.experiments.experiment import Experiment, RunOptions
from craftsim.experiments.records import Finished, differences, read_finished
from craftsim.experiments.session import Session
from craftsim.storage.paths import resolved
from craftsim.validation.statistics.alike import Alike, alike
from craftsim.validation.statistics.proportions import Proportion
from craftsim.validation.statistics.records import Record, carried_out


@dataclass(frozen=True)
class Paired:
    """Trials that were run under two settings, paired by their keys."""

    pairs: int
    unpaired: int
    """Trials that only one of the runs carried out; they are left out."""
    both: int
    """Trials that agree under both settings."""
    only_first: int
    """Trials that agree under the first setting alone."""
    only_second: int
    """Trials that agree under the second setting alone."""
    neither: int
    first: Proportion
    second: Proportion
    p_value: float
    """Of McNemar's exact test, two-sided: how likely a split of the differing pairs at least as uneven as this one is,
    if the settings do equally well."""


@dataclass(frozen=True)
class Comparison:
    """A run and an earlier one of the same trials under other settings."""

    against: str
    """Folder of the earlier run."""
    changed: Mapping[str, tuple[Any, Any]]
    """Settings and versions that differ, by their dotted names: of the earlier run, and of this one."""
    trials: Paired
    """The earlier run is the first."""
    actions: Alike
    """The earlier run is the first here, too."""

    def __str__(self) -> str:
        trials = self.trials
        return (
            f"Against {self.against}: of {trials.pairs} paired trials {trials.both} agree with the rules in both, "
            f"{trials.only_first} only there, {trials.only_second} only here, {trials.neither} in neither; "
            f"McNemar's exact test: p = {trials.p_value:.3g}.\n{self.actions}"
        )


def read_earlier(experiment: Experiment, out: Path | None, options: RunOptions) -> Finished | None:
    """Return the earlier run to compare with, if one is wanted; call this before the other one begins in ``out``.

    Raises InputError where the folder holds none, or none that has pairs with the trials of the experiment.
    """
    folder, seed = options.against, experiment.seed
    if folder is None:
        return None
    if out is not None and resolved(folder) == resolved(out):
        raise InputError(f"--against {folder} is the folder of this run; choose another --out")
    found = read_finished(folder, experiment.command, experiment.form)
    if (other := found.manifest.get("seed")) != seed:
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


def compare_runs(
    earlier: Finished,
    session: Session,
    chosen: Callable[[Iterable[Record]], Iterable[Record]] = lambda records: records,
) -> Comparison:
    """Return how the records of a run compare with those of an earlier one; ``chosen`` says which count."""
    first, second = chosen(earlier.records), chosen(session.records)
    return Comparison(
        str(earlier.folder),
        changes(earlier.manifest, session.manifest),
        compare_paired(first, second),
        alike(first, second),
    )


def changes(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the settings and versions that differ between two manifests, by their dotted names."""
    old, new = ({key: manifest.get(key) for key in ("config", "versions")} for manifest in (before, after))
    return dict(differences(old, new))


def compare_paired(first: Iterable[Record], second: Iterable[Record]) -> Paired:
    """Return how two runs of the same trials under two settings compare; trials that tried nothing are left out."""
    from statsmodels.stats.contingency_tables import mcnemar

    one, two = ({r["key"]: r["agrees"] for r in carried_out(run) if r["attempts"]} for run in (first, second))
    keys = one.keys() & two.keys()
    table = [[0, 0], [0, 0]]
    for key in keys:
        table[not one[key]][not two[key]] += 1
    (both, only_first), (only_second, neither) = table
    return Paired(
        pairs=len(keys),
        unpaired=len(one.keys() ^ two.keys()),
        both=both,
        only_first=only_first,
        only_second=only_second,
        neither=neither,
        first=Proportion.of(both + only_first, len(keys)),
        second=Proportion.of(both + only_second, len(keys)),
        p_value=float(mcnemar(table, exact=True).pvalue),
    )
