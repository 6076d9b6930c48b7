"""Smooth motion from rest to rest: a speed that ramps up, cruises and ramps down without a jump in acceleration.

Each ramp follows the cubic smoothstep 3u^2 - 2u^3, whose steepest slope is 3/2 of the mean: a ramp to speed v under the
acceleration limit a lasts 1.5 v / a and covers half of what cruising would.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from craftsim.discrete.kernel.jit import compiled


@dataclass(frozen=True)
class Profile:
    """Distance, speed and acceleration over time, for a travel from rest to rest."""

    cruise_speed: float
    ramp_s: float
    duration_s: float

    @classmethod
    def within(cls, distance: float, max_speed: float, max_acceleration: float) -> Profile:
        """Return the quickest profile over a distance >= 0 that keeps to a speed and an acceleration limit."""
        speed = min(max_speed, math.sqrt(max_acceleration * distance / 1.5))
        if speed <= 0:
            return cls(0.0, 0.0, 0.0)
        ramp = 1.5 * speed / max_acceleration
        return cls(speed, ramp, ramp + distance / speed)

    def distance(self, t: float) -> float:
        """Return the distance covered at time t; it holds the end afterwards."""
        v, ramp_s = self.cruise_speed, self.ramp_s
        if self.duration_s == 0:
            return 0.0
        t = min(max(t, 0.0), self.duration_s)
        cruised = max(0.0, min(t, self.duration_s - ramp_s) - ramp_s)
        # How far up the first ramp it is, and how far the last ramp still is from its end.
        u, w = min(t, ramp_s) / ramp_s, min(self.duration_s - t, ramp_s) / ramp_s
        first, whole = v * ramp_s * (u**3.0 - u**4.0 / 2), v * ramp_s * (1.0 - 1.0 / 2)
        last = v * ramp_s * (w**3.0 - w**4.0 / 2)
        return v * cruised + first + whole - last

    def motion(self, t: float) -> tuple[float, float]:
        """Return the speed and the acceleration at time t."""
        if self.ramp_s == 0:
            return 0.0, 0.0
        # How far the nearer ramp is climbed, 0 at rest and 1 when cruising.
        u = min(max(min(t, self.duration_s - t) / self.ramp_s, 0.0), 1.0)
        speed = self.cruise_speed * u * u * (3 - 2 * u)
        if not 0 < u < 1:
            return speed, 0.0
        rise = 6 * u * (1 - u) * self.cruise_speed / self.ramp_s
        return speed, rise if t < self.duration_s / 2 else -rise


distance_at = compiled(Profile.distance)
"""The same for a record with the fields of a Profile, in compiled code."""
motion_at = compiled(Profile.motion)
