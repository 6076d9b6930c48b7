"""``craftsim episodes``: long random episodes with many cars, to see whether anything drifts."""

from __future__ import annotations

import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from craftsim.commands.progress import counting
from craftsim.discrete.errors import InputError
from craftsim.report import output_directory, write_report


def episodes(
    episodes: int = 10,
    actions: int = 300,
    cars: int = 4,
    seed: int = 0,
    noise: bool = False,
    workers: int = 1,
    out: Path = Path("out/episodes"),
) -> int:
    """Run long episodes of random legal actions in physics, all cars at work at once.

    Exit status 0 when every action of every episode did what the rules predicted.

    Args:
        episodes: how many.
        actions: of each.
        cars: in each, from 1 to 8.
        seed: the first of that many seeds in a row.
        noise: draw senses and physics from the seed.
        workers: processes to share the work; results do not depend on it.
        out: folder for report.json.
    """
    if episodes < 1 or actions < 1 or workers < 1 or not 1 <= cars <= 8:
        raise InputError("--episodes, --actions and --workers must be at least 1, --cars from 1 to 8")
    started = time.perf_counter()
    console = Console()
    output_directory(out)

    from craftsim.skills.gains import load_gains
    from craftsim.validation.episodes import EARLY, EpisodeTrial, run_episode
    from craftsim.validation.workers import in_order

    trials = [EpisodeTrial(seed + i, actions, cars, noise) for i in range(episodes)]
    records = []
    with counting(console, "episodes", episodes) as tell:
        for record in in_order(run_episode, trials, workers):
            records.append(record)
            tell(not record.disagreement)
    table = Table(box=None, pad_edge=False, caption="mm: the furthest that anything was from its place")
    for heading in (
        "seed",
        "actions",
        f"mm in the first {EARLY}",
        "at the end",
        "ever",
        "cars",
        "went wrong",
    ):
        table.add_column(heading, justify="right")
    for record in records:
        table.add_row(
            str(record.trial.seed),
            str(record.n_actions),
            *(f"{1e3 * error:.2f}" for error in (record.early_error_m, record.error_m, record.worst_error_m)),
            f"{1e3 * record.car_error_m:.2f}",
            "; ".join(record.disagreement) or "nothing",
        )
    console.print(table)
    good = sum(not record.disagreement for record in records)
    n_legal, n_unclear = (sum(getattr(r, key) for r in records) for key in ("n_legal", "n_unclear"))
    figures = {"records": records, "good": good, "n_legal": n_legal, "n_unclear": n_unclear}
    config = {"gains": load_gains(), "noise": noise, "actions": actions, "cars": cars, "episodes": episodes}
    wall = {"total_s": time.perf_counter() - started, "workers": workers}
    report = write_report(out, figures, command="episodes", seed=seed, config=config, wall=wall)
    console.print(f"Report: {report}", soft_wrap=True)
    console.print(
        f"{n_unclear} of {n_legal} legal actions would have swung into something and were not drawn.",
        soft_wrap=True,
    )
    console.print(f"{good} of {episodes} episodes went as predicted to the end.")
    return 0 if good == episodes else 1
