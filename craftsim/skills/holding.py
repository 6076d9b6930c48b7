"""Holding a car that is parked on an incline.

A wheel's drive at zero speed gives way slowly to a torque above its gear's friction: a loaded car whose gears are
smooth creeps down a ramp by 0.2 mm/s. The encoders measure that, and :func:`craftsim.skills.control.step_cars` commands
the drive to go back as fast.
"""

from __future__ import annotations

from craftsim.skills.gains import HoldGains


def on_incline(pitch: float, roll: float, gains: HoldGains) -> bool:
    """Return whether a parked car that leans by so much, in radians, needs to be held."""
    return gains.level < max(abs(pitch), abs(roll)) < gains.tipped
