"""Where a car believes it is: wheel odometry, corrected by localisations that are noisy and late.

A scalar Kalman filter for each of x, y and heading. Between two localisations the pose is carried on by the body twist
that the wheel encoders imply, and its variance grows with the way travelled, for wheels slip. A localisation is
compared with where the car believed to be when it was taken, and pulls by the Kalman gain. At rest the variance
shrinks with every localisation, so a parked car knows its place much better than one localisation tells.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from craftsim.models.noise import SensorNoise
from craftsim.models.parameters import SMARTCAR
from craftsim.models.sensing import CarMeasurement
from craftsim.skills.mecanum import body_twist

_SLIP = 0.06
"""Standard deviation of the odometry's error in one period as a fraction of the way; slip is one-sided and adds up, so
it is several times what the rollers lose."""
_DRIFT = np.array([2e-5, 2e-5, 6e-5])
"""Standard deviation of what moves a resting car unseen in one period: m, m, rad."""


class Localiser:
    """The pose estimate of one car; call :meth:`update` once each control period."""

    def __init__(self, noise: SensorNoise, period_s: float) -> None:
        """Prepare for measurements with this noise at this period."""
        self._period_s = period_s
        self._noise_variance = np.array([noise.position_m, noise.position_m, noise.heading_rad]) ** 2
        self._late = 0.5 * (noise.min_delay_s + noise.max_delay_s) / period_s
        self._age_std = (noise.max_delay_s - noise.min_delay_s) / math.sqrt(12)
        self._rate = np.zeros(3)
        self._history: deque[NDArray[np.float64]] = deque(maxlen=math.ceil(self._late) + 1)
        self._pose: NDArray[np.float64] | None = None
        self._variance = np.zeros(3)

    def update(self, now: CarMeasurement) -> CarMeasurement:
        """Return the measurement with the estimated pose in place of the localised one."""
        located = np.array([now.x, now.y, now.heading])
        if self._pose is None:
            self._pose, self._variance = located, self._noise_variance.copy()
        else:
            self._predict(now)
            self._correct(located)
        self._history.append(self._pose.copy())
        x, y, heading = (float(v) for v in self._pose)
        position_std, _, heading_std = (float(v) for v in np.sqrt(self._variance))
        return replace(
            now,
            x=x,
            y=y,
            heading=math.remainder(heading, math.tau),
            position_std_m=position_std,
            heading_std_rad=heading_std,
        )

    def _predict(self, now: CarMeasurement) -> None:
        assert self._pose is not None
        forward, left, turn = (self._period_s * speed for speed in body_twist(now.wheel_speeds))
        forward, left = forward * math.cos(now.pitch), left * math.cos(now.roll)
        middle = self._pose[2] + turn / 2
        c, s = math.cos(middle), math.sin(middle)
        way = np.array([c * forward - s * left, s * forward + c * left, turn])
        self._pose += way
        length = float(np.hypot(way[0], way[1]))
        slipped = _SLIP * np.array([length, length, abs(turn) + length / SMARTCAR.turn_radius_m])
        self._variance += slipped**2 + _DRIFT**2
        self._rate = np.array([length, length, abs(turn)]) / self._period_s

    def _correct(self, located: NDArray[np.float64]) -> None:
        assert self._pose is not None
        innovation = located - self._remembered()
        innovation[2] = math.remainder(innovation[2], math.tau)
        # A localisation of unknown age says little while the car moves.
        unsure = self._noise_variance + (self._age_std * self._rate) ** 2
        gain = self._variance / (self._variance + unsure)
        self._pose += gain * innovation
        self._variance *= 1 - gain
        for past in self._history:
            past += gain * innovation

    def _remembered(self) -> NDArray[np.float64]:
        """Return the pose that was believed when the localisation was taken, between two control periods."""
        assert self._pose is not None
        poses = [*self._history, self._pose]
        back = min(self._late, len(poses) - 1)
        newer, share = math.floor(back), back - math.floor(back)
        older = min(newer + 1, len(poses) - 1)
        return (1 - share) * poses[-1 - newer] + share * poses[-1 - older]
