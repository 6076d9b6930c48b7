"""The effect of execution on plans and policies.

Makespans of plans executed sequentially, in ticks, concurrently and re-ordered on the way, beside the predicted ones;
success of policies in synchronous and asynchronous execution, on the grid, in physics, and behind a network.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple, cast, get_args

import numpy as np

from craftsim.checking.attempt import Attempt
from craftsim.checking.judge import Judge
from craftsim.checking.setup import RANDOMIZE, Randomize, Seed, Setup, set_up
from craftsim.choices import Backend, Drive, Execution, PlanOrder
from craftsim.designs.drawn import random_start
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.grid import Grid
from craftsim.discrete.reordering import reordered
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Concurrency, make_schedule
from craftsim.discrete.tasks import TASK_NAMES, as_task, make_task
from craftsim.discrete.tasks.starts import save_starts
from craftsim.envs import parallel_env
from craftsim.errors import InputError
from craftsim.experiments.experiment import Experiment, Result, RunOptions, Trial
from craftsim.experiments.intervals import Estimate, Proportion, mean_of
from craftsim.experiments.sections import measured
from craftsim.experiments.session import run_experiment
from craftsim.experiments.statistics import carried_out
from craftsim.planning import NoPlanError, plan_building
from craftsim.reports.json_file import document
from craftsim.reports.report import DataTable, Report, Section, numbers
from craftsim.robots import need_network
from craftsim.training.policy import load_policy
from craftsim.validation.policies import policy_digest

ORDERS: Final[tuple[PlanOrder, ...]] = get_args(PlanOrder)
ROUNDS: Final = 20
TIMEOUT_S: Final = 3600.0
"""After which a world or an episode counts as hanging."""
SLOW: Final = 0.5
"""Speed of wheels and board of the car that is slower than predicted, as a share of the nominal one."""
REORDERED: Final = ("before", "concurrent"), ("reordered", "before"), ("slow_reordered", "slow_before")
"""What is compared: plans re-ordered before execution by predicted durations, and on the way; and with a slow car."""


PlanCase = tuple[str, int | None, int, Setup]
"""The name of a world, the number of its random design, which sets its difficulty (None for a task), seed and setup."""


def _planned(name: str, design: int | None, seed: int, setup: Setup) -> tuple[Grid, Sequence[Sequence[Any]]]:
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
    rules = Rules(setup.rules)
    plan = make_schedule(grid, ticks, rules)
    best = reordered(grid, plan, {(step.tick, step.car): step.duration_s for step in plan.steps}, rules)
    before = [[(step.car, step.action)] for step in best.steps]

    def makespan(ticks: Sequence[Sequence[Any]], order: PlanOrder, setup: Setup = setup) -> dict[str, Any]:
        return _executed(set_up(grid, setup, Seed((seed,))), ticks, order)

    orders = {order: makespan(ticks, order) for order in ORDERS}
    orders["reordered"]["predicted_s"] = round(best.makespan(), 3)
    slow = with_slow_car(setup, grid.n_cars)
    again = {"before": orders["concurrent"] if best is plan else makespan(before, "concurrent")}
    again["slow_before"] = makespan(before, "concurrent", slow)
    again["slow_reordered"] = makespan(ticks, "reordered", slow)
    found = {"world": name, "cars": grid.n_cars, "actions": len(plan.steps), "orders": orders}
    agrees = all(one["agrees"] for one in (*orders.values(), *again.values()))
    return Result(agrees=agrees, extra=found | {"reordered": again})


def with_slow_car(setup: Setup, n_cars: int) -> Setup:
    """Return a setup with wheels and board of car 0 at :data:`SLOW` times their speeds."""
    machines = setup.machines
    first, *others = map(machines.car, range(n_cars))
    wheels, board = SLOW * first.wheel_speed_rad_s, SLOW * first.board_speed_m_s
    slow = replace(first, wheel_speed_rad_s=wheels, board_speed_m_s=board)
    return replace(setup, machines=replace(machines, cars=(slow, *others)))


def _executed(judge: Judge, ticks: Sequence[Sequence[Any]], order: PlanOrder) -> dict[str, float | bool]:
    predicted_s, attempts = 0.0, list[Attempt]()
    parts = [[joint] for joint in ticks if joint] if order == "ticks" else [ticks]
    how: Concurrency = "concurrent" if order == "ticks" else order
    for part in parts:
        predicted_s += make_schedule(judge.grid, part, judge.rules, how).makespan()
        attempts += judge.perform_plan(part, how)
    begun = [attempt for attempt in attempts if attempt.performed]
    end_s = max((attempt.start_s + attempt.duration_s for attempt in begun), default=0.0)
    took_s = end_s - min((attempt.start_s for attempt in begun), default=0.0)
    found: dict[str, float | bool] = {"predicted_s": round(predicted_s, 3), "executed_s": round(took_s, 3)}
    return found | {"agrees": all(attempt.agrees for attempt in attempts)}


def ratio_of(pairs: Iterable[tuple[float, float]]) -> Estimate:
    """Return the geometric mean of first by second, with the t interval of its logarithm."""
    logs = mean_of(np.log([one / other for one, other in pairs]).tolist())
    return Estimate(*(None if log is None else math.exp(log) for log in astuple(logs)))


def plan_figures(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return how many plans go as predicted, by order, and the ratios of makespans over worlds where all do."""
    orders = [record["orders"] for record in records if "orders" in record]
    good = [some for some in orders if all(one["agrees"] for one in some.values())]
    again = [record["reordered"] | record["orders"] for record in records if "reordered" in record]
    return {
        "as_predicted": {
            order: Proportion.of(sum(one[order]["agrees"] for one in orders), len(orders)) for order in ORDERS
        },
        "compared": len(good),
        "executed_by_predicted": {
            order: ratio_of((one[order]["executed_s"], one[order]["predicted_s"]) for one in good)
            for order in ORDERS
        },
        "concurrent_by": {
            order: ratio_of((one["concurrent"]["executed_s"], one[order]["executed_s"]) for one in good)
            for order in ORDERS[:2]
        },
        "reordered": {
            f"{one}_by_{other}": ratio_of(
                (r[one]["executed_s"], r[other]["executed_s"])
                for r in again
                if r[one]["agrees"] and r[other]["agrees"]
            )
            for one, other in REORDERED
        },
        "worlds": list(records),
    }


