"""``craftsim build``: plans, builds in physics, and plans again from what is there where something went wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import tyro

from craftsim.cli.options import CampaignOptions, Dir, File
from craftsim.cli.terminal import Terminal
from craftsim.cli.text import say
from craftsim.storage.folders import owning
from craftsim.storage.limits import PLAN_ROUNDS, REPLANS, TIMEOUT_S

OPTIONS: Final = CampaignOptions(trials=1)


@owning
def build(
    start: Annotated[str, tyro.conf.Positional],
    goal: File = None,
    campaign: tyro.conf.OmitArgPrefixes[CampaignOptions] = OPTIONS,
    replans: Annotated[int, REPLANS] = 10,
    rounds: Annotated[int, PLAN_ROUNDS] = 60,
    disturb: Annotated[
        Literal["shove", "fold", "dead-car"] | None, tyro.conf.arg(help_behavior_hint="")
    ] = None,
    timeout: Annotated[float, TIMEOUT_S] = 600.0,
    video: bool = False,
    out: Dir = Path("out/build"),
) -> int:
    """Plan a building, build it in physics, read the world from poses, and plan again from what is there.

    After an action that did not do what the rules predict, what does not depend on it comes to its end; then follows
    another plan. A car that does not act any more is an obstacle to the others. Exit status 0 when all is built, 1 when
    not, 2 for wrong input or where there is no plan.

    Args:
        start: name of a task, a start file, or 'module:factory'.
        goal: design to build, in place of the task's goal.
        replans: plans after the first one, at most.
        rounds: attempts at each plan, of which the best is taken.
        disturb: what goes wrong on purpose: a block is shoved by one cell, a slope is folded again, or a car gets no
            commands any more.
        timeout: seconds after which a building counts as hanging.
        video: film every building from its start to its end.
        out: folder for report.json, trials.jsonl, durations.csv, the bundles of disagreements, films and trajectories.
    """
    from craftsim.cli.build_text import builds_table, conclusion
    from craftsim.cli.films import film_runs, rendering_works
    from craftsim.cli.notes_text import print_notes
    from craftsim.cli.progress import counting
    from craftsim.cli.validate_text import print_disagreements
    from craftsim.validation.builds import build_all, read_goal
    from craftsim.validation.runs.rebuilding import Rebuilding

    task = read_goal(start, goal)
    setup = campaign.setup()
    console = Terminal()
    filming = video and rendering_works(console)
    result = build_all(
        *(task, setup, Rebuilding(replans, rounds, disturb)),
        trials=campaign.trials,
        seed=campaign.seed,
        out=out,
        options=campaign.run(lambda total: counting(console, "buildings", total, _is_built)),
        timeout_s=timeout,
        record=video,
    )
    if filming:
        film_runs(console, out, campaign.workers)
    console.print(builds_table(result.records))
    print_disagreements(out, result.records)
    print_notes(result.figures.capped_steps, result.figures.retried)
    if result.comparison is not None:
        say(result.comparison)
    say(f"Report: {out / 'report.json'}")
    say(conclusion(result))
    return 0 if result.all_built else 1


def _is_built(record: dict[str, dict[str, str]]) -> bool:
    return record["extra"].get("ended") == "built"
