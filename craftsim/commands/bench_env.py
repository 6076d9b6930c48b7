"""Measure how fast the environments run: what ``craftsim bench env`` prints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rich.console import Console

BAR: Final = 1.15
"""How much longer a step in physics may take than MuJoCo's own steps."""


def bench_env(
    console: Console,
    rate: Callable[[Callable[[], None], float], float],
    reference: dict[str, tuple[float, float]],
    depth: int,
    worlds: int,
    seconds: float,
    episode: int,
    seed: int,
) -> dict[str, Any]:
    """Print the rates of the environments and return them.

    A step on the grid is one tick of one world through PettingZoo or Gymnasium, with the observations and masks of all
    cars, infos, and resets; the reference's figure is that of masks and observations with its action helper.

    Args:
        console: where to print.
        rate: returns calls a second of a function that is called for so many seconds.
        reference: by task CraftEnv's steps a second, without and with its helper.
        depth: search depth of the helper.
        worlds: how many worlds the vector form has.
        seconds: how long each measurement on the grid runs.
        episode: ticks of the episode that is timed in physics, 2 or more.
        seed: seed of starts, actions and orders.
    """
    from rich.table import Table

    from craftsim.discrete.tasks import make_task
    from craftsim.envs import parallel_env
    from craftsim.envs.timing import parallel_step, time_physics, vector_step
    from craftsim.envs.vector import GridVectorEnv

    table = Table("task", "form", "helper", "steps/s", "CraftEnv", "times", title="grid")
    rates: dict[str, dict[str, float]] = {}
    physics = Table("task", "cars", "step ms", "bare ms", "times", title="physics")
    ratios = {}
    for task, (_, with_helper) in reference.items():
        rates[task] = {}
        for helper_depth in (depth, None):
            helper = "no" if helper_depth is None else "yes"
            env = parallel_env(task, "grid", helper_depth=helper_depth)
            envs = GridVectorEnv(task, worlds, helper_depth=helper_depth)
            for form, found in (
                ("PettingZoo", rate(parallel_step(env, seed), seconds)),
                (f"vector, {worlds} worlds", worlds * rate(vector_step(envs, seed), seconds)),
            ):
                rates[task][f"{form}, helper {helper}"] = found
                times = f"{found / with_helper:,.0f}"
                table.add_row(task, form, helper, f"{found:,.0f}", f"{with_helper:,.0f}", times)
        timing = time_physics(make_task(task, max_steps=episode - 2), seed)
        ratios[task] = asdict(timing) | {"ratio": timing.ratio}
        env_ms, bare_ms = (1e3 * total / timing.n_steps for total in (timing.env_s, timing.bare_s))
        numbers = f"{env_ms:.1f}", f"{bare_ms:.1f}", f"{timing.ratio:.2f} (bar {BAR})"
        physics.add_row(task, str(timing.n_cars), *numbers)
    console.print(table)
    console.print(physics)
    return {"steps_a_second": rates, "physics": ratios}