def plans_report(n_designs: int, seed: int, setup: Setup, out: Path | None, options: RunOptions) -> Report:
    """Execute the plans of the six tasks and of random designs in each order, and return the report."""
    cases: list[PlanCase] = [(name, None, seed, setup) for name in TASK_NAMES]
    cases += [(f"design {number}", number, seed, setup) for number in range(n_designs)]
    items = [Trial(case[0], "plans", seed, case) for case in cases]
    config = {"what": "execution", "designs": n_designs, "setup": setup}
    found, lost = _run(Experiment("bench", seed, config, items, executed, timeout_s=TIMEOUT_S), out, options)
    figures = plan_figures(records := found["plans"])
    if not figures["compared"]:
        raise InputError("no plan went as predicted in all orders, so that there is nothing to compare")
    rows = [
        (record["world"], record["cars"], record["actions"], *map(_cell, record["orders"].values()))
        for record in records
        if "orders" in record
    ]
    before, on_the_way, slow = map(_shown, figures["reordered"].values())
    note = (
        "simulated seconds, and how much more than predicted; ! where an action did not do as predicted. Re-ordered "
        f"before execution by predicted durations: {before} times concurrent; on the way by actual ones: {on_the_way} "
        f"times that, and with a slow car {slow} times."
    )
    table = DataTable(numbers("world", "cars", "actions", *ORDERS), rows, "Makespans", note)
    said = [f"{_shown(figures['concurrent_by'][order])} times {order}" for order in figures["concurrent_by"]]
    return Report(
        "Execution of plans",
        f"{len(rows)} plans in {len(ORDERS)} orders",
        measured(f"As early as dependencies allow a plan takes {', '.join(said)}", lost),
        sections=[
            Section("makespans", "Makespans", "Paired: same start, same physics.", [table], terminal=True)
        ],
        document=document(figures, command="bench", seed=seed, config=config),
    )


