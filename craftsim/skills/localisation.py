"""Where cars believe they are: wheel odometry, corrected by localisations that are noisy and late.

A scalar Kalman filter for each of x, y and heading. Between two localisations the pose is carried on by the body twist
that the wheel encoders imply, and its variance grows with the way travelled, for wheels slip. A localisation is
compared with where the car believed to be when it was taken, and pulls by the Kalman gain. At rest the variance
shrinks with every localisation, so a parked car knows its place much better than from one localisation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from craftsim.discrete.compiled import Record, compiled, records
from craftsim.discrete.rotation import wrap
from craftsim.models.measuring import READING, Floats, Records
from craftsim.models.noise import SensorNoise
from craftsim.skills.gains import LocalisationGains
from craftsim.skills.mecanum import Mecanum, body_twist

_COORDINATE: Final = np.dtype(
    [(name, "f8") for name in ("noise_variance", "drift_variance", "value", "variance", "moved")]
)
_ESTIMATE: Final = np.dtype(
    [
        ("x", _COORDINATE),
        ("y", _COORDINATE),
        ("heading", _COORDINATE),
        *((name, "f8") for name in ("period_s", "lever_m", "radius_m", "late", "age_std", "slip")),
        ("n_past", "i8"),
    ],
    align=True,
)


class Localiser:
    """The pose estimates of all cars; call :meth:`update` once each control period."""

    def __init__(
        self,
        assumed: SensorNoise,
        period_s: float,
        kinematics: Sequence[Mecanum],
        gains: LocalisationGains,
    ) -> None:
        """Expect readings with this noise at this period, of cars with these wheels; they may come otherwise."""
        n = len(kinematics)
        self.readings = records(n, READING)
        """(n,) READING: the newest, with the estimated poses in place of the localised ones."""
        late = 0.5 * (assumed.min_delay_s + assumed.max_delay_s) / period_s
        self._estimates = records(n, _ESTIMATE)
        for row, wheels in zip(self._estimates, kinematics, strict=True):
            row["period_s"], row["lever_m"], row["radius_m"] = period_s, wheels.lever_m, wheels.radius_m
            # Localisations are late by so many periods, give or take ``age_std``.
            row["late"], row["slip"] = late, gains.slip
            row["age_std"] = (assumed.max_delay_s - assumed.min_delay_s) / math.sqrt(12) / period_s
            for name in ("x", "y", "heading"):
                std = assumed.heading_rad if name == "heading" else assumed.position_m
                drift = gains.heading_drift if name == "heading" else gains.position_drift
                row[name]["noise_variance"], row[name]["drift_variance"] = std**2, drift**2
        self._past = np.zeros((n, 3, math.ceil(late) + 1))
        """What was believed of x, y and heading at the end of each period; the newest first."""

    def update(self, readings: Records) -> Records:
        """Take in the readings of all cars, shape (n,), and return :attr:`readings`."""
        _update(readings, self._estimates, self._past, self.readings)
        return self.readings


@compiled
def _update(readings: Records, estimates: Records, past: Floats, out: Records) -> None:
    for i in range(len(readings)):
        out[i] = readings[i]
        now, estimate = out[i], estimates[i]
        x, y, heading, n = estimate.x, estimate.y, estimate.heading, estimate.n_past
        if n:
            _predict(now, estimate)
            late = estimate.late
            _correct(x, past[i, 0], n, now.x - _remembered(x, past[i, 0], n, late), estimate.age_std)
            _correct(y, past[i, 1], n, now.y - _remembered(y, past[i, 1], n, late), estimate.age_std)
            turned = wrap(now.heading - _remembered(heading, past[i, 2], n, late))
            _correct(heading, past[i, 2], n, turned, estimate.age_std)
        else:
            _start(x, past[i, 0], now.x)
            _start(y, past[i, 1], now.y)
            _start(heading, past[i, 2], now.heading)
        estimate.n_past = min(n + 1, past.shape[2])
        now.x, now.y, now.heading = x.value, y.value, wrap(heading.value)
        now.position_std_m, now.heading_std_rad = math.sqrt(x.variance), math.sqrt(heading.variance)


@compiled
def _start(coordinate: Record, past: Floats, value: float) -> None:
    """Begin with what is measured."""
    coordinate.value, coordinate.variance = value, coordinate.noise_variance
    past[0] = value


@compiled
def _predict(now: Record, estimate: Record) -> None:
    """Go on as the wheels do, no further than the car moved; they may slip on all that they rolled."""
    wheels, period_s, slip = now.wheel_speeds, estimate.period_s, estimate.slip
    twist = body_twist(estimate.lever_m, estimate.radius_m, wheels[0], wheels[1], wheels[2], wheels[3])
    forward, left, turn = period_s * twist[0], period_s * twist[1], period_s * twist[2]
    forward, left = forward * math.cos(now.pitch), left * math.cos(now.roll)
    middle = estimate.heading.value + turn / 2
    c, s = math.cos(middle), math.sin(middle)
    length = math.hypot(forward, left)
    _go_on(estimate.x, c * forward - s * left, length, slip * length)
    _go_on(estimate.y, s * forward + c * left, length, slip * length)
    _go_on(estimate.heading, turn, abs(turn), slip * (abs(turn) + length / estimate.lever_m))


@compiled
def _go_on(coordinate: Record, way: float, moved: float, unsure: float) -> None:
    coordinate.value += way
    coordinate.variance += unsure**2 + coordinate.drift_variance
    coordinate.moved = moved


@compiled
def _correct(coordinate: Record, past: Floats, n: int, innovation: float, age_std: float) -> None:
    """Take in by how much a localisation differs from what was believed when it was taken."""
    # A localisation of unknown age says little while the car moves.
    unsure = coordinate.noise_variance + (age_std * coordinate.moved) ** 2
    gain = coordinate.variance / (coordinate.variance + unsure)
    coordinate.value += gain * innovation
    coordinate.variance *= 1 - gain
    for k in range(min(n, len(past) - 1), 0, -1):
        past[k] = past[k - 1] + gain * innovation
    past[0] = coordinate.value


@compiled
def _remembered(coordinate: Record, past: Floats, n: int, late: float) -> float:
    """Return what was believed when the localisation was taken, between two control periods."""
    back = min(late, n)
    newer = math.floor(back)
    older = min(newer + 1, n)
    share = back - newer
    recent: float = past[newer - 1] if newer else coordinate.value
    return (1 - share) * recent + share * past[older - 1]
