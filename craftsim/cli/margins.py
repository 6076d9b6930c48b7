"""``craftsim margins``: by how much may each imperfection grow until an action fails?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import tyro

from craftsim.cli.again import command_again
from craftsim.cli.options import CampaignOptions, Dir
from craftsim.cli.terminal import Terminal
from craftsim.cli.text import say
from craftsim.errors import InputError
from craftsim.storage.folders import owning

OPTIONS: Final = CampaignOptions(randomize="none", trials=59, drive="reduced")
QUICK: Final = ("lippage", "unevenness", "position-bias", "heading-bias", "delay", "motor-lag")
"""The axes of a quick look."""


@owning
def margins(
    axes: tuple[str, ...] = (),
    scenarios: Annotated[str, tyro.conf.arg(metavar="PATTERN")] = "*",
    pair: Annotated[tuple[str, str] | None, tyro.conf.arg(metavar="AXIS AXIS")] = None,
    quick: bool = False,
    campaign: tyro.conf.OmitArgPrefixes[CampaignOptions] = OPTIONS,
    out: Dir = Path("out/margins"),
) -> int:
    """Search by how much each imperfection of the world may grow until an action fails.

    An axis is one figure of --randomize that grows, with all else as in that. A margin is its largest value that every
    one of the trials stands: of 59 trials, so that 95 % of all worlds do with 95 % confidence. Exit status 0 when all
    actions stand --randomize itself and every search came to an end, 1 when not, 2 for wrong input.

    Args:
        axes: only these imperfections, such as lippage, position-bias or delay, or all of them; eighteen unless given.
        scenarios: only those whose name matches, such as 'lift*' or '*between*'.
        pair: draw a map of two imperfections that grow together; unless --axes says more, only these are searched.
        quick: six imperfections in the first scenario of each action, with 20 trials: two minutes on two cores.
        out: folder for report.html, report.json, trials.jsonl and the bundles of what fails first.
    """
    given = locals().copy()
    from craftsim.cli.margins_text import print_margins
    from craftsim.cli.progress import counting
    from craftsim.validation.html.margins import margins_page
    from craftsim.validation.html.writing import write_html
    from craftsim.validation.margins import scenarios as known
    from craftsim.validation.margins.axes import WORTH, axes_of
    from craftsim.validation.margins.margins import run_margins

    console = Terminal()
    over = axes_of(pair or ())
    if pair is not None and len(over) != len(pair):
        raise InputError(f"--pair is {' '.join(pair)}; allowed: two different imperfections")
    chosen = axes_of(axes or pair or (QUICK if quick else WORTH))
    result = run_margins(
        known.scenarios(scenarios, quick),
        chosen,
        campaign.setup(),
        20 if quick else campaign.trials,
        campaign.seed,
        out,
        asked={
            "axes": axes,
            "scenarios": scenarios,
            "pair": pair,
            "quick": quick,
            "randomize": campaign.randomize,
        },
        options=campaign.run(
            lambda total: counting(console, "searches", total, lambda record: record["error"] is None)
        ),
        pair=(over[0], over[1]) if pair else None,
    )
    page = write_html(out, margins_page(result, command_again(margins, given)))
    print_margins(console, out, result)
    say(f"Report: {out / 'report.json'}\nPage:   {page}")
    return 0 if result.stands else 1
