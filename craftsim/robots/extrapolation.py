"""What robots will measure when the next command begins, from what they measured last and the commands in between.

A measurement is old when it comes, and a command takes time to get there. Which commands act in between is known: they
say when they are to begin. A wheel is taken to follow its velocity servo, less what its gear's friction takes and what
it was seen to be off lately; a servo to approach its command with the lag that explains the measured speeds best; the
board and the hinge to move as commanded; and the body to go where its wheels take it (:mod:`craftsim.skills.mecanum`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.mjcf.machines import Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.measuring import Wheels
from craftsim.models.sensing import CarMeasurement
from craftsim.skills.estimator import assume_delay, likeliest_delay
from craftsim.skills.laws import LAG_STEP_S
from craftsim.skills.mecanum import Mecanum
from craftsim.skills.skill import Command
from craftsim.skills.state import N_LAGS

_SHARE: Final = 0.1
"""By what share the speed by which a wheel is known to be off approaches the one that is seen, in a control period."""
_ASSUMED_LAG: Final = (0.0, 1.0)
"""Prior mean and standard deviation of a servo's lag, in steps between candidates."""
_UNSURE_RAD_S: Final = 0.3
"""Standard deviation of a wheel's speed around its servo's."""
_OUTLIER: Final = 10.0
"""Standard deviations beyond which a wheel lacks torque or grip, which says nothing of the lag."""


class Extrapolation:
    """The motion of one car over a few control periods."""

    def __init__(self, car: SmartcarParameters, machines: Machines, period_s: float) -> None:
        self._car = car
        self._slope = machines.slope
        self._period_s = period_s
        self._kinematics = Mecanum(car)
        self._droop_rad_s = car.gear_friction_nm / car.wheel_gain_nms_rad
        lags_s = LAG_STEP_S * np.arange(1, N_LAGS)
        self._shares = np.array([1.0, *(1 - np.exp(-period_s / lags_s))])
        """(n,): by what share a servo approaches its command in a control period, for each candidate of its lag."""
        self._servos = np.zeros((N_LAGS, 4))
        """Speeds of the servos, for each candidate."""
        self._off = np.zeros((N_LAGS, 4))
        """By how much wheels turn faster than their servos let free ones, for each candidate."""
        self._mismatches = np.zeros(N_LAGS)
        assume_delay(self._mismatches, *_ASSUMED_LAG)
        self._lag, _ = likeliest_delay(self._mismatches)
        """The lag of servos, in steps between candidates."""
        self._seen, self._ahead = np.zeros((2, 4))
        """Sums of the wheels' speeds: over the periods measured since, and over those extrapolated the last time."""
        self._noted = False
        """Whether a measurement has come since."""

    def note(self, measurement: CarMeasurement, acted: Command, periods: int = 1) -> None:
        """Learn how fast the wheels turn under a command that has acted, so many periods after what was noted last."""
        speeds = np.array(measurement.wheel_speeds)
        self._seen += speeds * periods
        self._noted = True
        for _ in range(periods):
            self._servos = self._followed(self._servos, acted.wheels, self._shares[:, None])
        off = speeds - self._free(self._servos) - self._off
        if any(acted.wheels) and (np.abs(off) < _OUTLIER * _UNSURE_RAD_S).all():
            self._mismatches += ((off / _UNSURE_RAD_S) ** 2).sum(axis=1)
            self._lag, _ = likeliest_delay(self._mismatches)
        self._off += _SHARE * off

    def since(self, measurement: CarMeasurement) -> CarMeasurement:
        """Return the newest measurement for one control period: no period is left out, and none counts twice.

        Its wheel speeds are the sum of what was noted since the last call; it is fresh only if something was.
        """
        fl, fr, rl, rr = self._seen.tolist()
        fresh = measurement.fresh and self._noted
        self._seen = np.zeros(4)
        self._noted = False
        return measurement._replace(wheel_speeds=(fl, fr, rl, rr), fresh=fresh)

    def after(self, measurement: CarMeasurement, to_act: Iterable[Command]) -> CarMeasurement:
        """Return the measurement that follows on one of :meth:`since` when commands have acted, each a control period.

        Its wheel speeds are those by which the wheels have gone on since the measurement returned before, so that their
        sum is what was measured, and what is extrapolated now, and no error of an extrapolation stays.
        """
        period_s = self._period_s
        x = measurement.x
        y = measurement.y
        heading = measurement.heading
        board = measurement.board_m
        hinge = measurement.hinge_rad
        turned = np.zeros(4)
        displacement = np.zeros(3)
        share = 1.0
        if self._lag > 0.0:
            share = 1 - math.exp(-period_s / (self._lag * LAG_STEP_S))
        servos = self._interpolated(self._servos)
        off = self._interpolated(self._off)
        for command in to_act:
            servos = self._followed(servos, command.wheels, share)
            wheels = self._free(servos) + off
            turned += wheels
            forward, leftward, turn = self._kinematics.body_twist(wheels.tolist())
            forward = forward * math.cos(measurement.pitch) * period_s
            leftward = leftward * math.cos(measurement.roll) * period_s
            displacement += forward, leftward, turn * period_s
            middle = heading + turn * period_s / 2
            x += math.cos(middle) * forward - math.sin(middle) * leftward
            y += math.sin(middle) * forward + math.cos(middle) * leftward
            heading += turn * period_s
            board = min(max(board + command.board * period_s, 0.0), self._car.board_travel_m)
            if hinge is not None:
                hinge = min(max(hinge + command.hinge * period_s, 0.0), self._slope.hinge_range_rad)
        fl, fr, rl, rr = (np.array(measurement.wheel_speeds) + (turned - self._ahead)).tolist()
        self._ahead = turned
        # The lines above are left behind.
        along = self._car.board_length_m / 2
        across = self._car.board_width_m / 2
        forward, leftward, turn = displacement.tolist()
        ahead_m = (
            leftward + along * turn,
            leftward - along * turn,
            forward - across * turn,
            forward + across * turn,
        )
        a, b, c, d = (
            line - passed for line, passed in zip(measurement.lines, ahead_m, strict=True)
        )
        return measurement._replace(
            x=x,
            y=y,
            heading=math.remainder(heading, math.tau),
            wheel_speeds=(fl, fr, rl, rr),
            board_m=board,
            hinge_rad=hinge,
            lines=(a, b, c, d),
        )

    def _interpolated(self, candidates: Floats) -> Floats:
        """Return the values (4,) for the likeliest lag of those (n, 4) for each candidate."""
        below = min(math.floor(self._lag), N_LAGS - 2)
        fraction = self._lag - below
        values: Floats = candidates[below] * (1 - fraction) + candidates[below + 1] * fraction
        return values

    @staticmethod
    def _followed(servos: Floats, commanded: Wheels, share: Floats | float) -> Floats:
        """Return the speeds of servos a control period later; four zeros brake at once."""
        if not any(commanded):
            return np.zeros_like(servos)
        return servos + share * (np.array(commanded) - servos)

    def _free(self, servos: Floats) -> Floats:
        """Return the speeds of free wheels for speeds of their servos, in rad/s."""
        return np.copysign(np.maximum(0.0, np.abs(servos) - self._droop_rad_s), servos)
