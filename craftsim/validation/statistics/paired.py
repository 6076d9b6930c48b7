"""Comparing two settings on the same trials: McNemar's test."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from craftsim.discrete.errors import InputError
from craftsim.validation.statistics.proportions import Proportion
from craftsim.validation.statistics.records import Record, carried_out


@dataclass(frozen=True)
class Paired:
    """Trials that were run under two settings, paired by their keys."""

    pairs: int
    unpaired: int
    """Trials that only one of the runs carried out; they are left out."""
    both: int
    only_first: int
    """Trials that agree under the first setting alone."""
    only_second: int
    neither: int
    first: Proportion
    second: Proportion
    p_value: float
    """Of McNemar's exact test, two-sided: how likely a split of the differing pairs at least as uneven as this one is,
    if the settings do equally well."""


def compare_paired(first: Iterable[Record], second: Iterable[Record]) -> Paired:
    """Return how two runs of the same trials under two settings compare.

    Raises:
        InputError: the runs have no trial in common.
    """
    from statsmodels.stats.contingency_tables import mcnemar

    one, two = ({str(r["key"]): bool(r["agrees"]) for r in carried_out(run)} for run in (first, second))
    keys = one.keys() & two.keys()
    if not keys:
        raise InputError(
            "the two runs have no trial in common, so there are no pairs to compare; "
            "run both with the same seed and the same contexts or plans"
        )
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
