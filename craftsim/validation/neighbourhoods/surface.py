"""Where a car is as its two axles follow the surface of a ramp."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.validation.neighbourhoods.solids import Pose

_GRAIN_M: Final = 0.0005
"""Between points of the surface: the axles' height is good to 0.01 mm."""


def poses_along(
    ramp: tuple[float, float],
    heights: tuple[float, float],
    stations: NDArray[np.float64],
    car: SmartcarParameters,
) -> list[Pose]:
    """Return the poses of a car that heads +x at these stations.

    Args:
        ramp: x at which the incline begins and ends, metres.
        heights: of the surface before and after it.
        stations: (n,) x of its frame, metres: the point of the surface below the middle between the axles.
        car: whose wheels roll there.
    """
    reach = car.wheel_x_m + car.wheel_radius_m + CELL_PITCH_M
    xs = np.arange(stations.min() - reach, stations.max() + reach, _GRAIN_M)
    surface = np.interp(xs, ramp, heights)
    offsets = np.arange(-car.wheel_radius_m, car.wheel_radius_m + _GRAIN_M / 2, _GRAIN_M)
    rim = np.sqrt(np.maximum(car.wheel_radius_m**2 - offsets**2, 0.0))
    axle = np.max(
        [np.interp(xs + offset, xs, surface) + up for offset, up in zip(offsets, rim, strict=True)], axis=0
    )
    return [_pose(x, xs, axle, car) for x in stations]


def _pose(x: float, xs: NDArray[np.float64], axle: NDArray[np.float64], car: SmartcarParameters) -> Pose:
    """Return the pose with the frame at x, both axles as high as the wheels there have to be."""
    pitch = 0.0
    for _ in range(20):
        half, middle = car.wheel_x_m * math.cos(pitch), x - car.wheel_radius_m * math.sin(pitch)
        rear, front = np.interp([middle - half, middle + half], xs, axle)
        pitch = math.asin((front - rear) / (2 * car.wheel_x_m))
    up = np.array([-math.sin(pitch), 0.0, math.cos(pitch)])
    pose = np.eye(4)
    pose[:3, 0] = (math.cos(pitch), 0.0, math.sin(pitch))
    pose[:3, 2] = up
    pose[:3, 3] = np.array([middle, 0.0, (rear + front) / 2]) - car.wheel_radius_m * up
    return pose
