"""Worlds of robots on a network, where a command would simulate one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

from craftsim.checking.judge import Judge
from craftsim.checking.setup import Seed, SetUp, Setup, judge_on
from craftsim.discrete.grid import Cell, Grid
from craftsim.discrete.kinds import Action
from craftsim.models.sensing import NOISY
from craftsim.models.world import PhysicsWorld
from craftsim.robots import need_network


@contextmanager
def robots_at(address: str, timeout_s: float) -> Iterator[SetUp]:
    """Yield what sets up a world by connecting to the robots in it; let go of them at the end.

    Args:
        address: of the robots.
        timeout_s: without a message from them for so long they count as lost.

    Raises InputError where what it takes is not installed; and so does what is yielded, where no robots answer.
    """
    need_network()
    _compile()
    from craftsim.robots.connecting import Connection

    with ExitStack() as open_links:

        def connect(grid: Grid, setup: Setup, seed: Seed, goals: Sequence[Cell]) -> Judge:
            connection = Connection(address, grid, setup.machines, setup.simulation, goals, timeout_s)
            open_links.enter_context(connection)
            # Contacts are not seen from outside.
            return judge_on(connection.physics, setup, watch_contacts=False, fleet=connection.link)

        yield connect


def _compile() -> None:
    """Let what is compiled at its first use be compiled now: robots do not wait for it."""
    judge = judge_on(PhysicsWorld(Grid.empty((2, 1, 1), n_cars=1)), Setup(assumed=NOISY))
    judge.executor.paths()
    judge.perform(0, Action.MOVE_RIGHT)
