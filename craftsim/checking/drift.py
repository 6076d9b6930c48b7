"""How far machines move from the places where they should stand, and cars from their paths."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled
from craftsim.models.measuring import Floats
from craftsim.models.world import PhysicsWorld


class Drift:
    """The distances of cars and things from the places where they should stand, and of driving cars from their paths.

    Machines are numbered as poses are: cars by id, then objects. A place is the pose at the start, or at the last call
    of :meth:`leave`: many small movements add up. It is checked after each control period.
    """

    def __init__(self, physics: PhysicsWorld, places: NDArray[np.intp]) -> None:
        """Take the places where everything is now; ``places`` says where their poses, (n, 7), lie in qpos."""
        self._qpos, self._qvel, self._places = physics.data.qpos, physics.data.qvel, places
        joints = np.searchsorted(physics.model.jnt_qposadr, places[:, 0])
        self._speeds = physics.model.jnt_dofadr[joints].astype(np.intp)[:, None] + np.arange(3)
        self._left, self.furthest = np.zeros((len(places), 7)), np.zeros((len(places), 2))
        """(n, 2): the largest distance in metres, and angle in radians, of each machine from its place."""
        n_cars = len(physics.cars)
        self.strayed_m, self.path = np.zeros(n_cars), np.full((n_cars, 2), np.nan)
        """(n,): each car's largest distance from its path since its action began; (n, 2): its last set point."""
        self.leave(range(len(places)))

    def speed_m_s(self) -> float:
        """Return how fast the fastest machine moves now."""
        velocity = self._qvel[self._speeds]
        return float(np.sqrt((velocity * velocity).sum(axis=1).max(initial=0.0)))

    def leave(self, machines: Iterable[int]) -> None:
        """Take the present poses of these as their places."""
        rows = list(machines)
        self._left[rows] = self._qpos[self._places[rows]]
        self.furthest[rows] = 0.0

    def settle(self, machines: slice | list[int]) -> None:
        """Forget earlier distances of these: only the present ones count."""
        self.furthest[machines] = 0.0
        self.look()

    def look(self, _: PhysicsWorld | None = None) -> None:
        """Note the distance of everything from its place; call it after each control period."""
        _note_away(self._qpos, self._places, self._left, self.furthest)

    def stray(self, paths: Floats) -> None:
        """Note the distance of each driving car from the last segment of its path; call it after each control period.

        ``paths`` (n, 3) are the set points of an executor.
        """
        path, start = paths[:, :2], self.path
        at = self._qpos[self._places[: len(path), :2]]
        way = path - start
        length = np.maximum((way * way).sum(axis=1), 1e-12)
        share = np.clip(((at - start) * way).sum(axis=1) / length, 0.0, 1.0)
        beside = np.hypot(*(at - start - share[:, None] * way).T)
        self.strayed_m = np.fmax(self.strayed_m, beside)
        self.path = path


@compiled
def _note_away(qpos: Floats, places: NDArray[np.integer], left: Floats, furthest: Floats) -> None:
    """Note the distance of each machine, its pose in qpos at ``places`` (n, 7), from its place in ``left``."""
    for i in range(len(places)):
        start = places[i, 0]
        metres, radians = apart(qpos[start : start + 7], left[i])
        furthest[i, 0], furthest[i, 1] = max(furthest[i, 0], metres), max(furthest[i, 1], radians)


@compiled
def apart(one: Floats, other: Floats) -> tuple[float, float]:
    """Return the distance in metres between two poses (7,), and the angle in radians, exact for small ones."""
    x, y, z = one[0] - other[0], one[1] - other[1], one[2] - other[2]
    metres = math.sqrt(x * x + y * y + z * z)
    a, b, c, d = one[3], one[4], one[5], one[6]
    e, f, g, h = other[3], other[4], other[5], other[6]
    w = a * e + b * f + c * g + d * h
    x = a * f - b * e - c * h + d * g
    y = a * g - c * e - d * f + b * h
    z = a * h - d * e - b * g + c * f
    return metres, 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))
