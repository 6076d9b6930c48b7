"""Ideal mecanum kinematics: between a twist of the body and the speeds of the four wheels.

With wheel radius R and lever l = half wheelbase + half track (rollers at 45 degrees, X arrangement), a body twist
(vx, vy, omega) needs the wheel speeds R w = (vx - vy - l omega, vx + vy + l omega, vx + vy - l omega,
vx - vy + l omega) at front left, front right, rear left and rear right.

Plain numbers: this runs for every car in every control period, where small arrays would take several times as long.
"""

from __future__ import annotations

from collections.abc import Iterable

from craftsim.models.parameters import SmartcarParameters
from craftsim.models.sensing import PerWheel

Triple = tuple[float, float, float]
"""(x, y, heading) or (vx, vy, omega): a pose, a way or a speed."""


class Mecanum:
    """The kinematics of one car's four wheels."""

    def __init__(self, car: SmartcarParameters) -> None:
        """Take wheel radius and lever from a car's figures."""
        self.lever_m = car.turn_radius_m
        self.radius_m = car.wheel_radius_m

    def wheel_speeds(self, twist: Iterable[float]) -> PerWheel:
        """Return the four wheel speeds in rad/s of a body twist (vx, vy, omega) in m/s, m/s and rad/s."""
        x, y, turn = twist
        radius = self.radius_m
        along, across, spin = x / radius, y / radius, self.lever_m * turn / radius
        return along - across - spin, along + across + spin, along + across - spin, along - across + spin

    def wheel_torques(self, wrench: Iterable[float]) -> PerWheel:
        """Return the four wheel torques in Nm that push the body with a wrench (fx, fy, mz) in N, N and Nm.

        By equal power, torque . speed = wrench . twist; of all torques that do it these are the smallest.
        """
        x, y, turn = wrench
        quarter = self.radius_m / 4
        along, across, spin = quarter * x, quarter * y, quarter * turn / self.lever_m
        return along - across - spin, along + across + spin, along + across - spin, along - across + spin

    def wrench(self, torques: Iterable[float]) -> Triple:
        """Return the wrench (fx, fy, mz) in N, N and Nm with which four wheel torques in Nm push the body."""
        fl, fr, rl, rr = torques
        turn = self.lever_m / self.radius_m * (fr + rr - fl - rl)
        return (fl + fr + rl + rr) / self.radius_m, (fr + rl - fl - rr) / self.radius_m, turn

    def body_twist(self, speeds: Iterable[float]) -> Triple:
        """Return the body twist (vx, vy, omega) that fits four wheel speeds in rad/s best, by least squares."""
        fl, fr, rl, rr = speeds
        quarter = self.radius_m / 4
        turn = quarter / self.lever_m * (fr + rr - fl - rl)
        return quarter * (fl + fr + rl + rr), quarter * (fr + rl - fl - rr), turn
