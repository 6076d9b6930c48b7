"""Measure how fast the environments run: what ``craftsim bench env`` prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rich.console import Console

    from craftsim.commands.bench_calibration import Rate

BAR: Final = 1.25
"""How much longer a step in physics may take than MuJoCo's own steps."""


def bench_env(
    console: Console,
    tasks: Sequence[str],
    depth: int,
    worlds: int,
    seconds: float,
    episode: int,
    seed: int,
    out: Path | None,
) -> dict[str, Any]:
    """Print the rates of the environments and return them.

    A step on the grid is one tick of one world through PettingZoo or Gymnasium, with the observations and masks of all
    cars, infos, and resets; the reference's figure is that of masks and observations with its action helper.

    Args:
        console: where to print.
        tasks: names of the tasks, those for which CraftEnv's rate is known.
        depth: search depth of the helper.
        worlds: how many worlds the vector form has.
        seconds: how long each measurement on the grid runs.
        episode: ticks of the episode that is timed in physics, 2 or more.
        seed: seed of starts, actions and orders.
        out: folder for the tables in Markdown, if there are to be any.

    Raises:
        InputError: the disk does not take the file.
    """
    from craftsim.commands.bench_calibration import COLUMNS, measure
    from craftsim.commands.bench_cells import Cells, show
    from craftsim.discrete.tasks import make_task
    from craftsim.envs import parallel_env
    from craftsim.envs.timing import parallel_step, time_physics, vector_step
    from craftsim.envs.vector import GridVectorEnv

    rates: dict[str, dict[str, Rate]] = {}
    on_grid: list[tuple[str, ...]] = []
    physics: list[tuple[str, ...]] = []
    ratios = {}
    for task in tasks:
        rates[task] = {}
        for helper_depth in (depth, None):
            helper = "no" if helper_depth is None else "yes"
            env = parallel_env(task, "grid", helper_depth=helper_depth)
            envs = GridVectorEnv(task, worlds, helper_depth=helper_depth)
            for form, n, step in (
                ("PettingZoo", 1, parallel_step(env, seed)),
                (f"vector, {worlds} worlds", worlds, vector_step(envs, seed)),
            ):
                rate = measure(step, n, seconds, task, helper=True)
                rates[task][f"{form}, helper {helper}"] = rate
                on_grid.append((task, form.split(",")[0], helper, *rate.cells()))
        timing = time_physics(make_task(task, max_steps=episode - 2), seed)
        ratios[task] = asdict(timing) | {"ratio": timing.ratio}
        env_ms, bare_ms = (1e3 * total / timing.n_steps for total in (timing.env_s, timing.bare_s))
        numbers = f"{env_ms:.1f}", f"{bare_ms:.1f}", f"{timing.ratio:.2f} (bar {BAR})"
        physics.append((task, str(timing.n_cars), *numbers))
    tables = (
        Cells("Environments on the grid", ("task", "form", "helper", *COLUMNS), tuple(on_grid)),
        Cells("Environments in physics", ("task", "cars", "step ms", "bare ms", "times"), tuple(physics)),
    )
    show(tables, (), console, None if out is None else out / "env.md")
    return {"rates": rates, "physics": ratios}
