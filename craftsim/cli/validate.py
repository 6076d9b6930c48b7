"""``craftsim validate``: do plans, actions and policies do in physics what the rules predict?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import tyro

from craftsim.cli.again import command_again
from craftsim.cli.options import CampaignOptions, Dir, File
from craftsim.cli.terminal import Terminal
from craftsim.cli.text import say
from craftsim.discrete.tasks import TASK_NAMES
from craftsim.storage.folders import owning
from craftsim.storage.limits import BLOCKS, CARS, EPISODE_TICKS, RUNS, TIMEOUT_S

OPTIONS: Final = CampaignOptions()


@owning
def validate(
    worlds: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[WORLD ...]")] = (),
    plan: File = None,
    actions: File = None,
    policy: tuple[str, ...] = (),
    order: Literal["sequential", "ticks", "concurrent"] = "ticks",
    campaign: tyro.conf.OmitArgPrefixes[CampaignOptions] = OPTIONS,
    cars: Annotated[int | None, CARS] = None,
    blocks: Annotated[int | None, BLOCKS] = None,
    max_steps: Annotated[int, EPISODE_TICKS] = 14,
    timeout: Annotated[float, TIMEOUT_S] = 600.0,
    video: Literal["none", "failures", "all"] = "failures",
    record: bool = False,
    shrink: bool = False,
    out: Dir = Path("out/validate"),
) -> int:
    """Run plans, lists of actions or policies in physics, judge each action on poses, and report.

    After each step the prediction goes on from what was read. An action agrees when the grid that was read is the
    predicted one and every error is within its limit. Exit status 0 when everything agrees, 1 when something does not
    or a trial came to no end, 2 for wrong input.

    Args:
        worlds: names of shipped tasks, files, or 'module:factory'; or 'random' for worlds that each trial draws anew;
            all six tasks unless given.
        plan: plan file to carry out, 'tick car ACTION' a line.
        actions: file with one 'car ACTION' a line, tried one after the other.
        policy: 'play' (random play by the rules that prefers the rare), 'random', 'planner' (the shipped plan,
            or where there is none a plan made then, and again where physics disagrees),
            'module:function', or a file that 'craftsim train' wrote; several are compared with each other. The planner
            unless given, in random worlds 'play'.
        order: how plans are carried out: one action after the other; tick after tick, the cars of one at the same
            time; or each action as early as those that it depends on have ended.
        cars: other than a world's number of cars; those that its start does not list are drawn at random. Random
            worlds have 1 to 12.
        blocks: the same for blocks; of a random world's stacks, about.
        max_steps: length of an episode in random worlds, less two ticks.
        timeout: seconds after which a run counts as hanging.
        video: films of the failures, or besides of every run from its start to its end.
        record: write the trajectory of every run, for 'craftsim render', 'plot' and 'view', and its cars' log.
        shrink: find the smallest world in which the first failure of each kind still happens.
        out: folder for report.html, report.json, trials.jsonl, durations.csv, the bundles of the disagreements, and
            of random play the worlds and plans.
    """
    given = locals().copy()
    from craftsim.cli.films import film_runs, record_failures, rendering_works
    from craftsim.cli.notes_text import print_notes
    from craftsim.cli.progress import counting
    from craftsim.cli.smallest_text import print_smallest, shrinking
    from craftsim.cli.validate_text import conclusion, coverage_table, print_disagreements, runs_table
    from craftsim.validation import validation
    from craftsim.validation.html.validate import validate_page
    from craftsim.validation.html.writing import write_html

    RUNS.check(
        "--trials times worlds and policies",
        campaign.trials * len(worlds or TASK_NAMES) * max(1, len(policy)),
    )
    console = Terminal()
    filming = video != "none" and rendering_works(console)
    result = validation.validate(
        worlds or TASK_NAMES,
        plan=plan,
        actions=actions,
        policy=policy,
        rules=campaign.rules,
        randomize=campaign.randomize,
        gains=campaign.gains,
        machines=campaign.parameters,
        noise=campaign.noise,
        assume=campaign.assume,
        drive=campaign.drive,
        skills=campaign.skills,
        order=order,
        trials=campaign.trials,
        seed=campaign.seed,
        workers=campaign.workers,
        engine=campaign.engine,
        timeout_s=timeout,
        out=out,
        resume=campaign.resume,
        against=campaign.against,
        n_cars=cars,
        n_blocks=blocks,
        max_steps=max_steps,
        progress=lambda total: counting(console, "runs", total),
        shrink=shrinking(console) if shrink else None,
        record=record or video == "all",
    )
    if filming or record:
        record_failures(console, out, result.records, campaign.workers, filming)
    if filming and video == "all":
        film_runs(console, out, campaign.workers)
    page = write_html(out, validate_page(result, command_again(validate, given)))
    console.print(runs_table(result.records))
    if result.coverage is not None:
        console.print(coverage_table(result.coverage))
    print_disagreements(out, result.records)
    print_smallest(console, out, result.smallest)
    print_notes(result.figures.capped_steps, result.figures.retried)
    if result.comparison is not None:
        say(result.comparison)
    say(f"Report: {out / 'report.json'}\nPage:   {page}")
    say(conclusion(result))
    return 0 if result.agrees else 1
