"""Robots: what a machine must offer so that the skills drive it, and how it is reached over a network."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from craftsim.storage.extras import need

if TYPE_CHECKING:
    from craftsim.checking.judge import Judge
    from craftsim.checking.setup import Seed, SetUp, Setup
    from craftsim.discrete.grid import Cell, Grid

ROBOT_HOST: Final = "127.0.0.1"
"""The address that only this machine reaches."""
ROBOT_PORT: Final = 5555
"""Where robots are reached unless another address is given."""


def need_network() -> None:
    """Raise InputError with the command that installs what a network needs, where that is missing."""
    need("robots", "robots on a network need", "msgpack")


@contextmanager
def robots_at(
    address: str, timeout_s: float = 1.0, key: str | Path | None = None
) -> Iterator[SetUp]:
    """Yield what sets up a world by connecting to the robots in it, anew each time; let go of them at the end.

    The address is ``HOST:PORT`` or ``tcp://HOST:PORT``. Robots, or a car, that say nothing for ``timeout_s`` are lost.
    ``key`` is a file that they have, too; without it only this machine's addresses are called.

    Raises InputError for what is no address or no key, and where what it takes is not installed; and so does what is
    yielded, where no robots answer.
    """
    need_network()
    from craftsim.robots.sockets import Caller

    key_file = None
    if key is not None:
        key_file = Path(key)
    # What is no address is said before anything is compiled.
    Caller(address, key_file)
    from craftsim.checking.setup import Setup, judge_on
    from craftsim.discrete.grid import Grid
    from craftsim.discrete.kinds import Action
    from craftsim.models.world import PhysicsWorld
    from craftsim.robots.link import Link, connect

    # What is compiled at its first use is compiled now: robots do not wait for it.
    judge = judge_on(PhysicsWorld(Grid.empty((2, 1, 1), n_cars=1)), Setup())
    judge.executor.paths()
    judge.perform(0, Action.MOVE_RIGHT)
    with ExitStack() as connected:

        def set_up(grid: Grid, setup: Setup, seed: Seed, goals: Sequence[Cell]) -> Judge:
            connected.close()
            judge = connect(Caller(address, key_file), grid, setup, goals, timeout_s)
            link = judge.executor.fleet
            assert isinstance(link, Link)
            connected.callback(link.close)
            return judge

        yield set_up
