"""``craftsim episodes``: long random episodes with many cars, to see whether anything drifts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from craftsim.commands.campaigning import CampaignCommand
from craftsim.discrete.errors import InputError
from craftsim.validation.campaign import Engine

if TYPE_CHECKING:
    from craftsim.validation.campaign import TrialRecord


def episodes(
    episodes: int = 10,
    actions: int = 300,
    cars: int = 4,
    seed: int = 0,
    noise: bool = False,
    workers: int = 1,
    engine: Engine = "local",
    resume: bool = False,
    out: Path = Path("out/episodes"),
) -> int:
    """Run long episodes of random legal actions in physics, all cars at work at once.

    Exit status 0 when every action of every episode did what the rules predicted.

    Args:
        episodes: how many.
        actions: of each.
        cars: in each, from 1 to 8.
        seed: the first of that many seeds in a row.
        noise: draw sensors and physics from the seed.
        workers: processes to share the work; results do not depend on it.
        engine: processes of this machine, or an existing Ray cluster to which the output folder is shared.
        resume: go on with what an interrupted run has left in the output folder.
        out: folder for report.json and trials.jsonl.
    """
    if episodes < 1 or actions < 1 or not 1 <= cars <= 8:
        raise InputError("--episodes and --actions must be at least 1, --cars from 1 to 8")
    command = CampaignCommand("episodes", seed, out, workers, engine, resume)
    console = command.console

    from craftsim.skills.gains import load_gains
    from craftsim.validation.jobs.episodes import TIMEOUT_S, do_episode, episode_figures, items_of

    config = {"gains": load_gains(), "noise": noise, "actions": actions, "cars": cars, "episodes": episodes}
    items = items_of(episodes, seed, actions, cars, noise)
    timeout_s = TIMEOUT_S[0] + TIMEOUT_S[1] * actions
    records = command.run("episodes", items, do_episode, config, timeout_s=timeout_s)
    figures = episode_figures(records, actions)
    console.print(_table(records))
    for name, errors in figures["set_down_mm"].items():
        console.print(
            f"Set down in the {name} third: {errors['n']} things, median {errors['p50']:.2f} mm, "
            f"worst {errors['max']:.2f} mm off their cells' centres.",
            soft_wrap=True,
        )
    report = command.report(figures, config)
    console.print(f"Report: {report}", soft_wrap=True)
    console.print(f"{figures['good']} of {episodes} episodes went as predicted to the end.")
    return 0 if figures["good"] == episodes else 1


def _table(records: Sequence[TrialRecord]) -> Table:
    from craftsim.validation.jobs.episodes import EARLY

    table = Table(box=None, pad_edge=False, caption="mm: the furthest that anything was from its place")
    headings = ("seed", "actions", f"mm in the first {EARLY}", "at the end", "ever", "cars", "went wrong")
    for heading in headings:
        table.add_column(heading, justify="right")
    for record in records:
        if record["error"] is not None:
            table.add_row(str(record["episode"]), *["-"] * 5, record["error"])
            continue
        episode = record["extra"]
        table.add_row(
            str(record["episode"]),
            str(episode["n_actions"]),
            *(
                f"{1e3 * episode[name]:.2f}"
                for name in ("early_error_m", "error_m", "worst_error_m", "car_error_m")
            ),
            "; ".join(episode["disagreement"]) or "nothing",
        )
    return table
