"""How good the planner's plans are: beside the shipped ones, on random designs, and with four cars instead of one."""

import numpy as np
import pytest

from craftsim.designs.drawn import random_start
from craftsim.designs.library import make_design
from craftsim.designs.starts import make_start
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.planning import NoPlanError, plan_building
from craftsim.planning.plan_file import read_plan
from craftsim.tasks import TASK_NAMES, make_task

RULES = Rules("physical")
SECONDS = 10.0


def plan(grid, goal, seed):
    return plan_building(grid, goal, RULES, rounds=100_000, time_s=SECONDS, seed=seed)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", TASK_NAMES)
def test_a_task_of_the_paper(benchmark, name, seed):
    """Makespans in seconds."""
    task = make_task(name)
    grid = task.draw(np.random.default_rng(0))
    planned = benchmark.pedantic(plan, args=(grid, task, seed), rounds=1)
    shipped = make_schedule(grid, read_plan(name, grid.n_cars).ticks, RULES).makespan()
    benchmark.extra_info.update(
        shipped_s=shipped, planned_s=planned.makespan_s, bound_s=planned.bound_s
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_random_design(benchmark, seed):
    """Whether it is planned at all, and its makespan in seconds."""
    drawn = random_start(np.random.default_rng(seed), seed % 11 / 10)
    try:
        planned = benchmark.pedantic(plan, args=(drawn.grid, drawn.design, seed), rounds=1)
    except NoPlanError as error:
        pytest.skip(f"no plan: {error}")
    benchmark.extra_info.update(makespan_s=planned.makespan_s, bound_s=planned.bound_s)


@pytest.mark.parametrize("seed", range(10))
def test_four_cars_beside_one(benchmark, seed):
    """``ratio`` of the makespans of a platform of 16 blocks."""
    start = make_start(make_design("platform", (4, 4)), 4, np.random.default_rng(seed))
    alone = start.grid.copy()
    alone.cars = alone.cars[:1].copy()
    alone.derive_marks()
    four = benchmark.pedantic(plan, args=(start.grid, start.design, seed), rounds=1)
    benchmark.extra_info["ratio"] = four.makespan_s / plan(alone, start.design, seed).makespan_s
