"""How far cars are from the paths that they drive: on an uneven floor what throws them off."""

from __future__ import annotations

import numpy as np

from craftsim.models.measuring import PoseReader
from craftsim.models.world import Site
from craftsim.skills.executor import Executor


class Straying:
    """The furthest that each car was beside its path in its action."""

    def __init__(self, executor: Executor, poses: PoseReader) -> None:
        """Look at the cars of an executor through a reader of its Site."""
        self._executor, self._poses = executor, poses
        n = len(executor.site.cars)
        self._furthest, self._path = np.zeros(n), np.full((n, 2), np.nan)

    def begin(self, car: int) -> None:
        """Forget what a car did: its next action begins."""
        self._furthest[car], self._path[car] = 0.0, np.nan

    def furthest_m(self, car: int) -> float:
        """Return the furthest that a car was beside its path since its action began, in metres."""
        return float(self._furthest[car])

    def look(self, _: Site) -> None:
        """Note how far each driving car is from its path; call it after each control period.

        A car is a little behind where it should be by now, so it is held against the last piece of its way.
        """
        path = self._executor.paths()[:, :2]
        at, start = self._poses.read().car_positions[:, :2], self._path
        way = path - start
        length = np.maximum((way * way).sum(axis=1), 1e-12)
        share = np.clip(((at - start) * way).sum(axis=1) / length, 0.0, 1.0)
        beside = np.hypot(*(at - start - share[:, None] * way).T)
        self._furthest = np.fmax(self._furthest, beside)
        self._path = path