def _run(
    experiment: Experiment, out: Path | None, options: RunOptions
) -> tuple[dict[str, list[dict[str, Any]]], int]:
    """Run an experiment, and return the results by group, in the order of its trials, and how many trials have none."""
    records = run_experiment(experiment, out, options)
    found: dict[str, list[dict[str, Any]]] = {record["group"]: [] for record in records}
    for record in carried_out(records):
        found[record["group"]].append(record["extra"])
    return found, len(records) - sum(map(len, found.values()))


def _cell(one: Mapping[str, Any]) -> str:
    error = one["executed_s"] / one["predicted_s"] - 1 if one["predicted_s"] else 0.0
    return f"{one['executed_s']:.1f} ({error:+.1%}){'' if one['agrees'] else ' !'}"


def _shown(ratio: Estimate) -> str:
    interval = "" if ratio.low is None else f" ({ratio.low:.3f} to {ratio.high:.3f})"
    return f"{ratio.value:.3f}{interval}"


class Mode(NamedTuple):
    """How a policy is executed."""

    backend: Backend
    execution: Execution
    randomize: str
    drive: Drive = "reduced"
    network: tuple[float, float, float] | None = None
    """Delay and jitter in seconds, and loss, of the network between the policy with its skills and the robots."""
    most: int = 1_000_000

    def __str__(self) -> str:
        drawn = self.randomize if self.network is None else "network"
        return f"{self.backend} {self.execution}{'' if self.backend == 'grid' else f', {drawn}'}"


MODES: Final = (
    Mode("grid", "synchronous", "none"),
    Mode("grid", "asynchronous", "none"),
    Mode("physics", "synchronous", "mild"),
    Mode("physics", "asynchronous", "mild"),
    # The reduced drive does not reach its targets on this floor.
    Mode("physics", "asynchronous", "workshop_floor", "rollers", (0.03, 0.01, 0.02), 10),
)
REACHED: Final = MODES[3]
"""The mode whose worlds are saved as starts for training."""


PolicyCase = tuple[str, Mode, int]
"""A shipped policy or its path, how it is executed, and the seed of the start, which is the same in all modes."""


def episode(case: PolicyCase) -> Result:
    """Play an episode and return its success, simulated seconds, decisions, and what went wrong.

    ``blocked`` counts decisions that a claim stood against, ``failed`` actions whose skill did not succeed; ``reached``
    is the confirmed world at a time that is drawn, in the mode :data:`REACHED`.
    """
    name, mode, seed = case
    policy, env = load_policy(name, seed), _env(name, mode)
    observations, _ = env.reset(seed=seed)
    found: dict[str, Any] = {"success": False, "seconds": 0.0, "decisions": 0, "blocked": 0, "failed": 0}
    reached, begun_s = [(0.0, env.grid)], time.process_time()
    while env.agents:
        acting = list(getattr(env, "agents_to_act", env.agents))
        actions = policy(observations)
        observations, _, _, _, infos = env.step(actions)
        info = next(iter(infos.values()))
        found["success"] = bool(info["success"])
        found["seconds"] += info["duration_s"]
        found["decisions"] += len(acting)
        found["blocked"] += sum(bool(infos[agent].get("blocked")) for agent in acting)
        found["failed"] += sum(one.get("outcome") not in (None, "succeeded") for one in infos.values())
        if mode == REACHED and env.agents:
            reached.append((found["seconds"], env.core.episodes.confirmed[0].copy()))
    found["deadlock"] = str(info["deadlock"].words) if info.get("deadlock") else ""
    found["unreadable"] = "; ".join(info["problems"])
    if mode == REACHED:
        at_s = np.random.default_rng([seed, 1]).uniform(0.0, found["seconds"])
        found["reached"] = blueprint_text([grid for time_s, grid in reached if time_s <= at_s][-1])
    found["cpu_s"] = time.process_time() - begun_s
    found["seconds"] = round(found["seconds"], 3)
    return Result(agrees=found["success"], extra=found)


