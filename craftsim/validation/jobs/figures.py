"""The figures of a job for a report."""

from __future__ import annotations

from typing import Any

from craftsim.checking.checked_run import ActionRecord
from craftsim.validation.jobs.job import Job, JobResult


def job_figures(result: JobResult) -> dict[str, Any]:
    """Return what came out of a job: each action, how many agree, whether the goal is reached, the worst errors."""
    records = result.run.records
    return {
        "actions": [action_figures(record) for record in records],
        "agree": result.agree,
        "total": len(records),
        "ticks": len(result.job.plan.ticks),
        "matches_goal": result.reached,
        "simulated_s": result.run.simulated_s,
        "max_car_error_mm": 1e3 * max(r.car_error_m for r in records),
        "max_car_heading_error_mrad": 1e3 * max(abs(r.car_heading_error_rad) for r in records),
        "max_placed_error_mm": 1e3 * max(r.placed_error_m or 0.0 for r in records),
        "max_others_moved_mm": 1e3 * max(r.others_moved_m for r in records),
        "final_cars": result.run.final.cars,
        "final_objects": result.run.final.objects,
    }


def action_figures(record: ActionRecord) -> dict[str, object]:
    """Return what one action was asked to do and did; lengths in mm, angles in mrad."""
    return {
        "tick": record.tick,
        "car": record.car,
        "action": record.action,
        "legal": record.legal,
        "predicted": record.predicted,
        "read": record.read,
        "verdict": record.verdict.finding,
        "differences": record.verdict.differences,
        "outcome": str(record.outcome),
        "duration_s": record.outcome.duration_s,
        "car_error_mm": record.car_error_m * 1e3,
        "car_heading_error_mrad": record.car_heading_error_rad * 1e3,
        "placed_error_mm": None if record.placed_error_m is None else record.placed_error_m * 1e3,
        "others_moved_mm": record.others_moved_m * 1e3,
    }


def job_files(job: Job) -> dict[str, str | None]:
    """Return the task and the names of the files of a job."""
    return {
        "task": job.task,
        "blueprint": job.drawing.path.name,
        "plan": job.plan.path.name,
        "goal": job.design.path.name if job.design else None,
    }
