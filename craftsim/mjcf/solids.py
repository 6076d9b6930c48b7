"""Closed solids from rings of points, and meshes of them: all that is only seen of the machines is made so.

Corners have normals of their own: flat faces stay flat, and only what is to look round is smoothed. MuJoCo works out
its own otherwise, and smooths over bevels and facets, which shows as gradients on flat faces.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

Ring = NDArray[np.float64]
"""Points of a closed outline in space, shape (n, 3), in order."""
Point = tuple[float, float, float]
Interval = tuple[float, float]
"""Smallest and largest coordinate along an axis, in metres."""
Mesh = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]
"""Points, (n, 3) metres, their normals, (n, 3), and faces, (m, 3), of a mesh of solids; what looks sharp there has a
point for each side of its edge."""
Polygon = Sequence[tuple[float, float]]
"""Corners (x, z) of a convex polygon, in order."""

_CREASE_RAD: Final = math.radians(30)
"""Faces that meet at less than this look like one round face: a bevel has 45 degrees, a cylinder of 16 sides 22.5."""


class ClosedSolid(NamedTuple):
    """A closed solid. Solids that make up a mesh may touch or overlap."""

    points: NDArray[np.float64]
    """(n, 3) metres."""
    faces: NDArray[np.int64]
    """(m, 3): triangles, counterclockwise seen from outside."""

    @property
    def volume(self) -> float:
        """Volume in cubic metres; negative where the faces look inwards."""
        a, b, c = self.points[self.faces].transpose(1, 0, 2)
        return float(np.einsum("ni,ni->", a, np.cross(b, c))) / 6

    def outward(self) -> ClosedSolid:
        """Return it with its faces looking outwards."""
        if self.volume > 0:
            return self
        return ClosedSolid(self.points, self.faces[:, ::-1])

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> ClosedSolid:
        """Return it shifted by (x, y, z)."""
        return ClosedSolid(self.points + np.array([x, y, z]), self.faces)

    def rolled(self, angle_rad: float, about_y: bool = False) -> ClosedSolid:
        """Return it turned about the z axis, or about the y axis."""
        c = math.cos(angle_rad)
        s = math.sin(angle_rad)
        turn = np.array(
            [[c, 0, s], [0, 1, 0], [-s, 0, c]] if about_y else [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        )
        return ClosedSolid(self.points @ turn.T, self.faces)


def loft(rings: Sequence[Ring]) -> ClosedSolid:
    """Return the closed solid through two or more rings of equally many points, which are joined point by point.

    Fans close its ends, whose outlines must be star-shaped about their mean points.
    """
    count = len(rings[0])
    points = np.concatenate([*rings, [rings[0].mean(axis=0)], [rings[-1].mean(axis=0)]])
    corner = np.arange(count)
    following = np.roll(corner, -1)
    faces = []
    for lower in range(0, (len(rings) - 1) * count, count):
        upper = lower + count
        faces.append(np.column_stack([lower + corner, lower + following, upper + following]))
        faces.append(np.column_stack([lower + corner, upper + following, upper + corner]))
    last = (len(rings) - 1) * count
    faces.append(np.column_stack([following, corner, np.full(count, len(points) - 2)]))
    faces.append(
        np.column_stack([last + corner, last + following, np.full(count, len(points) - 1)])
    )
    return ClosedSolid(points, np.concatenate(faces)).outward()


def turned(profile: Sequence[Sequence[float]], sections: int, about_y: bool = True) -> ClosedSolid:
    """Return the solid of revolution about the y axis, or the z axis, of a (radius, height) profile, shape (n, 2).

    A profile that starts and ends on the axis gives a solid body; one that returns to its start gives a ring.
    """
    radius, height = np.asarray(profile, float).T
    count = len(radius)
    angles = np.linspace(0, math.tau, sections + 1)[:-1, None]
    around = np.stack(
        [radius * np.cos(angles), radius * np.sin(angles), height + 0 * angles], axis=-1
    )
    corner = np.arange(count - 1)
    following = (corner + count) % (count * sections)
    quads = np.stack(
        [corner, following, corner + 1, corner + 1, following, following + 1], axis=1
    ).reshape(-1, 3)
    faces = (quads + count * np.arange(sections)[:, None, None]).reshape(-1, 3) % (count * sections)
    # Points on the axis, and the last of a ring's profile, are there several times.
    around = around.reshape(-1, 3)
    _, first, number = np.unique(
        np.round(around, 9) + 0.0, axis=0, return_index=True, return_inverse=True
    )
    points = around[first]
    faces = number.reshape(-1)[faces]
    has_area = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    solid = ClosedSolid(points, faces[has_area])
    if about_y:
        # A quarter turn about x takes z to y.
        solid = ClosedSolid(solid.points[:, [0, 2, 1]] * (1, 1, -1), solid.faces)
    return solid.outward()


def between(a: float, b: float) -> Interval:
    """Return the interval between two coordinates given in either order."""
    return min(a, b), max(a, b)


def rectangle(x: Interval, y: Interval, z: float) -> Ring:
    """Return a level rectangle at height z over the intervals x and y."""
    return np.array([[x[0], y[0], z], [x[1], y[0], z], [x[1], y[1], z], [x[0], y[1], z]])


def square(side: float, z: float) -> Ring:
    """Return a level square at height z about the z axis."""
    return rectangle((-side / 2, side / 2), (-side / 2, side / 2), z)


def box(x: Interval, y: Interval, z: Interval, bevel: float = 0.0) -> ClosedSolid:
    """Return a box over three intervals, its top and bottom edges bevelled at 45 degrees."""

    def level(inset: float, height: float) -> Ring:
        return rectangle((x[0] + inset, x[1] - inset), (y[0] + inset, y[1] - inset), height)

    low, high = z
    if bevel == 0.0:
        return loft([level(0.0, low), level(0.0, high)])
    return loft(
        [level(bevel, low), level(0.0, low + bevel), level(0.0, high - bevel), level(bevel, high)]
    )


def plate_xz(outline: ArrayLike, y: Interval) -> ClosedSolid:
    """Return the prism of an (x, z) outline, shape (n, 2), over the interval y."""
    points = np.asarray(outline, float)

    def at(height: float) -> Ring:
        return np.column_stack([points[:, 0], np.full(len(points), height), points[:, 1]])

    return loft([at(y[0]), at(y[1])])


def mesh_of(solids: Sequence[ClosedSolid]) -> Mesh:
    """Return the mesh of some solids.

    The last digits of sines differ between maths libraries: rounded, meshes do not.
    """
    corners = []
    faces = []
    first = 0
    for solid in solids:
        rounded = ClosedSolid(np.round(solid.points, 6) + 0.0, solid.faces)
        normals = np.round(_corner_normals(rounded), 3) + 0.0
        vertices = np.concatenate([rounded.points[rounded.faces], normals], axis=2).reshape(-1, 6)
        distinct, number = np.unique(vertices, axis=0, return_inverse=True)
        corners.append(distinct)
        faces.append(first + number.reshape(-1, 3))
        first += len(distinct)
    points, normals = np.split(np.concatenate(corners), 2, axis=1)
    return points, normals, np.concatenate(faces)


@lru_cache(maxsize=48)
def meshes(
    looks: Callable[[Any], dict[str, list[ClosedSolid]]], parameters: Any
) -> dict[str, Mesh]:
    """Return the meshes that are only seen of a machine with some parameters, by name."""
    return {name: mesh_of(solids) for name, solids in looks(parameters).items()}


def add_mesh(spec: mujoco.MjSpec, name: str, mesh: Mesh) -> str:
    """Add a mesh to a spec, unless there is one of this name; return the name."""
    if spec.mesh(name) is None:
        points, normals, faces = (array.ravel() for array in mesh)
        spec.add_mesh(name=name, uservert=points, usernormal=normals, userface=faces)
    return name


def _corner_normals(solid: ClosedSolid) -> NDArray[np.float64]:
    """Return each corner's unit normal (n, 3, 3): the mean by area over the faces there that meet without a crease."""
    a, b, c = solid.points[solid.faces].transpose(1, 0, 2)
    across = np.cross(b - a, c - a)
    size = np.linalg.norm(across, axis=1)
    unit_normals = across / size[:, None]
    corners = solid.faces.ravel()
    order = np.argsort(corners, kind="stable")
    count = np.bincount(corners, minlength=len(solid.points))
    place = np.arange(len(corners)) - np.repeat(np.cumsum(count) - count, count)
    by_point = np.full((len(solid.points), count.max()), -1)
    by_point[corners[order], place] = order // 3
    around = by_point[solid.faces]  # (n, 3, most faces at a point), -1 where there are fewer
    is_smooth = np.einsum("ni,ncki->nck", unit_normals, unit_normals[around]) > math.cos(
        _CREASE_RAD
    )
    weights = np.where((around >= 0) & is_smooth, size[around], 0.0)
    mean = np.einsum("nck,ncki->nci", weights, unit_normals[around])
    normal: NDArray[np.float64] = mean / np.linalg.norm(mean, axis=2, keepdims=True)
    return normal