@lru_cache(maxsize=8)
def _env(name: str, mode: Mode) -> Any:
    """Return the environment of a policy in a mode, kept for its next episode."""
    config = load_policy(name).config
    options: dict[str, Any] = {"rule_set": config.rules, "helper_depth": config.helper_depth}
    if mode.backend == "physics":
        options |= {"drive": mode.drive, "randomization": RANDOMIZE[cast(Randomize, mode.randomize)][1]}
    if mode.network is not None:
        from craftsim.robots.server import Network
        from craftsim.robots.simulated import simulated_network

        options["robots"] = simulated_network(Network(*mode.network))
    task = as_task(config.task, config.n_cars, config.n_blocks)
    return parallel_env(task, mode.backend, execution=mode.execution, **options)


def policy_figures(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what the episodes of one policy in one mode come to."""
    won = [one for one in records if one["success"]]
    decisions = sum(one["decisions"] for one in records)
    return {
        "success": Proportion.of(len(won), len(records)),
        "makespan_s": float(np.mean([one["seconds"] for one in won])) if won else None,
        "blocked_share": sum(one["blocked"] for one in records) / max(1, decisions),
        "failed": sum(one["failed"] for one in records),
        "deadlocks": sum(bool(one["deadlock"]) for one in records),
        "unreadable": sum(bool(one["unreadable"]) for one in records),
    }


def policies_report(
    policies: Sequence[str], episodes: int, seed: int, out: Path | None, options: RunOptions
) -> Report:
    """Play so many episodes of each policy in each mode, from the same starts, and return the report.

    ``out`` takes a file a policy of worlds that it reached, each at a time that is drawn, as starts to train from.
    Raises InputError for what is no trained policy.
    """
    need_network()
    policies = [*dict.fromkeys(policies)]
    for name in policies:
        load_policy(name)
    digests = {name: policy_digest(name) for name in policies}
    config = {"what": "execution", "policies": digests, "episodes": episodes, "modes": MODES}
    items = [
        Trial(f"{name}, {mode}, {seed + n}", f"{name}, {mode}", seed + n, (name, mode, seed + n))
        for name in policies
        for mode in MODES
        for n in range(min(episodes, mode.most))
    ]
    found, lost = _run(Experiment("bench", seed, config, items, episode, timeout_s=TIMEOUT_S), out, options)
    figures: dict[str, Any] = {}
    tables = []
    columns = numbers("mode", "success", "makespan, s", "blocked, %", "deadlocks", "failed")
    cpu_s: dict[str, dict[str, float]] = {}
    for policy in policies:
        rows = []
        for mode in MODES:
            some = found[f"{policy}, {mode}"]
            own = figures.setdefault(policy, {})[str(mode)] = policy_figures(some)
            share: Proportion = own["success"]
            shown = f"{share.successes}/{share.trials} ({share.wilson_low:.2f}-{share.wilson_high:.2f})"
            makespan = "" if own["makespan_s"] is None else f"{own['makespan_s']:.1f}"
            blocked = f"{100 * own['blocked_share']:.1f}"
            cpu_s.setdefault(policy, {})[str(mode)] = sum(one["cpu_s"] for one in some)
            rows.append((str(mode), shown, makespan, blocked, str(own["deadlocks"]), str(own["failed"])))
            if mode == REACHED and out is not None and some:
                name = re.sub(r"[^\w.-]+", "-", policy)
                grids = [parse_blueprint(one["reached"], name).grid(np.random.default_rng(0)) for one in some]
                save_starts(out / f"starts-{name}.npz", grids)
        spent = f"CPU time: {', '.join(f'{seconds:.0f} s' for seconds in cpu_s[policy].values())}"
        tables.append(DataTable(columns, rows, policy, spent))
    note = (
        "Paired: same starts. Makespan: mean of the episodes that succeed; blocked: decisions that a running action "
        "stood against; failed: actions whose skill did not succeed. Network: as robots on rollers, on a "
        "workshop_floor, behind a network."
    )
    sentence = f"{', '.join(policies)}: {len(MODES)} modes, from the same starts"
    return Report(
        "Execution of policies",
        "synchronous and asynchronous, on the grid and in physics",
        measured(sentence, lost),
        sections=[Section("modes", "Modes", note, tables, terminal=True)],
        document=document(
            {"modes": figures}, command="bench", seed=seed, config=config, wall={"cpu_s": cpu_s}
        ),
    )
