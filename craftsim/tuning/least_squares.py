"""Robust nonlinear least squares within bounds, for residuals of a simulation: a Jacobian is a dozen of its runs.

Gauss-Newton steps in a box around the point, which grows and shrinks as the linear model holds; each step is solved
within box and bounds. ``scipy.optimize.least_squares`` keeps away from bounds and shrinks its steps near them; the lags
of a car without any lie on theirs, and it then takes several times as many Jacobians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from craftsim.compiled.arrays import Floats

_HUBER: Final = 3.0
"""Residual, in terms of its noise, beyond which it counts linearly."""
_FIRST_RADIUS: Final = 2.0
_LARGEST_RADIUS: Final = 4.0
_LEAST_RADIUS: Final = 1e-3


def huber(residuals: Floats) -> float:
    """Return the cost of residuals: half their squares; beyond _HUBER they count linearly."""
    sizes = np.abs(residuals)
    squares = np.minimum(sizes, _HUBER) ** 2 / 2
    linear = _HUBER * np.maximum(sizes - _HUBER, 0.0)
    return float((squares + linear).sum())


@dataclass(frozen=True)
class Minimum:
    """Where a search has ended."""

    point: Floats
    """(n,)"""
    cost: float
    """Of the residuals, by :func:`huber`, and of the prior."""


def minimize_huber(
    residuals: Callable[[Floats], Floats],
    jacobian: Callable[[Floats], Floats],
    start: Floats,
    bounds: tuple[Floats, Floats],
    allowed: Callable[[Floats], bool],
    prior: float,
    most_steps: int,
    tolerance: float,
) -> Minimum:
    """Return the minimum of the Huber cost, near a start.

    Args:
        residuals: (m,) of a point (n,).
        jacobian: (m, n) of a point (n,).
        start: (n,); it is moved into the bounds.
        bounds: least and largest points, (n,) each.
        allowed: whether a point (n,) may be gone to.
        prior: standard deviation of each coordinate around 0, which is added to the cost.
        most_steps: how many Jacobians are worked out at most.
        tolerance: the search ends with a step that lowers the cost by less than this share of it.
    """
    low, high = bounds
    weight = 1 / prior**2
    point = np.clip(start, low, high)
    errors = residuals(point)
    cost = huber(errors) + weight * float(point @ point) / 2
    radius = _FIRST_RADIUS
    for _ in range(most_steps):
        slopes = jacobian(point)
        # The weights by which squares become the Huber cost.
        weights = np.sqrt(_HUBER / np.maximum(np.abs(errors), _HUBER))
        weighted = slopes * weights[:, None]
        curvature = weighted.T @ weighted + weight * np.eye(len(point))
        gradient = weighted.T @ (errors * weights) + weight * point
        before = cost
        while radius >= _LEAST_RADIUS:
            step = _step(
                curvature,
                gradient,
                np.maximum(low - point, -radius),
                np.minimum(high - point, radius),
            )
            if not allowed(point + step):
                radius = 0.5 * float(np.abs(step).max())
                continue
            new_errors = residuals(point + step)
            new_cost = huber(new_errors) + weight * float((point + step) @ (point + step)) / 2
            expected = -float(gradient @ step + step @ curvature @ step / 2)
            share = (cost - new_cost) / max(expected, 1e-300)
            if share < 0.25:
                radius = 0.3 * float(np.abs(step).max())
            elif share > 0.75:
                radius = min(2 * radius, _LARGEST_RADIUS)
            if new_cost < cost:
                point = point + step
                errors = new_errors
                cost = new_cost
                break
            if expected < tolerance * cost:
                return Minimum(point, cost)
        if before - cost <= tolerance * before:
            break
    return Minimum(point, cost)


def _step(curvature: Floats, gradient: Floats, low: Floats, high: Floats) -> Floats:
    """Return the minimum within a box of a quadratic function, positive definite."""
    from scipy.optimize import lsq_linear

    root = np.linalg.cholesky(curvature)
    # The box has 0 in it, at its border where a bound holds.
    high = np.maximum(high, low + 1e-12)
    target = -np.linalg.solve(root, gradient)
    step: Floats = lsq_linear(root.T, target, bounds=(low, high)).x
    return step
