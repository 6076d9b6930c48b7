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
        return distance_at(self.cruise_speed, self.ramp_s, self.duration_s, t)

    def speed(self, t: float) -> float:
        """Return the speed at time t."""
        return speed_at(self.cruise_speed, self.ramp_s, self.duration_s, t)

    def acceleration(self, t: float) -> float:
        """Return the acceleration at time t."""
        return acceleration_at(self.cruise_speed, self.ramp_s, self.duration_s, t)


@compiled
def distance_at(cruise_speed: float, ramp_s: float, duration_s: float, t: float) -> float:
    """Return the distance covered at time t by :class:`Profile`."""
    if duration_s == 0:
        return 0.0
    t = min(max(t, 0.0), duration_s)
    cruised = max(0.0, min(t, duration_s - ramp_s) - ramp_s)
    return (
        cruise_speed * cruised
        + _ramp_distance(cruise_speed, ramp_s, min(t, ramp_s))
        + _ramp_distance(cruise_speed, ramp_s, ramp_s)
        - _ramp_distance(cruise_speed, ramp_s, min(duration_s - t, ramp_s))
    )


@compiled
def speed_at(cruise_speed: float, ramp_s: float, duration_s: float, t: float) -> float:
    """Return the speed at time t of :class:`Profile`."""
    u = _phase(ramp_s, duration_s, t)
    return cruise_speed * u * u * (3 - 2 * u)


@compiled
def acceleration_at(cruise_speed: float, ramp_s: float, duration_s: float, t: float) -> float:
    """Return the acceleration at time t of :class:`Profile`."""
    u = _phase(ramp_s, duration_s, t)
    if not 0 < u < 1:
        return 0.0
    rise = 6 * u * (1 - u) * cruise_speed / ramp_s
    return rise if t < duration_s / 2 else -rise


@compiled
def _phase(ramp_s: float, duration_s: float, t: float) -> float:
    """Return how far the nearer ramp is climbed, 0 at rest and 1 when cruising."""
    if ramp_s == 0:
        return 0.0
    return min(max(min(t, duration_s - t) / ramp_s, 0.0), 1.0)


@compiled
def _ramp_distance(cruise_speed: float, ramp_s: float, t: float) -> float:
    u = t / ramp_s
    return cruise_speed * ramp_s * (u**3.0 - u**4.0 / 2)
