"""What robots will measure when the next command begins, from what they measured last and the commands in between.

A measurement is old when it comes, and a command takes time to get there. Which commands act in between is known: they
say when they are to begin. A wheel is taken to change its speed as its command does beyond what its gear's friction takes, the board and the hinge to move
as they are told; the body goes where its wheels take it (:mod:`craftsim.skills.mecanum`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from craftsim.discrete.rotation import wrap
from craftsim.models.parameters import Machines, SmartcarParameters
from craftsim.models.sensing import CarMeasurement
from craftsim.skills.mecanum import Mecanum
from craftsim.skills.skill import Command


class Prediction:
    """The motion of one car over a few control periods."""

    def __init__(self, car: SmartcarParameters, machines: Machines, period_s: float) -> None:
        """Take the figures of the car and of what it handles."""
        self._car, self._slope, self._period_s = car, machines.slope, period_s
        self._kinematics = Mecanum(car)
        self._droop_rad_s = car.gear_friction_nm / car.wheel_gain_nms_rad

    def after(self, now: CarMeasurement, acted: Command, to_act: Iterable[Command]) -> CarMeasurement:
        """Return the measurement that follows on ``now``, in which ``acted`` ended, when some commands have acted.

        Each acts for one control period.
        """
        period_s = self._period_s
        x, y, heading, board, hinge = now.x, now.y, now.heading, now.board_m, now.hinge_rad
        wheels = now.wheel_speeds
        for command in to_act:
            fl, fr, rl, rr = (
                speed + self._speed(told) - self._speed(before)
                for speed, told, before in zip(now.wheel_speeds, command.wheels, acted.wheels, strict=True)
            )
            wheels = fl, fr, rl, rr
            forward, left, turn = self._kinematics.body_twist(wheels)
            forward, left = forward * math.cos(now.pitch) * period_s, left * math.cos(now.roll) * period_s
            middle = heading + turn * period_s / 2
            x += math.cos(middle) * forward - math.sin(middle) * left
            y += math.sin(middle) * forward + math.cos(middle) * left
            heading += turn * period_s
            board = min(max(board + command.board * period_s, 0.0), self._car.board_travel_m)
            if hinge is not None:
                hinge = min(max(hinge + command.hinge * period_s, 0.0), self._slope.hinge_range_rad)
        return now._replace(
            x=x, y=y, heading=wrap(heading), wheel_speeds=wheels, board_m=board, hinge_rad=hinge
        )

    def _speed(self, told: float) -> float:
        """Return at what speed a wheel turns freely when its velocity servo is told one, in rad/s."""
        return math.copysign(max(0.0, abs(told) - self._droop_rad_s), told)
