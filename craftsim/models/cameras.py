"""Fitting a camera to what it shows: the nearest place from which every point lies within the picture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from craftsim.discrete.geometry import CELL_PITCH_M

MARGIN: Final = 0.03
"""What is left free at each edge of a picture, as a share of its width or height."""

OVERVIEW_ELEVATION_DEG: Final = -32.0
OVERVIEW_FOVY_DEG: Final = 30.0
"""Less than the elevation: the upper edge of the picture still shows floor, no sky."""
TOP_FOVY_DEG: Final = 14.0
"""Small, so that what stands high hides little beside it."""


@dataclass(frozen=True)
class Aim:
    """Pose of a camera, as MuJoCo's free camera has it; the horizon is level."""

    lookat: NDArray[np.float64]
    """(3,) metres, world: in the middle of the picture."""
    distance_m: float
    azimuth_deg: float
    """Azimuth of the direction in which it looks, from x towards y."""
    elevation_deg: float
    """Elevation of that direction, upwards; -90 looks straight down."""
    fovy_deg: float
    """Vertical field of view."""

    @property
    def axes(self) -> NDArray[np.float64]:
        """(3, 3): its columns are the camera's right, up and backward directions in the world."""
        azimuth = math.radians(self.azimuth_deg)
        elevation = math.radians(self.elevation_deg)
        ca = math.cos(azimuth)
        sa = math.sin(azimuth)
        ce = math.cos(elevation)
        se = math.sin(elevation)
        return np.array([[sa, -se * ca, -ce * ca], [-ca, -se * sa, -ce * sa], [0.0, ce, -se]])

    @property
    def position(self) -> NDArray[np.float64]:
        """(3,) metres, world."""
        return self.lookat + self.distance_m * self.axes[:, 2]

    @property
    def quaternion(self) -> NDArray[np.float64]:
        """(4,) unit quaternion, w first."""
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, self.axes.ravel())
        return quaternion

    def project(self, points: ArrayLike, aspect: float) -> NDArray[np.float64]:
        """Return where points (n, 3) lie in a picture (aspect: width over height), (n, 2) from -1 to 1 right and up."""
        in_view = (np.asarray(points, float) - self.position) @ self.axes
        high = math.tan(math.radians(self.fovy_deg) / 2)
        return in_view[:, :2] / (-in_view[:, 2:] * [high * aspect, high])


def fitted(
    points: ArrayLike, azimuth_deg: float, elevation_deg: float, fovy_deg: float, aspect: float
) -> Aim:
    """Return the camera of these angles that shows all points (n, 3) from as near as MARGIN allows.

    It is exact. In the camera's axes (x right, d forward), a point lies between the left and the right edge where
    |x - x0| <= t (d - d0), t being the tangent of half the field of view. So x0 - t d0 >= max(x - t d) and
    x0 + t d0 <= min(x + t d), and the largest d0 for which there is such an x0 is half of the difference over t;
    likewise for the lower and the upper edge. The camera moves to the smaller d0 of the two.
    """
    aim = Aim(np.zeros(3), 0.0, azimuth_deg, elevation_deg, fovy_deg)
    right, up, backward = aim.axes.T
    in_view = np.asarray(points, float) @ np.column_stack([right, up, -backward])
    slope = (1 - 2 * MARGIN) * math.tan(math.radians(fovy_deg) / 2) * np.array([aspect, 1.0])
    low = (in_view[:, :2] - slope * in_view[:, 2:]).max(axis=0)
    high = (in_view[:, :2] + slope * in_view[:, 2:]).min(axis=0)
    across, above = (low + high) / 2
    depth = float(((high - low) / (2 * slope)).min())
    middle = float(in_view[:, 2].min() + in_view[:, 2].max()) / 2
    lookat = across * right + above * up - middle * backward
    return Aim(lookat, middle - depth, azimuth_deg, elevation_deg, fovy_deg)


def box_corners(size: tuple[int, ...], height_m: float) -> NDArray[np.float64]:
    """Return the corners (8, 3), in metres, of an area of ``size`` cells up to a height."""
    length = size[0] * CELL_PITCH_M
    width = size[1] * CELL_PITCH_M
    return np.array(
        [(x, y, z) for x in (0.0, length) for y in (0.0, width) for z in (0.0, height_m)]
    )


def overview_aim(
    size: tuple[int, ...], height_m: float, aspect: float, strip_m: float = 0.0
) -> Aim:
    """Return the camera that shows a whole area, and a strip of floor before it and to its right, from there, above.

    The longer side of the area runs along the longer one of the picture.
    """
    if aspect >= 1:
        length, width = size[:2]
    else:
        length = size[1]
        width = size[0]
    azimuth = 128.0 + 30.0 * (width - length) / (length + width)
    points = _with_strip(size, height_m, strip_m)
    return fitted(points, azimuth, OVERVIEW_ELEVATION_DEG, OVERVIEW_FOVY_DEG, aspect)


def top(size: tuple[int, ...], height_m: float, aspect: float, strip_m: float = 0.0) -> Aim:
    """Return the camera that shows the same as ``overview`` from straight above, x to the right and y upwards."""
    return fitted(_with_strip(size, height_m, strip_m), 90.0, -90.0, TOP_FOVY_DEG, aspect)


def _with_strip(size: tuple[int, ...], height_m: float, strip_m: float) -> NDArray[np.float64]:
    """Return the corners of an area, and the ends of what stands in the strip, in the middles of its cells."""
    length = size[0] * CELL_PITCH_M
    width = size[1] * CELL_PITCH_M
    inset = 0.3 * CELL_PITCH_M
    below = [(x, -strip_m, 0.0) for x in (inset, length - inset)]
    right = [(length + strip_m, y, 0.0) for y in (inset, width - inset)]
    return np.vstack([box_corners(size, height_m), below, right])
