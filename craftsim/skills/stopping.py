"""The skill that does nothing: come to rest."""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.models.measuring import Floats, Records
from craftsim.models.sensing import CarMeasurement
from craftsim.skills.health import end
from craftsim.skills.skill import CompiledSkill, SkillSetup
from craftsim.skills.state import STOP, SUCCEEDED, WHEELS_TURN


@compiled
def stop_law(
    readings: Records, tasks: Records, past: Floats, constants: Records, commands: Records, car: int
) -> None:
    """End the task of a car whose wheels rest."""
    wheels, task, gains = readings[car].wheel_speeds, tasks[car], constants[car].stop
    fastest = max(abs(wheels[0]), abs(wheels[1]), abs(wheels[2]), abs(wheels[3]))
    if task.elapsed_s > 0 and fastest < gains.wheels_at_rest:
        end(task, SUCCEEDED, 0.0, 0.0)
    elif task.elapsed_s > gains.allowance:
        end(task, WHEELS_TURN, 0.0, 0.0)


class Stop(CompiledSkill):
    """Command all motors to zero until the wheels rest."""

    def __init__(self, setup: SkillSetup) -> None:
        """Prepare for this car, world and tuning."""
        super().__init__(setup, stop_law, STOP)

    def _begin(self, now: CarMeasurement) -> None:
        """Need nothing."""
