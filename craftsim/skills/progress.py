"""Whether a car keeps up with its path, and if not, whether its wheels slip or something is in the way."""

from __future__ import annotations

import math

from craftsim.models.parameters import SmartcarParameters
from craftsim.models.sensing import CarMeasurement, PerWheel
from craftsim.skills.gains import DriveGains
from craftsim.skills.mecanum import Mecanum, Triple
from craftsim.skills.outcome import Reason
from craftsim.skills.skill import GRAVITY


class Progress:
    """Watches a car that falls behind its path.

    Wheels that stand say that something is in the way. Wheels that turn although the car does not follow may slip on
    a ground without grip, or spin at an obstacle, because the motors are stronger than the grip. What tells the two
    apart is with how much force they turn: the drives' torques less what friction, the wheels' own inertia and the
    weight on an incline take would have moved a free car a certain way, by Newton's second law. An obstacle is there
    where the car stays far behind that way, too.
    """

    def __init__(self, car: SmartcarParameters, gains: DriveGains, period_s: float) -> None:
        """Watch a car once each control period, in seconds."""
        self._car, self._gains, self._period_s = car, gains, period_s
        self._kinematics = Mecanum(car)
        self._spin_inertia_kgm2 = car.wheel_spin_inertia_kgm2 + car.wheel_armature_kgm2
        self._reset()

    def _reset(self) -> None:
        self._stuck_s = self._rolled_m = self._moved_m = self._free_m_s = self._free_m = 0.0

    def check(
        self,
        before: CarMeasurement,
        now: CarMeasurement,
        commanded: PerWheel,
        error: Triple,
        mass_kg: float,
        inertia_kgm2: float,
    ) -> Reason | None:
        """Return why a car does not get on; None while it does, or while it is too early to say.

        Args:
            before: what the car measured a period ago.
            now: what it measures.
            commanded: wheel speeds in rad/s of the period between.
            error: (m, m, rad) from the car to where it should be, in its own frame.
            mass_kg: of car and load.
            inertia_kgm2: about the vertical axis.
        """
        gains, period_s = self._gains, self._period_s
        behind = math.hypot(error[0], error[1]) + self._kinematics.lever_m * abs(error[2])
        if behind <= gains.blocked_error:
            self._reset()
            return None
        turned = math.remainder(now.heading - before.heading, math.tau)
        self._stuck_s += period_s
        self._moved_m += self._length(now.x - before.x, now.y - before.y, turned)
        self._rolled_m += self._length(*self._kinematics.body_twist(now.wheel_speeds)) * period_s
        x, y, turn = self._push(before, now, commanded, mass_kg)
        lever_m = self._kinematics.lever_m
        towards = (
            x / mass_kg * error[0] + y / mass_kg * error[1] + turn / inertia_kgm2 * lever_m**2 * error[2]
        )
        self._free_m_s += towards / self._length(*error) * period_s
        self._free_m += self._free_m_s * period_s
        if self._stuck_s <= gains.blocked_time:
            return None
        enough = gains.slip_ratio * self._moved_m + gains.slip_distance
        return Reason.SLIPPED if self._rolled_m > enough >= self._free_m else Reason.BLOCKED

    def _length(self, x: float, y: float, heading: float) -> float:
        """Return the length of a way (m, m, rad) in metres, a turn by what the wheels roll for it."""
        return math.sqrt(x * x + y * y + (self._kinematics.lever_m * heading) ** 2)

    def _push(
        self, before: CarMeasurement, now: CarMeasurement, commanded: PerWheel, mass_kg: float
    ) -> Triple:
        """Return with what wrench (N, N, Nm), in its own frame, the wheels push the car beyond its weight."""

        def torque(told: float, was: float, speed: float) -> float:
            car = self._car
            told = _within(car.wheel_speed_rad_s, told)
            given = _within(car.wheel_torque_nm, car.wheel_gain_nms_rad * (told - speed))
            lost = car.gear_friction_nm * math.tanh(speed / self._gains.friction_speed)
            return given - lost - self._spin_inertia_kgm2 * (speed - was) / self._period_s

        torques = map(torque, commanded, before.wheel_speeds, now.wheel_speeds)
        x, y, turn = self._kinematics.wrench(torques)
        weight = mass_kg * GRAVITY
        return x - weight * math.sin(now.pitch), y - weight * math.sin(now.roll), turn


def _within(limit: float, value: float) -> float:
    return max(-limit, min(limit, value))
