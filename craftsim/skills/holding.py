"""Holding a car that is parked on an incline.

A wheel's drive at zero speed gives way slowly to a torque above its gear's friction: a loaded car whose gears are
smooth creeps down a ramp by 0.2 mm/s. The encoders measure that, and the drive is commanded to go back as fast.
"""

from __future__ import annotations

from craftsim.discrete.kernel.jit import compiled
from craftsim.models.measuring import Floats, Records
from craftsim.skills.gains import HoldGains


def on_incline(pitch: float, roll: float, gains: HoldGains) -> bool:
    """Return whether a parked car that leans by so much, in radians, needs to be held."""
    return gains.level < max(abs(pitch), abs(roll)) < gains.tipped


@compiled
def hold_law(
    readings: Records, tasks: Records, past: Floats, constants: Records, commands: Records, car: int
) -> None:
    """Turn the wheels of a parked car back where its weight turns them."""
    now, turned, known = readings[car], tasks[car].turned, constants[car]
    for wheel in range(4):
        turned[wheel] += now.wheel_speeds[wheel] * known.period_s
        off = abs(turned[wheel]) > known.hold.dead_band
        commands[car].wheels[wheel] = -known.hold.gain * turned[wheel] if off else 0.0
