"""Where a car believes it is: wheel odometry, corrected by localisations that are noisy and late.

A scalar Kalman filter for each of x, y and heading. Between two localisations the pose is carried on by the body twist
that the wheel encoders imply, and its variance grows with the way travelled, for wheels slip. A localisation is
compared with where the car believed to be when it was taken, and pulls by the Kalman gain. At rest the variance
shrinks with every localisation, so a parked car knows its place much better than from one localisation.
"""

from __future__ import annotations

import math
from collections import deque

from craftsim.models.noise import SensorNoise
from craftsim.models.sensing import CarMeasurement
from craftsim.skills.gains import LocalisationGains
from craftsim.skills.mecanum import Mecanum


class Localiser:
    """The pose estimate of one car; call :meth:`update` once each control period."""

    def __init__(
        self, assumed: SensorNoise, period_s: float, kinematics: Mecanum, gains: LocalisationGains
    ) -> None:
        """Expect measurements with this noise at this period, of a car with these wheels; they may come otherwise."""
        self._period_s = period_s
        self._kinematics = kinematics
        late = 0.5 * (assumed.min_delay_s + assumed.max_delay_s) / period_s
        age_std = (assumed.max_delay_s - assumed.min_delay_s) / math.sqrt(12) / period_s
        drift, slip = gains.position_drift, gains.slip
        self._x = _Coordinate(assumed.position_m, drift, late, age_std, slip)
        self._y = _Coordinate(assumed.position_m, drift, late, age_std, slip)
        self._heading = _Coordinate(assumed.heading_rad, gains.heading_drift, late, age_std, slip)
        self._started = False

    def update(self, now: CarMeasurement) -> CarMeasurement:
        """Return the measurement with the estimated pose in place of the localised one."""
        x, y, heading = self._x, self._y, self._heading
        if self._started:
            self._predict(now)
            x.correct(now.x - x.remembered())
            y.correct(now.y - y.remembered())
            heading.correct(math.remainder(now.heading - heading.remembered(), math.tau))
        else:
            self._started = True
            x.start(now.x)
            y.start(now.y)
            heading.start(now.heading)
        return now._replace(
            x=x.value,
            y=y.value,
            heading=math.remainder(heading.value, math.tau),
            position_std_m=math.sqrt(x.variance),
            heading_std_rad=math.sqrt(heading.variance),
        )

    def _predict(self, now: CarMeasurement) -> None:
        forward, left, turn = (
            self._period_s * speed for speed in self._kinematics.body_twist(now.wheel_speeds)
        )
        forward, left = forward * math.cos(now.pitch), left * math.cos(now.roll)
        middle = self._heading.value + turn / 2
        c, s = math.cos(middle), math.sin(middle)
        length = math.hypot(forward, left)
        self._x.predict(c * forward - s * left, length, length)
        self._y.predict(s * forward + c * left, length, length)
        self._heading.predict(turn, abs(turn), abs(turn) + length / self._kinematics.lever_m)


class _Coordinate:
    """A scalar Kalman filter of x, y or heading."""

    def __init__(self, noise_std: float, drift_std: float, late: float, age_std: float, slip: float) -> None:
        """Expect localisations that are ``late`` periods old, give or take ``age_std``."""
        self._noise_variance = noise_std**2
        self._drift_variance = drift_std**2
        self._late, self._age_std, self._slip = late, age_std, slip
        self._past: deque[float] = deque(maxlen=math.ceil(late) + 1)
        """What was believed at the end of each period; the newest last."""
        self._moved = 0.0

    def start(self, value: float) -> None:
        """Begin with what is measured."""
        self.value, self.variance = value, self._noise_variance
        self._past.append(value)

    def predict(self, way: float, moved: float, rolled: float) -> None:
        """Go on by ``way``, no further than the car ``moved``; the wheels may slip on all that they ``rolled``."""
        self.value += way
        self.variance += (self._slip * rolled) ** 2 + self._drift_variance
        self._moved = moved

    def correct(self, innovation: float) -> None:
        """Take in by how much a localisation differs from what was believed when it was taken."""
        # A localisation of unknown age says little while the car moves.
        unsure = self._noise_variance + (self._age_std * self._moved) ** 2
        gain = self.variance / (self.variance + unsure)
        self.value += gain * innovation
        self.variance *= 1 - gain
        self._past = deque((past + gain * innovation for past in self._past), self._past.maxlen)
        self._past.append(self.value)

    def remembered(self) -> float:
        """Return what was believed when the localisation was taken, between two control periods."""
        back = min(self._late, len(self._past))
        newer = math.floor(back)
        older = min(newer + 1, len(self._past))
        share = back - newer
        return (1 - share) * self._believed(newer) + share * self._believed(older)

    def _believed(self, periods_ago: int) -> float:
        return self._past[-periods_ago] if periods_ago else self.value
