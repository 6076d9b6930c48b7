"""Measure how good plans are: what ``craftsim bench plans`` prints."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from craftsim.commands.bench_cells import Cells, show
from craftsim.designs.drawn import random_start
from craftsim.designs.library import make_design
from craftsim.designs.starts import make_start
from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.discrete.tasks import TASK_NAMES, make_task
from craftsim.planning import NoPlanError, Planned, plan_building

if TYPE_CHECKING:
    from rich.console import Console

_RULES: Final = Rules("physical")
_ROUNDS: Final = 100_000
"""More than there is time for."""
_CARS: Final = 4
_PLATFORM: Final = (4, 4)
"""Columns of the building of 16 blocks that is planned for one car and for four."""


def bench_plans(console: Console, seconds: float, runs: int, seed: int, out: Path | None) -> dict[str, Any]:
    """Print how the planner's plans compare with the shipped ones, and how many designs it plans; return the figures.

    Args:
        console: where to print.
        seconds: for each plan, after which no attempt begins.
        runs: random designs, and half as many starts for one car and for four.
        seed: of the first random design; those that follow have the next ones.
        out: folder for the tables in Markdown, if there are to be some.
    """
    # Whatever is compiled at its first use is no part of the time.
    plan_building(make_task("strip").draw(np.random.default_rng(0)), make_task("strip"), _RULES, rounds=2)
    tasks = {name: _task(name, seconds, seed) for name in TASK_NAMES}
    rows = tuple(
        (name, *(f"{value:.1f}" for value in (row["shipped_s"], row["planned_s"], row["bound_s"])))
        for name, row in tasks.items()
    )
    table = Cells("Makespan of the paper's tasks", ("task", "shipped, s", "planned, s", "bound, s"), rows)
    designs = [_design(seed + i, i % 11 / 10, seconds) for i in range(runs)]
    planned = [design for design in designs if design["makespan_s"] is not None]
    ratios = sorted(_ratio(seed + i, seconds) for i in range(max(1, runs // 2)))
    lines = (
        f"Random designs: {len(planned)} of {runs} planned, the first plan after "
        f"{np.median([design['first_s'] for design in planned] or [np.nan]):.2f} s in the median.",
        f"Platforms of 16 blocks: the makespan with {_CARS} cars is {np.median(ratios):.2f} of that with one, in the "
        f"median of {len(ratios)} starts; {ratios[0]:.2f} to {ratios[-1]:.2f}.",
    )
    show([table], lines, console, None if out is None else out / "plans.md")
    return {"tasks": tasks, "designs": designs, "cars": {"n_cars": _CARS, "ratios": ratios}}


def _plan(grid: Grid, goal: Any, seconds: float, seed: int) -> tuple[Planned, float]:
    """Return a plan, and after how many seconds there was a first one."""
    begun = time.process_time()
    first: list[float] = []

    def report(number: int, best: Planned | None) -> None:
        if best is not None and not first:
            first.append(time.process_time() - begun)

    planned = plan_building(grid, goal, _RULES, rounds=_ROUNDS, time_s=seconds, seed=seed, report=report)
    return planned, first[0] if first else 0.0


def _task(name: str, seconds: float, seed: int) -> dict[str, float]:
    task = make_task(name)
    grid = task.draw(np.random.default_rng(0))
    shipped = make_schedule(grid, read_plan(name, grid.n_cars).ticks, _RULES)
    planned, _ = _plan(grid, task, seconds, seed)
    return {
        "shipped_s": shipped.makespan(),
        "planned_s": planned.makespan_s,
        "bound_s": planned.bound_s,
    }


def _design(seed: int, difficulty: float, seconds: float) -> dict[str, Any]:
    drawn = random_start(np.random.default_rng(seed), difficulty)
    row: dict[str, Any] = {"seed": seed, "difficulty": difficulty, "makespan_s": None, "first_s": None}
    try:
        planned, first_s = _plan(drawn.grid, drawn.design, seconds, seed)
    except NoPlanError as error:
        return row | {"why": str(error)}
    return row | {"makespan_s": planned.makespan_s, "bound_s": planned.bound_s, "first_s": first_s}


def _ratio(seed: int, seconds: float) -> float:
    start = make_start(make_design("platform", _PLATFORM), _CARS, np.random.default_rng(seed))
    alone = start.grid.copy()
    alone.cars = alone.cars[:1].copy()
    alone.derive_marks()
    one, four = (_plan(grid, start.design, seconds, seed)[0].makespan_s for grid in (alone, start.grid))
    return four / one
