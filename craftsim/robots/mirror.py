"""The world of robots elsewhere as a referee sees it: a PhysicsWorld on which nothing acts, for a judge to look at."""

from __future__ import annotations

import time
from collections import deque
from typing import Final

import numpy as np

from craftsim.models.parts import FreeBody
from craftsim.models.world import PhysicsWorld
from craftsim.robots.link import Messenger
from craftsim.robots.messages import Follow, Measurements, MessageError, TruePoses, pack, unpack
from craftsim.robots.surroundings import Surroundings

_KEPT: Final = 64
"""TruePoses that are kept: those of a measurement are there before it has come."""
_AHEAD_S: Final = 12.0
"""By how much what a referee shows may be younger than what was measured: by as much as a network can delay that."""
_EPSILON_S: Final = 1e-6


class Mirror:
    """Shows where everything truly is, at the time of what was measured last.

    Wheels stand still; boards stand where they were measured; velocities are what changed since what was shown before.
    """

    def __init__(self, physics: PhysicsWorld, referee: Messenger, ticket: str = "") -> None:
        """Show on a world, which is never stepped, what a referee publishes; ``ticket`` is that of the driver."""
        self.physics, self._referee = physics, referee
        referee.send(pack(Follow(ticket)))
        self._surroundings = Surroundings(physics.size)
        self._seen: deque[TruePoses] = deque(maxlen=_KEPT)
        handles = [*(car.base for car in physics.cars), *physics.tables]
        self._bodies: tuple[FreeBody, ...] = (*handles, *(slope.base for slope in physics.slopes))
        self._n_cars, self._n_slopes = len(physics.cars), len(physics.slopes)

    def follow(self, measured: Measurements, timeout_s: float) -> str:
        """Show how things stood when that was measured; return why it was not seen in time, or nothing."""
        deadline, why = time.monotonic() + timeout_s, ""
        while not self._seen or self._seen[-1].time_s < measured.time_s - _EPSILON_S:
            left_s = deadline - time.monotonic()
            try:
                data = self._referee.receive(left_s) if left_s > 0 else None
            except ConnectionError as error:
                return f"the referee is gone: {error}"
            if data is None:
                return f"the referee has shown nothing of use for {timeout_s:g} s{why}"
            why = self._take(data) or why
        shown = next(poses for poses in self._seen if poses.time_s >= measured.time_s - _EPSILON_S)
        if shown.time_s > measured.time_s + _AHEAD_S:
            return (
                f"the referee's clock shows {shown.time_s:g} s where the robots measure {measured.time_s:g} s"
            )
        self._show(shown, measured)
        return ""

    def _take(self, data: bytes) -> str:
        """Take poses that are newer; return why they cannot be of this world, or nothing."""
        try:
            poses = unpack(data)
        except MessageError as error:
            return f" (dropped: {error})"
        if not isinstance(poses, TruePoses):
            return f" (dropped: {poses.kind})"
        came = len(poses.cars), len(poses.things), len(poses.hinges)
        there = self._n_cars, len(self._bodies) - self._n_cars, self._n_slopes
        if came != there:
            return " (dropped: {} cars, {} things and {} hinges; there are {}, {} and {})".format(
                *came, *there
            )
        if not all(self._surroundings.holds(*pose[:3]) for pose in (*poses.cars, *poses.things)):
            return " (dropped: poses outside the world)"
        if not self._seen or poses.time_s > self._seen[-1].time_s + _EPSILON_S:
            self._seen.append(poses)
        return ""

    def _show(self, poses: TruePoses, measured: Measurements) -> None:
        physics, data = self.physics, self.physics.data
        passed_s = poses.time_s - data.time
        for body, pose in zip(self._bodies, (*poses.cars, *poses.things), strict=True):
            if passed_s > 0:
                way = np.array(pose[:3]) - data.qpos[body.qpos : body.qpos + 3]
                data.qvel[body.dof : body.dof + 3] = way / passed_s
            data.qpos[body.qpos : body.qpos + 7] = pose
        for slope, hinge in zip(physics.slopes, poses.hinges, strict=True):
            data.qpos[slope.hinge.qpos] = hinge
        for car, now in zip(physics.cars, measured.cars, strict=True):
            data.qpos[car.board.qpos] = now.board_m
        data.time = poses.time_s
        physics.capped_steps = poses.capped_steps
