"""Holding a car that is parked on an incline."""

from __future__ import annotations

from craftsim.models.sensing import CarMeasurement, PerWheel

_LEVEL_RAD = 0.03
"""A car that leans less than this stays where it is by itself."""
_TIPPED_RAD = 0.4
"""A car that leans more than this has other worries: the incline is 0.28."""
_GAIN = 10.0
"""1/s: speed commanded per radian that a wheel has turned."""
_STILL_RAD = 1e-4
"""A wheel that has turned less than this, 5 micrometres of way, is left in peace."""


def on_incline(now: CarMeasurement) -> bool:
    """Return whether a parked car needs to be held."""
    return _LEVEL_RAD < max(abs(now.pitch), abs(now.roll)) < _TIPPED_RAD


class Hold:
    """Turns the wheels of a parked car back where its weight turns them.

    A wheel's drive that is told to stand gives way slowly to a torque above its gear's friction: a loaded car whose
    gears are smooth creeps down a ramp by 0.2 mm/s. The encoders tell, and the drive is told to go back as fast.
    """

    def __init__(self, period_s: float) -> None:
        """Begin with the wheels as they stand, for a control period in seconds."""
        self._period_s = period_s
        self._turned: PerWheel = (0.0, 0.0, 0.0, 0.0)

    def step(self, now: CarMeasurement) -> PerWheel:
        """Return the wheel speeds in rad/s to command for the next control period."""
        fl, fr, rl, rr = (
            angle + speed * self._period_s
            for angle, speed in zip(self._turned, now.wheel_speeds, strict=True)
        )
        self._turned = fl, fr, rl, rr
        fl, fr, rl, rr = (-_GAIN * angle if abs(angle) > _STILL_RAD else 0.0 for angle in self._turned)
        return fl, fr, rl, rr
