"""The option ``--against``: comparing a campaign with an earlier one of the same trials under other settings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from craftsim.commands.campaigning import CampaignCommand
from craftsim.discrete.errors import InputError
from craftsim.validation.campaign import FinishedCampaign, Item, TrialRecord, read_finished
from craftsim.validation.campaign.store import CAMPAIGN, read_header

if TYPE_CHECKING:
    from craftsim.validation.statistics.paired import Comparison


def read_against(
    command: CampaignCommand, against: Path | None, items: Sequence[Item]
) -> FinishedCampaign | None:
    """Return the earlier run, None where none is asked for; call this before this run begins.

    Raises InputError where the folder holds none, or none that has pairs with the items to be tried.
    """
    if against is None:
        return None
    if against.resolve() == command.out.resolve():
        raise InputError(f"--against {against} is the folder of this run; choose another --out")
    earlier = read_finished(against, command.name)
    if (seed := earlier.header.get("seed")) != command.seed:
        raise InputError(
            f"the campaign in {against} has the seed {seed}, not {command.seed}, so that nothing is paired; "
            f"give --seed {seed}"
        )
    if not {item.key for item in items} & {record["key"] for record in earlier.records}:
        raise InputError(
            f"the campaign in {against} has no trial in common with this one, so there are no pairs to compare; "
            "run both with the same contexts, blueprints, plans or policies"
        )
    return earlier


def compare(
    command: CampaignCommand, earlier: FinishedCampaign | None, records: list[TrialRecord]
) -> Comparison | None:
    """Return how the records of this run, which has ended, compare with those of an earlier one."""
    from craftsim.validation.statistics.paired import compare_runs

    if earlier is None:
        return None
    return compare_runs(earlier, FinishedCampaign(command.out, read_header(command.out / CAMPAIGN), records))


def print_comparison(console: Console, comparison: Comparison | None) -> None:
    """Print how the trials of the two runs compare, if there are two."""
    if comparison is None:
        return
    trials = comparison.trials
    console.print(
        f"Against {comparison.against}: of {trials.pairs} paired trials {trials.both} agree with the rules in both, "
        f"{trials.only_first} only there, {trials.only_second} only here, {trials.neither} in neither; "
        f"McNemar's exact test: p = {trials.p_value:.3g}.",
        soft_wrap=True,
        markup=False,
        highlight=False,
    )
