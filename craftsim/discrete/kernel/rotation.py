"""Rotations, compiled: angles brought into one turn, and the axes of a turned body."""

from __future__ import annotations

import math
from typing import Final

from craftsim.compiled.jit import compiled

_TURN: Final = math.tau

Axis = tuple[float, float, float]


@compiled
def wrap(angle: float) -> float:
    """Return an angle in radians brought into [-pi, pi]: ``math.remainder(angle, math.tau)``, bit for bit.

    That function is not among those that numba compiles. What is not finite gives nan.
    """
    size = abs(angle)
    if size <= _TURN / 2:
        return angle
    over = size % _TURN
    short = _TURN - over
    if over < short:
        remainder = over
    elif over > short:
        remainder = -short
    else:  # half a turn: the nearest even number of turns
        remainder = over - 2.0 * (0.5 * (size - over) % _TURN)
    return remainder if angle > 0.0 else -remainder


@compiled
def arcsine(value: float) -> float:
    """Return the arcsine of what may lie beyond 1 by rounding, in radians; nan of nan, which a clamp would hide."""
    if value >= 1.0:
        return math.pi / 2
    if value <= -1.0:
        return -math.pi / 2
    return math.asin(value)


@compiled
def body_axes(w: float, x: float, y: float, z: float) -> tuple[Axis, Axis, Axis]:
    """Return the axes (forward, left, up), in the world frame, of a body turned by this quaternion of any length."""
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    w = w / norm
    x = x / norm
    y = y / norm
    z = z / norm
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
