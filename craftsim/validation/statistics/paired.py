"""Comparing two settings on the same trials: McNemar's test."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from craftsim.validation.campaign import FinishedCampaign
from craftsim.validation.campaign.store import differences
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


def compare_runs(earlier: FinishedCampaign, now: FinishedCampaign) -> Comparison:
    """Return how a run compares with an earlier one of the same seed."""
    before, after = ({key: run.header.get(key) for key in ("config", "versions")} for run in (earlier, now))
    return Comparison(
        str(earlier.folder), dict(differences(before, after)), compare_paired(earlier.records, now.records)
    )


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
