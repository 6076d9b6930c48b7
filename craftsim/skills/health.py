"""What every compiled controller checks: that measurements are plausible, and that the load is there."""

from __future__ import annotations

import math

from craftsim.discrete.kernel.jit import Record, compiled
from craftsim.models.measuring import Records
from craftsim.skills.state import LEANS, NOT_FINITE


@compiled
def end(task: Record, status: int, detail: float, second_detail: float) -> None:
    """End a task with a status and the numbers that its text holds, 0.0 for none; the last word counts."""
    task.status, task.ended_s = status, task.elapsed_s
    task.detail, task.second_detail = detail, second_detail


@compiled
def check_health(readings: Records, tasks: Records, constants: Records, car: int) -> None:
    """End the task of a car whose readings are not finite, or that has tipped; note whether its board feels a load.

    It does when, raised, it feels a good share of the lightest load's weight beyond its own.
    """
    now, limits = readings[car], constants[car].health
    raised = now.board_m > limits.board_raised
    tasks[car].feels_load = raised and now.board_force_n > constants[car].car.felt_load_n
    # A sum is finite only if all its terms are.
    pose = now.x + now.y + now.z + now.heading + now.pitch + now.roll
    wheels = now.wheel_speeds[0] + now.wheel_speeds[1] + now.wheel_speeds[2] + now.wheel_speeds[3]
    if not math.isfinite(pose + now.board_m + now.board_force_n + now.hinge_rad + wheels):
        end(tasks[car], NOT_FINITE, 0.0, 0.0)
    elif max(abs(now.pitch), abs(now.roll)) > limits.tipped:
        end(tasks[car], LEANS, now.pitch, now.roll)
