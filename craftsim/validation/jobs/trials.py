"""Building the shipped tasks again and again: many cars at once, under noise and physics drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Order, make_schedule
from craftsim.models.noise import EXACT, NOISY
from craftsim.models.sensing import Sensors
from craftsim.models.variation import Spread, Varied
from craftsim.skills.executor import Executor
from craftsim.skills.scheduled_run import run_schedule
from craftsim.validation.jobs.job import read_job


@dataclass(frozen=True)
class JobTrial:
    """One building of a task."""

    task: str
    seed: int
    order: Order
    noise: bool
    """Whether senses and physics are drawn from the seed, or exact and nominal."""


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
    senses, physics = (np.random.default_rng(s) for s in np.random.SeedSequence(trial.seed).spawn(2))
    site = job.site(trial.seed)
    if trial.noise:
        Varied(site).draw(Spread(), physics)
    executor = Executor(site, sensors=Sensors(site, NOISY if trial.noise else EXACT, senses))
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
