"""Ideal mecanum kinematics: between a twist of the body and the speeds of the four wheels.

With wheel radius R and lever l = half wheelbase + half track (rollers at 45 degrees, X arrangement), a body twist
(vx, vy, omega) needs the wheel speeds R w = (vx - vy - l omega, vx + vy + l omega, vx + vy - l omega,
vx - vy + l omega) at front left, front right, rear left and rear right.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from craftsim.compiled.jit import compiled
from craftsim.mjcf.parameters import GRAVITY, SmartcarParameters
from craftsim.models.measuring import CarMeasurement, Wheels

Triple = tuple[float, float, float]
"""(x, y, heading) or (vx, vy, omega): a pose, a way or a speed."""


class FeltForces(NamedTuple):
    """Contact forces of a car, computed from its motors; zero within the noise for one that stands free."""

    wheels_n: Wheels
    """Force of each wheel on the car, forward positive."""
    wrench: Triple
    """(N, N, Nm) in the car's frame: of all wheels, less the weight component on an incline."""
    board_n: float
    """Force on the board from above; 0 while the board stands on its stop."""


class Mecanum:
    """Kinematics and contact forces of one car's four wheels.

    Example:
        >>> import craftsim
        >>> mecanum = craftsim.Mecanum(craftsim.Machines().cars[0])
        >>> [round(number, 6) for number in mecanum.body_twist(mecanum.wheel_speeds((0.2, 0.0, 0.5)))]
        [0.2, 0.0, 0.5]
    """

    def __init__(self, car: SmartcarParameters) -> None:
        self._car = car
        self.lever_m = car.turn_radius_m
        self.radius_m = car.wheel_radius_m

    def wheel_speeds(self, twist: Iterable[float]) -> Wheels:
        """Return the four wheel speeds in rad/s of a body twist (vx, vy, omega) in m/s, m/s and rad/s."""
        x, y, turn = map(float, twist)
        return on_wheels(x / self.radius_m, y / self.radius_m, self.lever_m * turn / self.radius_m)

    def wheel_torques(self, wrench: Iterable[float]) -> Wheels:
        """Return the four wheel torques in Nm of least norm for a wrench (fx, fy, mz) in N, N and Nm."""
        x, y, turn = map(float, wrench)
        quarter = self.radius_m / 4
        return on_wheels(quarter * x, quarter * y, quarter * turn / self.lever_m)

    def wrench(self, torques: Iterable[float]) -> Triple:
        """Return the wrench (fx, fy, mz) in N, N and Nm of four wheel torques in Nm."""
        return wrench_of(self.lever_m, self.radius_m, *map(float, torques))

    def felt_forces(self, measurement: CarMeasurement, commanded: Wheels) -> FeltForces:
        """Return the contact forces, given a measurement and the last commanded wheel speeds in rad/s.

        A velocity servo's torque is its gain times its speed error; gear friction is subtracted.
        """
        car = self._car
        torques = []
        for speed, command in zip(measurement.wheel_speeds, commanded, strict=True):
            torque = car.wheel_gain_nms_rad * (command - speed)
            torque = max(-car.wheel_torque_nm, min(car.wheel_torque_nm, torque))
            torques.append(math.copysign(max(0.0, abs(torque) - car.gear_friction_nm), torque))
        load_n = max(0.0, measurement.board_force_n - car.board_mass_kg * GRAVITY)
        weight_n = car.mass_kg * GRAVITY + load_n
        x, y, turn = self.wrench(torques)
        x = x - weight_n * math.sin(measurement.pitch)
        y = y - weight_n * math.sin(measurement.roll)
        fl, fr, rl, rr = (torque / self.radius_m for torque in torques)
        return FeltForces((fl, fr, rl, rr), (x, y, turn), load_n)

    def body_twist(self, speeds: Iterable[float]) -> Triple:
        """Return the least-squares body twist (vx, vy, omega) of four wheel speeds in rad/s."""
        return body_twist(self.lever_m, self.radius_m, *map(float, speeds))


@compiled
def on_wheels(along: float, across: float, spin: float) -> Wheels:
    """Return the speeds or torques of the wheels for components along and across the car and of a spin."""
    return (
        along - across - spin,
        along + across + spin,
        along + across - spin,
        along - across + spin,
    )


@compiled
def wrench_of(
    lever_m: float, radius_m: float, fl: float, fr: float, rl: float, rr: float
) -> Triple:
    """Return the wrench of wheel torques; see :class:`Mecanum`."""
    turn = lever_m / radius_m * (fr + rr - fl - rl)
    return (fl + fr + rl + rr) / radius_m, (fr + rl - fl - rr) / radius_m, turn


@compiled
def body_twist(
    lever_m: float, radius_m: float, fl: float, fr: float, rl: float, rr: float
) -> Triple:
    """Return the twist of wheel speeds; see :class:`Mecanum`."""
    quarter = radius_m / 4
    turn = quarter / lever_m * (fr + rr - fl - rl)
    return quarter * (fl + fr + rl + rr), quarter * (fr + rl - fl - rr), turn
