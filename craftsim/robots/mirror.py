"""The world of robots elsewhere as a referee sees it: a Site on which nothing acts, for a judge to look at."""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from craftsim.models.parts import FreeBody
from craftsim.models.site import Site
from craftsim.robots.link import Messenger
from craftsim.robots.messages import Follow, Measurements, MessageError, TruePoses, pack, unpack

_KEPT: Final = 64
"""TruePoses that are kept: those of a measurement are there before it has come."""
_EPSILON_S: Final = 1e-6


class Mirror:
    """Shows where everything truly is, at the time of what was measured last.

    Wheels stand still; boards stand where they were measured; velocities are what changed since what was shown before.
    """

    def __init__(self, site: Site, referee: Messenger) -> None:
        """Show on a Site, which is never stepped, what a referee publishes."""
        self.site, self._referee = site, referee
        referee.send(pack(Follow()))
        self._seen: deque[TruePoses] = deque(maxlen=_KEPT)
        handles = [*(car.base for car in site.cars), *site.blocks, *site.flags]
        self._bodies: tuple[FreeBody, ...] = (*handles, *(slope.base for slope in site.slopes))
        self._n_cars, self._n_slopes = len(site.cars), len(site.slopes)

    def follow(self, measured: Measurements, timeout_s: float) -> bool:
        """Show how things stood when that was measured; return whether it could be seen in time."""
        while not self._seen or self._seen[-1].time_s < measured.time_s - _EPSILON_S:
            data = self._referee.receive(timeout_s)
            if data is None:
                return False
            self._take(data)
        shown = next(poses for poses in self._seen if poses.time_s >= measured.time_s - _EPSILON_S)
        self._show(shown, measured)
        return True

    def _take(self, data: bytes) -> None:
        """Take poses, unless they are of another world."""
        try:
            poses = unpack(data)
        except MessageError:
            return
        if isinstance(poses, TruePoses) and not (self._seen and poses.time_s <= self._seen[-1].time_s):
            counts = len(poses.cars), len(poses.cars) + len(poses.things), len(poses.hinges)
            if counts == (self._n_cars, len(self._bodies), self._n_slopes):
                self._seen.append(poses)

    def _show(self, poses: TruePoses, measured: Measurements) -> None:
        site, data = self.site, self.site.data
        passed_s = poses.time_s - data.time
        for body, pose in zip(self._bodies, (*poses.cars, *poses.things), strict=True):
            if passed_s > 0:
                way = np.array(pose[:3]) - data.qpos[body.qpos : body.qpos + 3]
                data.qvel[body.dof : body.dof + 3] = way / passed_s
            data.qpos[body.qpos : body.qpos + 7] = pose
        for slope, hinge in zip(site.slopes, poses.hinges, strict=True):
            data.qpos[slope.hinge.qpos] = hinge
        for car, now in zip(site.cars, measured.cars, strict=True):
            data.qpos[car.board.qpos] = now.board_m
        data.time = poses.time_s
        site.capped_steps = poses.capped_steps
