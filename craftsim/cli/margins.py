"""``craftsim audit margins``: by how much may each imperfection grow until an action fails?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter

from craftsim.choices import Drive
from craftsim.cli.again import command_again
from craftsim.cli.options import Dir
from craftsim.errors import InputError
from craftsim.options import Physics, Randomize, Trials, number
from craftsim.storage.folders import owning
from craftsim.storage.limits import TRIAL_COUNT


@dataclass(frozen=True, kw_only=True)
class MarginPhysics(Physics):
    """Physics from which one imperfection after the other grows."""

    randomize: Annotated[Randomize, Parameter(alias="--level", metavar="LEVEL|NAME|FILE")] = "none"
    drive: Drive | None = "reduced"


@dataclass(frozen=True, kw_only=True)
class MarginTrials(Trials):
    """Trials that must all succeed, so that 95 % of all worlds do with 95 % confidence."""

    trials: Annotated[int, number(TRIAL_COUNT)] = 59


QUICK: Final = ("lippage", "unevenness", "position-bias", "heading-bias", "delay", "motor-lag")
"""The axes of a quick look."""


@owning
def margins(
    imperfections: Annotated[tuple[str, ...], Parameter(metavar="IMPERFECTION")] = (),
    *,
    situations: Annotated[str, Parameter(metavar="PATTERN")] = "*",
    pair: Annotated[tuple[str, str] | None, Parameter(name="--map", metavar="A B")] = None,
    quick: bool = False,
    physics: MarginPhysics = MarginPhysics(),
    campaign: MarginTrials = MarginTrials(),
    out: Dir = Path("out/margins"),
) -> int:
    """Search by how much each imperfection of the world may grow until an action fails.

    An imperfection is one parameter of --randomize that grows, with all else as in that. A margin is its largest value
    that every one of the trials stands: of 59 trials, so that 95 % of all worlds do with 95 % confidence. Exit status
    0 when all actions stand --randomize itself and every search came to an end, 1 when not, 2 for wrong input.

    Args:
        imperfections: only these, such as lippage, position-bias or delay, or all of them; eighteen unless given.
        situations: only those whose name matches, such as 'lift*' or '*between*'.
        pair: draw a map of two imperfections that grow together; unless others are named, only these are searched.
        quick: six imperfections in the first scenario of each action, with 20 trials: two minutes on two cores.
        out: folder for report.html, report.json, trials.jsonl and the bundles of what fails first.
    """
    from craftsim.cli.progress import counting
    from craftsim.reports.terminal import Terminal
    from craftsim.validation.imperfections import WORTH, axes_of
    from craftsim.validation.margins import run_margins, scenarios
    from craftsim.validation.margins_report import margins_report

    console = Terminal()
    over = axes_of(pair or ())
    if pair is not None and len(over) != len(pair):
        raise InputError(f"--map is {' '.join(pair)}; allowed: two different imperfections")
    chosen = axes_of(imperfections or pair or (QUICK if quick else WORTH))
    result = run_margins(
        scenarios(situations, quick),
        chosen,
        physics.setup(),
        20 if quick else campaign.trials,
        physics.seed,
        out,
        asked={
            "axes": imperfections,
            "scenarios": situations,
            "pair": pair,
            "quick": quick,
            "randomize": physics.randomize,
        },
        options=campaign.run(
            lambda total: counting(console, "searches", total, lambda record: record["error"] is None)
        ),
        pair=(over[0], over[1]) if pair else None,
    )
    return margins_report(result, command_again()).publish(out, console)
