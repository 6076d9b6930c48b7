"""Execute plans in each order in physics, and compare makespans: of the six tasks, and of random designs.

    python scripts/plan_orders.py                  # the plans of the six tasks
    python scripts/plan_orders.py --designs 100    # and of random designs: hours

Orders are those of ``craftsim validate --order``, from the same start in the same physics (mild
randomization). Each makespan stands beside the predicted one.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
from running import options, publish

from craftsim.checking.attempt import Attempt
from craftsim.checking.judge import Judge
from craftsim.checking.setup import Seed, Setup, set_up, setup_of
from craftsim.designs.drawn import random_start
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Concurrency, make_schedule
from craftsim.errors import InputError
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial
from craftsim.experiments.intervals import Estimate, Proportion, mean_of
from craftsim.experiments.report_parts import measurement_headline
from craftsim.experiments.session import run_experiment
from craftsim.experiments.statistics import carried_out
from craftsim.planning import NoPlanError, plan_building
from craftsim.planning.plan_file import read_plan
from craftsim.reports.json_file import document
from craftsim.reports.report import DataTable, Report, Section, numbers
from craftsim.storage.limits import Range
from craftsim.tasks import TASK_NAMES, make_task
from craftsim.validation.options import PlanOrder

ORDERS: Final[tuple[PlanOrder, ...]] = get_args(PlanOrder)
ROUNDS: Final = 20
TIMEOUT_S: Final = 3600.0
"""After which a world or an episode counts as hanging."""


PlanCase = tuple[str, int | None, int, Setup]
"""The name of a world, the number of its random design, which sets its difficulty (None for a task), seed and setup."""


def _planned(
    name: str, design: int | None, seed: int, setup: Setup
) -> tuple[Grid, Sequence[Sequence[Any]]]:
    """Return the start, and the ticks of the plan that is shipped or made. Raises NoPlanError where none is found."""
    if design is None:
        grid = make_task(name).draw(np.random.default_rng(seed))
        return grid, read_plan(shipped_plan(name), grid.n_cars).ticks
    drawn = random_start(np.random.default_rng([seed, design]), design % 11 / 10)
    rules = Rules(setup.rules)
    plan = plan_building(drawn.grid, drawn.design, rules, rounds=ROUNDS, time_s=math.inf, seed=seed)
    return drawn.grid, plan.ticks


def executed(case: PlanCase) -> Result:
    """Return a world's makespans in physics, by order, each from the same start in the same physics."""
    name, _, seed, setup = case
    try:
        grid, ticks = _planned(*case)
    except NoPlanError as error:
        return Result(agrees=False, extra={"world": name, "no_plan": str(error)})
    plan = make_schedule(grid, ticks, Rules(setup.rules))
    orders = {
        order: _executed(set_up(grid, setup, Seed((seed,))), ticks, order) for order in ORDERS
    }
    world = {"world": name, "cars": grid.n_cars, "actions": len(plan.steps), "orders": orders}
    return Result(agrees=all(makespan["agrees"] for makespan in orders.values()), extra=world)


def _executed(
    judge: Judge, ticks: Sequence[Sequence[Any]], order: PlanOrder
) -> dict[str, float | bool]:
    predicted_s, attempts = 0.0, list[Attempt]()
    parts = [[joint] for joint in ticks if joint] if order == "ticks" else [ticks]
    how: Concurrency = "concurrent" if order == "ticks" else order
    for part in parts:
        predicted_s += make_schedule(judge.grid, part, judge.rules, how).makespan()
        attempts += judge.perform_plan(part, how)
    begun = [attempt for attempt in attempts if attempt.performed]
    end_s = max((attempt.start_s + attempt.duration_s for attempt in begun), default=0.0)
    took_s = end_s - min((attempt.start_s for attempt in begun), default=0.0)
    found: dict[str, float | bool] = {
        "predicted_s": round(predicted_s, 3),
        "executed_s": round(took_s, 3),
    }
    return found | {"agrees": all(attempt.agrees for attempt in attempts)}


