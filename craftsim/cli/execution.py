"""How long plans take in physics: one action after the other, in ticks, and asynchronously; and as predicted."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, get_args

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.setup import Seed, Setup, set_up
from craftsim.choices import PlanOrder
from craftsim.designs.drawn import random_start
from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Concurrency, make_schedule
from craftsim.discrete.tasks import TASK_NAMES, make_task
from craftsim.errors import InputError
from craftsim.experiments.intervals import CONFIDENCE, Estimate, Proportion
from craftsim.planning import NoPlanError, plan_building
from craftsim.reports.json_file import document
from craftsim.reports.report import Column, DataTable, Headline, Report, Section, Tone
from craftsim.workers.pool import Pool, answered

ORDERS: Final[tuple[PlanOrder, ...]] = get_args(PlanOrder)
ROUNDS: Final = 20
"""Attempts at the plan of a random design, of which the best is taken."""


@dataclass(frozen=True)
class PlanCase:
    """What is built: a task by its shipped plan, or a random design by a plan that is made for it."""

    name: str
    design: int | None
    """Number of the random design, which sets its difficulty; None for a task."""
    seed: int
    setup: Setup

    def planned(self) -> tuple[Grid, Sequence[Sequence[Any]]]:
        """Return the start and the ticks of the plan. Raises NoPlanError where none is found."""
        if self.design is None:
            grid = make_task(self.name).draw(np.random.default_rng(self.seed))
            return grid, read_plan(shipped_plan(self.name), grid.n_cars).ticks
        drawn = random_start(np.random.default_rng([self.seed, self.design]), self.design % 11 / 10)
        rules = Rules(self.setup.rules)
        plan = plan_building(drawn.grid, drawn.design, rules, rounds=ROUNDS, time_s=math.inf, seed=self.seed)
        return drawn.grid, plan.ticks


def executed(building: PlanCase) -> dict[str, Any]:
    """Return a world's makespans in physics, by order, each from the same start in the same physics."""
    try:
        grid, ticks = building.planned()
    except NoPlanError as error:
        return {"world": building.name, "no_plan": str(error)}
    orders = {order: _executed(building, grid, ticks, order) for order in ORDERS}
    return {"world": building.name, "cars": grid.n_cars, "actions": sum(map(len, ticks)), "orders": orders}


def _executed(
    building: PlanCase, grid: Grid, ticks: Sequence[Sequence[Any]], order: PlanOrder
) -> dict[str, float | bool]:
    judge, predicted_s = set_up(grid, building.setup, Seed((building.seed,))), 0.0
    attempts: list[Attempt] = []
    parts = [[joint] for joint in ticks if joint] if order == "ticks" else [ticks]
    how: Concurrency = "sequential" if order == "sequential" else "concurrent"
    for part in parts:
        predicted_s += make_schedule(judge.grid, part, judge.rules, how).makespan()
        attempts += judge.perform_plan(part, how)
    begun = [attempt for attempt in attempts if attempt.performed]
    end_s = max((attempt.start_s + attempt.duration_s for attempt in begun), default=0.0)
    took_s = end_s - min((attempt.start_s for attempt in begun), default=0.0)
    agrees = all(attempt.agrees for attempt in attempts)
    return {"agrees": agrees, "predicted_s": round(predicted_s, 3), "executed_s": round(took_s, 3)}


def ratio_of(pairs: Iterable[tuple[float, float]]) -> Estimate:
    """Return the geometric mean of first by second, with the t interval of its logarithm."""
    from scipy.stats import ttest_1samp

    logs = np.log([one / other for one, other in pairs])
    if len(logs) < 2:
        return Estimate(float(np.exp(logs[0])) if len(logs) else None, None, None)
    low, high = ttest_1samp(logs, 0.0).confidence_interval(CONFIDENCE)
    return Estimate(float(np.exp(logs.mean())), float(np.exp(low)), float(np.exp(high)))


def figures_of(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return how many plans go as predicted, by order, and the ratios of makespans over worlds where all three do."""
    planned = [record for record in records if "orders" in record]
    good = [record["orders"] for record in planned if all(one["agrees"] for one in record["orders"].values())]
    return {
        "as_predicted": {
            order: Proportion.of(sum(r["orders"][order]["agrees"] for r in planned), len(planned))
            for order in ORDERS
        },
        "compared": len(good),
        "executed_by_predicted": {
            order: ratio_of((one[order]["executed_s"], one[order]["predicted_s"]) for one in good)
            for order in ORDERS
        },
        "concurrent_by": {
            order: ratio_of((one["concurrent"]["executed_s"], one[order]["executed_s"]) for one in good)
            for order in ORDERS[:-1]
        },
        "worlds": list(records),
    }


def execution_report(n_designs: int, seed: int, setup: Setup, workers: int, config: dict[str, Any]) -> Report:
    """Execute the plans of the six tasks and of random designs in each order, and return the report."""
    cases = [PlanCase(name, None, seed, setup) for name in TASK_NAMES]
    cases += [PlanCase(f"design {number}", number, seed, setup) for number in range(n_designs)]
    with Pool(workers) as pool:
        found = dict(pool.map_unordered(executed, cases))
    records = [answered(found[one]) for one in cases]
    figures = figures_of(records)
    if not figures["compared"]:
        raise InputError("no plan went as predicted in all orders, so that there is nothing to compare")
    rows = [
        (record["world"], record["cars"], record["actions"], *map(_cell, record["orders"].values()))
        for record in records
        if "orders" in record
    ]
    columns = (
        Column("world"),
        *(Column(name, "number") for name in ("cars", "actions", *ORDERS)),
    )
    note = "simulated seconds, and how much more than predicted; ! where an action did not do as predicted"
    table = DataTable(columns, rows, "Makespans", note)
    said = [f"{_shown(figures['concurrent_by'][order])} times {order}" for order in figures["concurrent_by"]]
    return Report(
        "Execution of plans",
        f"{len(rows)} plans in {len(ORDERS)} orders",
        Headline("Measured", Tone.PLAIN, f"As early as dependencies allow a plan takes {', '.join(said)}."),
        sections=[
            Section("makespans", "Makespans", "Paired: same start, same physics.", [table], terminal=True)
        ],
        document=document(figures, command="bench", seed=seed, config=config),
    )


def _cell(one: Mapping[str, Any]) -> str:
    error = one["executed_s"] / one["predicted_s"] - 1 if one["predicted_s"] else 0.0
    return f"{one['executed_s']:.1f} ({error:+.1%}){'' if one['agrees'] else ' !'}"


def _shown(ratio: Estimate) -> str:
    interval = "" if ratio.low is None else f" ({ratio.low:.3f} to {ratio.high:.3f})"
    return f"{ratio.value:.3f}{interval}"
