"""Sets of convex solids in the world, and how far one set is from another; python-fcl measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import fcl
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from craftsim.mjcf.parameters import Machines
from craftsim.models.placement import Placement
from craftsim.validation.neighbourhoods.solids import figure_of, pose_of

_TOUCHING_M: Final = 1e-7
"""Closer than this, solids count as touching."""
_DEEP_M: Final = 0.02
"""What overlaps deeper is not searched for the place where it is deepest."""


@dataclass(frozen=True)
class Clearance:
    """How far two sets of solids are apart, and which of them are closest."""

    distance_m: float
    """Negative: by so much the deepest pair overlaps, or one that overlaps by more than 20 mm."""
    mine: str
    theirs: str


class Convex:
    """One convex solid in the world."""

    def __init__(self, name: str, points: NDArray[np.float64]) -> None:
        """Take a name and (n, 3) points, whose convex hull it is."""
        self.name, self.points = name, points

    @cached_property
    def _hull(self) -> ConvexHull:
        return ConvexHull(self.points)

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """(m, 3): the points that are corners of the hull."""
        return np.ascontiguousarray(self.points[self._hull.vertices])

    @cached_property
    def shape(self) -> Any:
        """The same for python-fcl."""
        number = np.zeros(len(self.points), int)
        number[self._hull.vertices] = np.arange(len(self.corners))
        faces = np.insert(number[self._hull.simplices], 0, 3, axis=1)
        return fcl.Convex(self.corners, len(faces), faces.ravel())


class Solids:
    """Convex solids that count as one thing."""

    def __init__(self, pieces: Sequence[Convex]) -> None:
        """Take the pieces, at least one."""
        self.pieces = tuple(pieces)
        self.boxes = np.array([(p.points.min(axis=0), p.points.max(axis=0)) for p in self.pieces])
        """(n, 2, 3): lowest and highest corner of each piece."""
        self.box = np.array([self.boxes[:, 0].min(axis=0), self.boxes[:, 1].max(axis=0)])

    def clearance(
        self, other: Solids, within_m: float, shift: NDArray[np.float64] | None = None
    ) -> Clearance | None:
        """Return how far another set is, moved by ``shift``; None where it is further than ``within_m``,
        which may be negative."""
        by = np.zeros(3) if shift is None else shift
        if _bounds(self.box[None], other.box[None] + by)[0, 0] > within_m:
            return None
        bounds = _bounds(self.boxes, other.boxes + by)
        found: Clearance | None = None
        for flat in np.argsort(bounds, axis=None, kind="stable"):
            i, j = np.unravel_index(flat, bounds.shape)
            limit = within_m if found is None else found.distance_m - _TOUCHING_M
            if bounds[i, j] > limit or (found is not None and found.distance_m < -_DEEP_M):
                break
            distance = _distance(self.pieces[i], other.pieces[j], by)
            if distance <= limit:
                found = Clearance(distance, self.pieces[i].name, other.pieces[j].name)
        return found


def _distance(a: Convex, b: Convex, shift: NDArray[np.float64]) -> float:
    """Return the signed distance of two convex solids, the second one moved.

    FCL's own depths end the process where faces touch, so the depth is that of the origin in the hull of all
    differences between corners.
    """
    moved = fcl.CollisionObject(b.shape, fcl.Transform(shift))
    apart = float(
        fcl.distance(fcl.CollisionObject(a.shape), moved, fcl.DistanceRequest(), fcl.DistanceResult())
    )
    if apart > _TOUCHING_M:
        return apart
    differences = (a.corners[:, None] - (b.corners + shift)[None]).reshape(-1, 3)
    return float(ConvexHull(differences).equations[:, 3].max())


def _bounds(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, m): what the signed distance of solids in these boxes is not below."""
    apart = np.maximum(a[:, None, 0] - b[None, :, 1], b[None, :, 0] - a[:, None, 1])
    outside = np.linalg.norm(np.maximum(apart, 0.0), axis=2)
    return np.where(outside > 0.0, outside, apart.max(axis=2))


def convexes_of(placement: Placement, machines: Machines) -> list[Convex]:
    """Return the solids of a part where it stands."""
    figure = figure_of(placement.kind, machines)
    points = figure.posed(pose_of(placement), placement.joint)
    return [
        Convex(f"{placement.kind} {solid.name}", corners)
        for solid, corners in zip(figure.solids, points, strict=True)
    ]
