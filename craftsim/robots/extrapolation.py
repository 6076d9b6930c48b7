"""What robots will measure when the next command begins, from what they measured last and the commands in between.

A measurement is old when it comes, and a command takes time to get there. Which commands act in between is known: they
say when they are to begin. A wheel is taken to turn as its velocity servo is commanded, less what its gear's friction
takes and what it was seen to lag behind lately; the board and the hinge to move as commanded; and the body to go where
its wheels take it (:mod:`craftsim.skills.mecanum`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.mjcf.machines import Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.measuring import Wheels
from craftsim.models.sensing import CarMeasurement
from craftsim.skills.mecanum import Mecanum
from craftsim.skills.skill import Command

_SHARE: Final = 0.1
"""By what share the lag that a wheel is known for approaches the one that is seen, in a control period."""


class Extrapolation:
    """The motion of one car over a few control periods."""

    def __init__(self, car: SmartcarParameters, machines: Machines, period_s: float) -> None:
        self._car = car
        self._slope = machines.slope
        self._period_s = period_s
        self._kinematics = Mecanum(car)
        self._droop_rad_s = car.gear_friction_nm / car.wheel_gain_nms_rad
        self._lag = np.zeros(4)
        self._seen, self._ahead = np.zeros((2, 4))
        """Sums of the wheels' speeds: over the periods measured since, and over those extrapolated the last time."""

    def note(self, measurement: CarMeasurement, acted: Command, periods: int = 1) -> None:
        """Learn how fast the wheels turn under a command that has acted, so many periods after what was noted last."""
        self._seen += np.array(measurement.wheel_speeds) * periods
        self._lag += _SHARE * (
            np.array(measurement.wheel_speeds) - self._free(acted.wheels) - self._lag
        )

    def after(self, measurement: CarMeasurement, to_act: Iterable[Command]) -> CarMeasurement:
        """Return the measurement that follows on another when some commands have acted, each a control period long.

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
        for command in to_act:
            wheels = self._free(command.wheels) + self._lag
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
        fl, fr, rl, rr = (self._seen + (turned - self._ahead)).tolist()
        self._seen = np.zeros(4)
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

    def _free(self, commanded: Wheels) -> NDArray[np.float64]:
        """Return the speeds of free wheels for commanded speeds, (4,) in rad/s."""
        speeds = np.array(commanded)
        return np.copysign(np.maximum(0.0, np.abs(speeds) - self._droop_rad_s), speeds)
