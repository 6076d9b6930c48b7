"""Closed solids from rings of points: all that the machines' visual meshes are made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

Ring = NDArray[np.float64]
"""Points of a closed outline in space, shape (n, 3), in order."""

Parts = list[trimesh.Trimesh]
"""Closed solids that make up a mesh; they may touch or overlap."""

Interval = tuple[float, float]
"""Smallest and largest coordinate along an axis, in metres."""


def loft(rings: Sequence[Ring]) -> trimesh.Trimesh:
    """Return the closed solid through rings of equally many points, its ends closed by fans.

    Args:
        rings: two or more; neighbouring rings are joined point by point. The first and the last outline must
            be star-shaped about their mean point.
    """
    count = len(rings[0])
    points = np.concatenate([*rings, [rings[0].mean(axis=0)], [rings[-1].mean(axis=0)]])
    here = np.arange(count)
    following = np.roll(here, -1)
    faces = []
    for lower in range(0, (len(rings) - 1) * count, count):
        upper = lower + count
        faces.append(np.column_stack([lower + here, lower + following, upper + following]))
        faces.append(np.column_stack([lower + here, upper + following, upper + here]))
    last = (len(rings) - 1) * count
    faces.append(np.column_stack([following, here, np.full(count, len(points) - 2)]))
    faces.append(np.column_stack([last + here, last + following, np.full(count, len(points) - 1)]))
    solid = trimesh.Trimesh(points, np.concatenate(faces), process=False)
    if solid.volume < 0:
        solid.invert()
    return solid


def between(a: float, b: float) -> Interval:
    """Return the interval between two coordinates given in either order."""
    return min(a, b), max(a, b)


def rectangle(x: Interval, y: Interval, z: float) -> Ring:
    """Return a level rectangle at height z over the intervals x and y."""
    return np.array([[x[0], y[0], z], [x[1], y[0], z], [x[1], y[1], z], [x[0], y[1], z]])


def square(side: float, z: float) -> Ring:
    """Return a level square at height z about the z axis."""
    return rectangle((-side / 2, side / 2), (-side / 2, side / 2), z)


def box(x: Interval, y: Interval, z: Interval, bevel: float = 0.0) -> trimesh.Trimesh:
    """Return a box over three intervals, its top and bottom edges bevelled at 45 degrees."""

    def level(inset: float, height: float) -> Ring:
        return rectangle((x[0] + inset, x[1] - inset), (y[0] + inset, y[1] - inset), height)

    if bevel == 0.0:
        return loft([level(0.0, z[0]), level(0.0, z[1])])
    return loft(
        [level(bevel, z[0]), level(0.0, z[0] + bevel), level(0.0, z[1] - bevel), level(bevel, z[1])],
    )


def plate_xz(outline: ArrayLike, y: Interval) -> trimesh.Trimesh:
    """Return the prism of an (x, z) outline, shape (n, 2), over the interval y."""
    points = np.asarray(outline, float)

    def at(height: float) -> Ring:
        return np.column_stack([points[:, 0], np.full(len(points), height), points[:, 1]])

    return loft([at(y[0]), at(y[1])])


def turned(profile: ArrayLike, sections: int) -> trimesh.Trimesh:
    """Return the solid of revolution about the y axis of an (radius, y) profile, shape (n, 2).

    A profile that starts and ends on the axis gives a solid body; one that returns to its start gives a ring.
    """
    solid = trimesh.creation.revolve(np.asarray(profile, float), sections=sections)
    if solid.volume < 0:
        solid.invert()
    # revolve() turns about z; a quarter turn about x takes z to y.
    solid.apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    return solid


def moved(solid: trimesh.Trimesh, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> trimesh.Trimesh:
    """Return a copy shifted by (x, y, z)."""
    return solid.copy().apply_translation((x, y, z))