def ratio_of(pairs: Iterable[tuple[float, float]]) -> Estimate:
    """Return the geometric mean of first by second, with the t interval of its logarithm."""
    logs = mean_of(np.log([one / other for one, other in pairs]).tolist())
    return Estimate(*(None if log is None else math.exp(log) for log in astuple(logs)))


def plan_figures(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return how many plans go as predicted, by order, and the ratios of makespans over worlds where all do."""
    orders = [record["orders"] for record in records if "orders" in record]
    good = [some for some in orders if all(one["agrees"] for one in some.values())]
    return {
        "as_predicted": {
            order: Proportion.of(sum(one[order]["agrees"] for one in orders), len(orders))
            for order in ORDERS
        },
        "compared": len(good),
        "executed_by_predicted": {
            order: ratio_of((one[order]["executed_s"], one[order]["predicted_s"]) for one in good)
            for order in ORDERS
        },
        "concurrent_by": {
            order: ratio_of(
                (one["concurrent"]["executed_s"], one[order]["executed_s"]) for one in good
            )
            for order in ORDERS[:2]
        },
        "worlds": list(records),
    }


def plans_report(n_designs: int, seed: int, out: Path | None, options: RunOptions) -> Report:
    """Execute the plans of the six tasks and of random designs in each order, and return the report."""
    Range(0, 100_000).check("--designs", n_designs)
    setup = setup_of("mild", drive="wheels")
    cases: list[PlanCase] = [(name, None, seed, setup) for name in TASK_NAMES]
    cases += [(f"design {number}", number, seed, setup) for number in range(n_designs)]
    items = [Trial(case[0], "plans", seed, case) for case in cases]
    config = {"designs": n_designs, "setup": setup}
    experiment = Experiment("plan_orders", seed, config, items, executed, timeout_s=TIMEOUT_S)
    done = run_experiment(experiment, out, options)
    records = [record["extra"] for record in carried_out(done)]
    figures = plan_figures(records)
    if not figures["compared"]:
        raise InputError(
            "no plan went as predicted in all orders, so that there is nothing to compare"
        )
    rows = [
        (
            record["world"],
            record["cars"],
            record["actions"],
            *(_cell(record["orders"][order]) for order in ORDERS),
        )
        for record in records
        if "orders" in record
    ]
    note = "simulated seconds, and how much more than predicted; ! where an action did not do as predicted."
    table = DataTable(numbers("world", "cars", "actions", *ORDERS), rows, "Makespans", note)
    said = [
        f"{_shown(figures['concurrent_by'][order])} times {order}"
        for order in figures["concurrent_by"]
    ]
    return Report(
        "Execution of plans",
        f"{len(rows)} plans in {len(ORDERS)} orders",
        measurement_headline(
            f"As early as dependencies allow a plan takes {', '.join(said)}",
            len(done) - len(records),
        ),
        sections=[
            Section(
                "makespans",
                "Makespans",
                "Paired: same start, same physics.",
                [table],
                terminal=True,
            )
        ],
        document=document(figures, command="plan_orders", seed=seed, config=config),
    )


def _cell(one: Mapping[str, Any]) -> str:
    error = one["executed_s"] / one["predicted_s"] - 1 if one["predicted_s"] else 0.0
    return f"{one['executed_s']:.1f} ({error:+.1%}){'' if one['agrees'] else ' !'}"


def _shown(ratio: Estimate) -> str:
    interval = "" if ratio.low is None else f" ({ratio.low:.3f} to {ratio.high:.3f})"
    return f"{ratio.value:.3f}{interval}"


def main(words: Sequence[str] | None = None) -> int:
    """Execute the plans."""
    parser = options(__doc__, "plan_orders")
    parser.add_argument(
        "--designs", type=int, default=0, metavar="N", help="number of random designs"
    )
    asked = parser.parse_args(words)
    return publish(
        asked, "plans", lambda run: plans_report(asked.designs, asked.seed, asked.out, run)
    )


if __name__ == "__main__":
    sys.exit(main())
