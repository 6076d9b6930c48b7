"""Skills of the slope above the car: fold and unfold."""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.models.measuring import CarMeasurement, Floats, Records
from craftsim.skills.health import end
from craftsim.skills.skill import CompiledSkill, SkillSetup
from craftsim.skills.state import HINGE, HINGE_SHORT, SUCCEEDED, UNDOCKED


@compiled
def hinge_law(
    readings: Records, tasks: Records, past: Floats, constants: Records, commands: Records, car: int
) -> None:
    """Command the speed of the hinge of the slope above a car towards its end, or end the task."""
    now, task, known = readings[car], tasks[car], constants[car]
    hinge, gains = task.hinge, known.hinge
    if hinge.slope < 0 and now.slope >= 0:
        # The first slope that a reading shows.
        hinge.slope = now.slope
        travel = abs(hinge.target_rad - now.hinge_rad)
        hinge.deadline_s = task.elapsed_s + travel / known.car.hinge_speed_rad_s + gains.allowance
    if now.slope < 0 or now.slope != hinge.slope:
        # A plug may chatter.
        hinge.undocked_s += known.period_s
        if hinge.undocked_s > gains.undocked:
            end(task, UNDOCKED, 0.0, 0.0)
        return
    hinge.undocked_s = 0.0
    # The angle of some periods ago stands where the one after this will be noted.
    angles = past[car]
    angles[hinge.n_past % len(angles)] = now.hinge_rad
    hinge.n_past += 1
    moved = abs(now.hinge_rad - angles[hinge.n_past % len(angles)])
    still = hinge.n_past >= len(angles) and moved < gains.still * gains.still_time
    remaining = hinge.target_rad - now.hinge_rad
    if abs(remaining) < gains.reached and still:
        end(task, SUCCEEDED, 0.0, 0.0)
    elif task.elapsed_s > hinge.deadline_s:
        end(task, HINGE_SHORT, remaining, 0.0)
    limit = min(known.car.hinge_speed_rad_s, abs(hinge.speed) + gains.acceleration * known.period_s)
    hinge.speed = max(-limit, min(limit, gains.gain * remaining))
    commands[car].hinge = hinge.speed


class TurnHinge(CompiledSkill):
    """Bring the hinge of the docked slope to one end of its range at no more than its motor's speed."""

    def __init__(self, setup: SkillSetup, target_rad: float) -> None:
        """Prepare to turn the hinge to ``target_rad``: 0 unfolds, pi folds."""
        super().__init__(setup, hinge_law, HINGE)
        self.target_rad = target_rad

    def _begin(self, now: CarMeasurement) -> None:
        """Take the slope that the first reading shows which shows one."""
        hinge = self.task[0]["hinge"]
        hinge["target_rad"], hinge["slope"] = self.target_rad, -1


class Fold(TurnHinge):
    """Fold the slope above the car."""

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare to fold."""
        super().__init__(setup, setup.machines.slope.hinge_range_rad)


class Unfold(TurnHinge):
    """Unfold the slope above the car until its flap lies on the floor."""

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare to unfold."""
        super().__init__(setup, 0.0)
