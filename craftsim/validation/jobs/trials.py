"""Building the shipped tasks again and again: many cars at once, under noise and physics drawn from a seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from craftsim.checking.scheduled_run import run_schedule
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Order, make_schedule
from craftsim.models.noise import EXACT, NOISY
from craftsim.models.randomization import DomainRandomization, RandomizedSite
from craftsim.models.sensing import Sensors
from craftsim.skills.executor import Executor
from craftsim.validation.campaign import Done, Item
from craftsim.validation.jobs.job import read_job
from craftsim.validation.statistics.records import Record, carried_out, error_counts

TIMEOUT_S: Final = 1800.0
"""After which a building counts as hanging; the longest take about a minute."""
_ORDERS: Final[tuple[Order, ...]] = ("sequential", "concurrent")
"""In which each task is built without noise, to compare how long that takes."""


@dataclass(frozen=True)
class JobTrial:
    """One building of a task."""

    task: str
    seed: int
    order: Order
    noise: bool
    """Whether sensors and physics are drawn from the seed, or exact and nominal."""


@dataclass(frozen=True)
class JobRecord:
    """What came of building a task once; errors in metres and radians."""

    trial: JobTrial
    reached: bool
    """Whether the world that was read at the end reaches the task's goal, with every car as predicted."""
    agrees: bool
    """Whether, besides, every action succeeded and ended in place."""
    makespan_s: float
    car_error_m: float
    heading_error_rad: float
    placed_error_m: float
    """The furthest that anything stands from its cell's centre at the end."""
    failures: tuple[str, ...]
    """What went wrong, step by step."""


def run_job_trial(trial: JobTrial) -> JobRecord:
    """Build a task once in physics and judge the end by poses."""
    job = read_job(trial.task)
    sensors, physics = (np.random.default_rng(s) for s in np.random.SeedSequence(trial.seed).spawn(2))
    site = job.site(trial.seed)
    if trial.noise:
        RandomizedSite(site).draw(DomainRandomization(), physics)
    executor = Executor(site, sensors=Sensors(site, NOISY if trial.noise else EXACT, sensors))
    start = job.drawing.grid(np.random.default_rng(trial.seed))
    schedule = make_schedule(start, job.plan.ticks, Rules("physical"), trial.order)
    run = run_schedule(executor, schedule)
    failures = [*run.verdict.differences]
    for record in run.records:
        if not record.outcome.succeeded or not record.in_place:
            step = schedule.steps[record.index]
            failures.append(
                f"car {step.car} {step.action.name}: {record.outcome} {record.difference}".strip()
            )
    failures += [f"not run: car {schedule.steps[i].car} {schedule.steps[i].action.name}" for i in run.not_run]
    reached = run.verdict.agrees and job.succeeded is not None and job.succeeded(run.final.grid)
    return JobRecord(
        trial=trial,
        reached=reached,
        agrees=reached and run.agrees,
        makespan_s=run.makespan_s,
        car_error_m=max(placed.offset_m for placed in run.final.cars),
        heading_error_rad=max(abs(placed.heading_rad) for placed in run.final.cars),
        placed_error_m=max(placed.offset_m for placed in run.final.objects),
        failures=tuple(failures),
    )


def items_of(tasks: Sequence[str], seeds: int, seed: int, noise: bool) -> list[Item]:
    """Return the buildings of a campaign: each task twice without noise, then each ``seeds`` times."""
    nominal = [
        Item(f"{task}/nominal/{order}", task, seed, JobTrial(task, seed, order, False))
        for task in tasks
        for order in _ORDERS
    ]
    return nominal + [
        Item(
            f"{task}/{seed + i}", task, seed, JobTrial(task, seed + i, "concurrent", noise), episode=seed + i
        )
        for task in tasks
        for i in range(seeds)
    ]


def do_job(trial: JobTrial) -> Done:
    """Do the work of an item; ``extra`` is the :class:`JobRecord`."""
    record = run_job_trial(trial)
    return Done(agrees=record.agrees, extra=asdict(record))


def reached(record: Record) -> bool:
    """Return whether a building came to an end and reached its goal."""
    return record["error"] is None and bool(record["extra"]["reached"])


def job_trial_figures(tasks: Sequence[str], records: Sequence[Record]) -> dict[str, Any]:
    """Return what a report says of the records of the items of :func:`items_of`."""
    nominal, rest = records[: 2 * len(tasks)], records[2 * len(tasks) :]
    return {
        "tasks": {
            task: _task_figures(nominal[2 * i : 2 * i + 2], [r for r in rest if r["group"] == task])
            for i, task in enumerate(tasks)
        },
        "records": [record["extra"] for record in carried_out(rest)],
        "errors": error_counts(records),
    }


def _task_figures(nominal: Sequence[Record], own: Sequence[Record]) -> dict[str, Any]:
    done = [record["extra"] for record in carried_out(own)]
    one_by_one, at_once = (record["extra"].get("makespan_s") for record in nominal)
    return {
        "built": sum(map(reached, own)),
        "without_failure": sum(record["agrees"] for record in own),
        "seeds": len(own),
        "max_car_error_mm": 1e3 * max((r["car_error_m"] for r in done), default=0.0),
        "max_heading_error_mrad": 1e3 * max((r["heading_error_rad"] for r in done), default=0.0),
        "max_placed_error_mm": 1e3 * max((r["placed_error_m"] for r in done), default=0.0),
        "sequential_s": one_by_one,
        "concurrent_s": at_once,
        "makespan_ratio": at_once / one_by_one if at_once and one_by_one else None,
        "nominal_built": all(record["agrees"] for record in nominal),
    }
