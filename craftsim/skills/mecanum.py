"""Ideal mecanum kinematics: between a twist of the body and the speeds of the four wheels.

With wheel radius R and lever l = half wheelbase + half track (rollers at 45 degrees, X arrangement), a body twist
(vx, vy, omega) needs the wheel speeds R w = (vx - vy - l omega, vx + vy + l omega, vx + vy - l omega,
vx - vy + l omega) at front left, front right, rear left and rear right.

Plain numbers: this runs for every car in every control period, where small arrays would take several times as long.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from craftsim.models.parameters import SMARTCAR
from craftsim.models.sensing import PerWheel

_L: Final = SMARTCAR.turn_radius_m
_R: Final = SMARTCAR.wheel_radius_m

Triple = tuple[float, float, float]
"""(x, y, heading) or (vx, vy, omega): a pose, a way or a speed."""


def wheel_speeds(twist: Iterable[float]) -> PerWheel:
    """Return the four wheel speeds in rad/s of a body twist (vx, vy, omega) in m/s, m/s and rad/s."""
    x, y, turn = twist
    along, across, spin = x / _R, y / _R, _L * turn / _R
    return along - across - spin, along + across + spin, along + across - spin, along - across + spin


def wheel_torques(wrench: Iterable[float]) -> PerWheel:
    """Return the four wheel torques in Nm that push the body with a wrench (fx, fy, mz) in N, N and Nm.

    By equal power, torque . speed = wrench . twist; of all torques that do it these are the smallest.
    """
    x, y, turn = wrench
    along, across, spin = _R / 4 * x, _R / 4 * y, _R / 4 * turn / _L
    return along - across - spin, along + across + spin, along + across - spin, along - across + spin


def body_twist(speeds: Iterable[float]) -> Triple:
    """Return the body twist (vx, vy, omega) that fits four wheel speeds in rad/s best in the sense of least squares."""
    fl, fr, rl, rr = speeds
    quarter = _R / 4
    return quarter * (fl + fr + rl + rr), quarter * (fr + rl - fl - rr), quarter / _L * (fr + rr - fl - rl)
