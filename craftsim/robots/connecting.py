"""Connecting to robots on a network, and to the referee who sees them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.grid import Cell, Grid
from craftsim.errors import InputError
from craftsim.mjcf.parameters import Machines
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld
from craftsim.robots.link import TIMEOUT_S, Link
from craftsim.robots.mirror import Mirror
from craftsim.robots.sockets import Caller
from craftsim.robots.surroundings import Surroundings


def world_digest(grid: Grid) -> str:
    """Return the SHA-256 of a world, by which robots and who drives them know that they mean the same."""
    return hashlib.sha256(blueprint_text(grid).encode()).hexdigest()


class Connection:
    """A link to robots in a world, and a mirror that shows it."""

    def __init__(
        self,
        address: str,
        grid: Grid,
        machines: Machines,
        config: SimulationConfig | None = None,
        goals: Sequence[Cell] = (),
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        """Connect to robots at ``HOST:PORT`` or ``tcp://HOST:PORT``, and look at their world.

        Args:
            address: of the robots.
            grid: the world in which they should stand.
            machines: the figures of them and of what they handle.
            config: of the PhysicsWorld that shows them.
            goals: cells to mark on it.
            timeout_s: without a message for so long they count as lost.

        Raises InputError where they do not answer or refuse, or where no referee shows their world.
        """
        self._callers = [Caller(address)]
        try:
            digest = world_digest(grid)
            self.physics = PhysicsWorld(grid, config, goals, reset=False, machines=machines)
            n_slopes, period_s = len(self.physics.slopes), self.physics.config.control_period_s
            self.link = Link(
                self._callers[0], grid.n_cars, machines, digest, timeout_s, Surroundings(grid.size)
            )
            welcome = self.link.welcome
            if welcome.slopes != n_slopes:
                raise InputError(f"the robots know of {welcome.slopes} slopes, and there are {n_slopes}")
            if abs(welcome.period_s - period_s) > 1e-9:
                raise InputError(
                    f"the robots' control period is {welcome.period_s:g} s, and that of the skills {period_s:g} s"
                )
            if not self.link.welcome.referee:
                raise InputError(f"nobody shows the world of the robots at {address}: there is no referee")
            self._callers.append(Caller(address))
            self.link.let_follow(Mirror(self.physics, self._callers[1], welcome.ticket))
        except BaseException:
            self.__exit__(None, None, None)
            raise

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
