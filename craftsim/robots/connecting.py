"""Connecting to robots, and to the referee who shows where everything truly is."""

from __future__ import annotations

import hashlib
import time
from collections import deque
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Final, Self

import numpy as np

from craftsim.checking.judge import Judge
from craftsim.checking.setup import Setup, judge_on
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Cell, Grid
from craftsim.errors import InputError
from craftsim.mjcf.parameters import Machines
from craftsim.models.config import SimulationConfig
from craftsim.models.parts import Joint
from craftsim.models.world import PhysicsWorld
from craftsim.robots.link import EPSILON_S, TIMEOUT_S, Link, Messenger, inside
from craftsim.robots.messages import Follow, Measurements, MessageError, TruePoses, pack, unpack

_KEPT: Final = 64
"""TruePoses that are kept: those of a measurement are there before it has come."""
_AHEAD_S: Final = 12.0
"""By how much what a referee shows may be younger than what was measured: by as much as a network can delay that."""


def world_digest(grid: Grid) -> str:
    """Return the SHA-256 of a world, by which robots and who drives them know that they mean the same."""
    return hashlib.sha256(blueprint_text(grid).encode()).hexdigest()


class Mirror:
    """Shows where everything truly is, at the time of what was measured last, for a judge to look at.

    Wheels stand still; boards stand where they were measured; velocities are what changed since what was shown before.
    """

    def __init__(self, physics: PhysicsWorld, referee: Messenger, ticket: str = "") -> None:
        """Show on a world, which is never stepped, what a referee publishes; ``ticket`` is that of the driver."""
        self.physics, self._referee = physics, referee
        referee.send(pack(Follow(ticket)))
        self._seen: deque[TruePoses] = deque(maxlen=_KEPT)
        handles = [*(car.base for car in physics.cars), *physics.tables]
        self._bodies: tuple[Joint, ...] = (*handles, *(slope.base for slope in physics.slopes))

    def follow(self, measured: Measurements, timeout_s: float) -> str:
        """Show how things stood when that was measured; return why it was not seen in time, or nothing."""
        deadline, why = time.monotonic() + timeout_s, ""
        while not self._seen or self._seen[-1].time_s < measured.time_s - EPSILON_S:
            left_s = deadline - time.monotonic()
            try:
                data = self._referee.receive(left_s) if left_s > 0 else None
            except ConnectionError as error:
                return f"the referee is gone: {error}"
            if data is None:
                return f"the referee has shown nothing of use for {timeout_s:g} s{why}"
            try:
                self._take(data)
            except MessageError as error:
                why = f" (dropped: {error})"
        shown = next(poses for poses in self._seen if poses.time_s >= measured.time_s - EPSILON_S)
        if shown.time_s > measured.time_s + _AHEAD_S:
            return (
                f"the referee's clock shows {shown.time_s:g} s where the robots measure {measured.time_s:g} s"
            )
        self._show(shown, measured)
        return ""

    def _take(self, data: bytes) -> None:
        """Take poses that are newer; raise MessageError for what cannot be of this world."""
        poses = unpack(data)
        if not isinstance(poses, TruePoses):
            raise MessageError(poses.kind)
        n_cars, n_slopes = len(self.physics.cars), len(self.physics.slopes)
        came = len(poses.cars), len(poses.things), len(poses.hinges)
        there = n_cars, len(self._bodies) - n_cars, n_slopes
        if came != there:
            cars, things, hinges = came
            raise MessageError(
                f"{cars} cars, {things} things and {hinges} hinges; there are {', '.join(map(str, there[:2]))} "
                f"and {n_slopes}"
            )
        if not all(inside(self.physics.size, *pose[:3]) for pose in (*poses.cars, *poses.things)):
            raise MessageError("poses outside the world")
        if not self._seen or poses.time_s > self._seen[-1].time_s + EPSILON_S:
            self._seen.append(poses)

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


class Connection:
    """A link to robots in a world, and a mirror that shows it."""

    def __init__(
        self,
        call: Callable[[], Messenger],
        grid: Grid,
        machines: Machines,
        config: SimulationConfig | None = None,
        goals: Sequence[Cell] = (),
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        """Connect to robots, and look at their world.

        Args:
            call: connects to them once more.
            grid: the world in which they should stand.
            machines: the parameters of them and of what they handle.
            config: of the PhysicsWorld that shows them.
            goals: cells to mark on it.
            timeout_s: without a message for so long they count as lost.

        Raises InputError where they do not answer or refuse, or where no referee shows their world.
        """
        self._callers = [call()]
        try:
            self.physics = PhysicsWorld(grid, config, goals, reset=False, machines=machines)
            n_slopes, period_s = len(self.physics.slopes), self.physics.config.control_period_s
            self.link = Link(
                self._callers[0], grid.n_cars, machines, world_digest(grid), timeout_s, grid.size
            )
            welcome = self.link.welcome
            if welcome.slopes != n_slopes:
                raise InputError(f"the robots know of {welcome.slopes} slopes, and there are {n_slopes}")
            if abs(welcome.period_s - period_s) > 1e-9:
                raise InputError(
                    f"the robots' control period is {welcome.period_s:g} s, and that of the skills {period_s:g} s"
                )
            if not welcome.referee:
                raise InputError("nobody shows the world of these robots: there is no referee")
            self._callers.append(call())
            self.link.let_follow(Mirror(self.physics, self._callers[1], welcome.ticket).follow)
        except BaseException:
            self.__exit__(None, None, None)
            raise

    def judge(self, setup: Setup) -> Judge:
        """Return the judge of what the robots do; contacts are not seen from outside."""
        return judge_on(self.physics, setup, watch_contacts=False, fleet=self.link)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let go of the robots, and close."""
        if hasattr(self, "link"):
            self.link.close()
        for caller in self._callers:
            caller.close()
