"""What every compiled controller checks: that measurements are plausible, and that the load is there."""

from __future__ import annotations

import math

from craftsim.discrete.kernel.jit import Record, compiled
from craftsim.models.measuring import Records
from craftsim.skills.state import LEANS, LOAD_MISSED, NOT_FINITE


@compiled
def end(task: Record, status: int, detail: float, second_detail: float) -> None:
    """End a task with a status and the numbers that its text holds, 0.0 for none; the last word counts."""
    task.status, task.ended_s = status, task.elapsed_s
    task.detail, task.second_detail = detail, second_detail


@compiled
def check_health(readings: Records, tasks: Records, constants: Records, car: int) -> None:
    """End the task of a car whose readings are not finite, or that has tipped."""
    now, limits = readings[car], constants[car].health
    # A sum is finite only if all its terms are.
    pose = now.x + now.y + now.z + now.heading + now.pitch + now.roll
    wheels = now.wheel_speeds[0] + now.wheel_speeds[1] + now.wheel_speeds[2] + now.wheel_speeds[3]
    if not math.isfinite(pose + now.board_m + now.board_force_n + now.hinge_rad + wheels):
        end(tasks[car], NOT_FINITE, 0.0, 0.0)
    elif max(abs(now.pitch), abs(now.roll)) > limits.tipped:
        end(tasks[car], LEANS, now.pitch, now.roll)


@compiled
def feels_load(readings: Records, constants: Records, car: int) -> bool:
    """Return whether the raised board feels a good share of the lightest load's weight beyond its own."""
    now, known = readings[car], constants[car]
    raised: bool = now.board_m > known.health.board_raised
    return raised and now.board_force_n > known.car.felt_load_n


@compiled
def check_load(readings: Records, tasks: Records, constants: Records, car: int) -> None:
    """End a task when the board has not felt its load for a while: shorter dips come from bumps and acceleration."""
    task, known = tasks[car], constants[car]
    task.unloaded_s = 0.0 if feels_load(readings, constants, car) else task.unloaded_s + known.period_s
    if task.unloaded_s > known.health.load_lost:
        end(task, LOAD_MISSED, readings[car].board_force_n, 0.0)
