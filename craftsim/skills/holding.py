"""Holding a car that is parked on an incline."""

from __future__ import annotations

from craftsim.models.sensing import CarMeasurement, PerWheel
from craftsim.skills.gains import HoldGains


def on_incline(now: CarMeasurement, gains: HoldGains) -> bool:
    """Return whether a parked car needs to be held."""
    return gains.level < max(abs(now.pitch), abs(now.roll)) < gains.tipped


class Hold:
    """Turns the wheels of a parked car back where its weight turns them.

    A wheel's drive at zero speed gives way slowly to a torque above its gear's friction: a loaded car whose gears are
    smooth creeps down a ramp by 0.2 mm/s. The encoders measure that, and the drive is commanded to go back as fast.
    """

    def __init__(self, gains: HoldGains, period_s: float) -> None:
        """Begin with the wheels as they stand, for a control period in seconds."""
        self._gain, self._dead_band = gains.gain, gains.dead_band
        self._period_s = period_s
        self._turned: PerWheel = (0.0, 0.0, 0.0, 0.0)

    def step(self, now: CarMeasurement) -> PerWheel:
        """Return the wheel speeds in rad/s to command for the next control period."""
        fl, fr, rl, rr = (
            angle + speed * self._period_s
            for angle, speed in zip(self._turned, now.wheel_speeds, strict=True)
        )
        self._turned = fl, fr, rl, rr
        gain, dead_band = self._gain, self._dead_band
        fl, fr, rl, rr = (-gain * angle if abs(angle) > dead_band else 0.0 for angle in self._turned)
        return fl, fr, rl, rr
