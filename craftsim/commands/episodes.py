"""``craftsim episodes``: long random episodes with many cars, to see whether anything drifts."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from craftsim.commands.progress import counting
from craftsim.discrete.errors import InputError
from craftsim.report import output_directory, write_report

if TYPE_CHECKING:
    from craftsim.validation.jobs.episodes import EpisodeRecord


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
    from craftsim.validation.jobs.episodes import EARLY, EpisodeTrial, run_episode
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
    thirds = _by_thirds(records, actions)
    for name, errors in thirds.items():
        console.print(
            f"Set down in the {name} third: {len(errors)} things, median {np.median(errors or [0]):.2f} mm, "
            f"worst {max(errors, default=0.0):.2f} mm off their cells' centres.",
            soft_wrap=True,
        )
    good = sum(not record.disagreement for record in records)
    figures = {
        "set_down_mm": {
            name: {"n": len(errors), "p50": np.median(errors or [0]), "max": max(errors, default=0.0)}
            for name, errors in thirds.items()
        },
        "records": records,
        "good": good,
    }
    config = {"gains": load_gains(), "noise": noise, "actions": actions, "cars": cars, "episodes": episodes}
    wall = {"total_s": time.perf_counter() - started, "workers": workers}
    report = write_report(out, figures, command="episodes", seed=seed, config=config, wall=wall)
    console.print(f"Report: {report}", soft_wrap=True)
    console.print(f"{good} of {episodes} episodes went as predicted to the end.")
    return 0 if good == episodes else 1


def _by_thirds(records: Sequence[EpisodeRecord], actions: int) -> dict[str, list[float]]:
    """Return the errors in mm of what was set down in the first, middle and last third of all episodes."""
    thirds: dict[str, list[float]] = {"first": [], "middle": [], "last": []}
    for record in records:
        for n, error in record.set_down:
            thirds[list(thirds)[min(2, 3 * n // (actions + 1))]].append(1e3 * error)
    return thirds
