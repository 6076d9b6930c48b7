"""Ideal mecanum kinematics: between a twist of the body and the speeds of the four wheels.

With wheel radius R and lever l = half wheelbase + half track (rollers at 45 degrees, X arrangement), a body twist
(vx, vy, omega) needs the wheel speeds R w = (vx - vy - l omega, vx + vy + l omega, vx + vy - l omega,
vx - vy + l omega) at front left, front right, rear left and rear right.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from craftsim.models.parameters import SMARTCAR

_L = SMARTCAR.turn_radius_m
TWIST_TO_WHEELS: Final[NDArray[np.float64]] = (
    np.array([[1, -1, -_L], [1, 1, _L], [1, 1, -_L], [1, -1, _L]]) / SMARTCAR.wheel_radius_m
)
"""(4, 3): wheel speeds in rad/s from a body twist in m/s, m/s and rad/s."""
WHEELS_TO_TWIST: Final[NDArray[np.float64]] = np.linalg.pinv(TWIST_TO_WHEELS).astype(np.float64)
"""(3, 4): the body twist that fits four wheel speeds best in the sense of least squares."""


def wheel_speeds(twist: ArrayLike) -> NDArray[np.float64]:
    """Return the four wheel speeds in rad/s, shape (4,), of a body twist (vx, vy, omega)."""
    return TWIST_TO_WHEELS @ np.asarray(twist, float)


def wheel_torques(wrench: ArrayLike) -> NDArray[np.float64]:
    """Return the four wheel torques in Nm, shape (4,), that push the body with a wrench (fx, fy, mz) in N, N and Nm.

    By equal power, torque . speed = wrench . twist; of all torques that do it these are the smallest.
    """
    return WHEELS_TO_TWIST.T @ np.asarray(wrench, float)


def body_twist(speeds: ArrayLike) -> NDArray[np.float64]:
    """Return the body twist (vx, vy, omega), shape (3,), that four wheel speeds in rad/s imply without slip."""
    return WHEELS_TO_TWIST @ np.asarray(speeds, float)
