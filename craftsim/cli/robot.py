"""Robots on a network: ``craftsim robot serve``, and the worlds of ``demo --robot``."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from craftsim.cli.text import print_error, print_safe, warn_if_exposed
from craftsim.options import Dir, Physics, number
from craftsim.robots import LOOPBACK, PORT, need_network
from craftsim.storage.folders import owning
from craftsim.storage.limits import DELAY_MS, PACE, PATIENCE_S, PORTS, SHARE

if TYPE_CHECKING:
    from craftsim.checking.judge import Judge
    from craftsim.checking.setup import Seed, SetUp, Setup
    from craftsim.discrete.grid import Cell, Grid


@owning
def serve(
    task: str = "simple_two_story",
    *,
    host: Annotated[str, Parameter(metavar="ADDRESS")] = LOOPBACK,
    port: Annotated[int, number(PORTS)] = PORT,
    delay_ms: Annotated[float, number(DELAY_MS, "MS")] = 0.0,
    jitter_ms: Annotated[float, number(DELAY_MS, "MS")] = 0.0,
    loss: Annotated[float, number(SHARE)] = 0.0,
    pace: Annotated[float, number(PACE)] = 1.0,
    lockstep: bool = False,
    timeout: Annotated[float, number(PATIENCE_S, "SECONDS")] = 60.0,
    once: bool = False,
    physics: Physics = Physics(),  # noqa: B008
    out: Dir = Path("out/robot"),
) -> int:
    """Simulate robots in the world of a task, and let who connects drive them: craftsim demo --robot ADDRESS.

    It says at which address they are reached, and serves them until Ctrl-C. Exit status 0 then, and 2 for wrong input.

    Args:
        task: whose start is their world: a shipped task's name, a start or task file, or 'module:factory'.
        host: address to listen on. Only this machine reaches the usual one; there is no password.
        port: 0 takes one that is free.
        delay_ms: how long the network takes for a message, in each direction; drawn from the seed, as the two below.
        jitter_ms: half-width of the uniform distribution around it.
        loss: share of the messages that never come.
        pace: seconds of the robots' time in a second.
        lockstep: let their time stand still until each measurement has been answered: the same seed then gives the
            same run, however slow the machine is.
        timeout: how long they wait for an answer in lock-step, before their time goes on without.
        once: end when who has driven them says goodbye, or has closed the connection.
        out: folder for report.json.
    """
    need_network()
    import numpy as np

    from craftsim.checking.setup import Seed, set_up
    from craftsim.discrete.tasks import as_task
    from craftsim.reports.json_file import write_report
    from craftsim.robots.connecting import world_digest
    from craftsim.robots.server import Network, Server
    from craftsim.robots.simulated import serve_simulated
    from craftsim.robots.sockets import Host
    from craftsim.skills.fleet import PhysicsFleet

    network = Network(delay_ms / 1e3, jitter_ms / 1e3, loss)
    setup = physics.setup()
    found = as_task(task)
    seeds = np.random.SeedSequence(physics.seed).spawn(4)
    grid = found.draw(np.random.default_rng(seeds[0]))
    started = time.perf_counter()
    with Host(host, port) as sockets:
        world = set_up(grid, setup, Seed.of(seeds[1]), watch_contacts=False).executor.fleet
        assert isinstance(world, PhysicsFleet)
        rngs = np.random.default_rng(seeds[2]), np.random.default_rng(seeds[3])
        service = serve_simulated(world, world_digest(grid), sockets, network, rngs, lockstep, print_error)
        server = Server(service, sockets, pace, timeout)
        print_safe(f"{len(service.robots)} robots of {found.name} at {sockets.address} (Ctrl-C ends it)")
        sys.stdout.flush()
        warn_if_exposed(host, "drive these robots")
        with contextlib.suppress(KeyboardInterrupt):
            server.run(lambda: once and service.farewells > 0)
        server.end()
    figures: dict[str, Any] = {
        "simulated_s": round(service.now_s, 6),
        "commands_dropped": service.inbox.dropped,
        "messages_malformed": service.malformed,
        "heard_at_s": service.heard_at_s,
        "stopped_at_s": service.stopped_at_s,
    }
    config: dict[str, Any] = {"setup": setup, "network": network, "pace": pace, "lockstep": lockstep}
    config |= {"task": found.name, "digests": setup.digests}
    wall = {"total_s": time.perf_counter() - started, "behind_s": server.behind_s}
    report = write_report(out, figures, command="robot", seed=physics.seed, config=config, wall=wall)
    print_safe(
        f"{service.now_s:.1f} s of the robots' time, {server.behind_s:.2f} s behind the clock; for want of commands "
        f"they stopped {service.inbox.stops} times."
    )
    print_safe(f"Report: {report}")
    return 0


@contextmanager
def robots_at(address: str, timeout_s: float) -> Iterator[SetUp]:
    """Yield what sets up a world by connecting to the robots in it; let go of them at the end.

    Args:
        address: of the robots.
        timeout_s: without a message from them for so long they count as lost.

    Raises InputError where what it takes is not installed; and so does what is yielded, where no robots answer.
    """
    need_network()
    from craftsim.checking.setup import Setup, judge_on
    from craftsim.discrete.grid import Grid
    from craftsim.discrete.kinds import Action
    from craftsim.models.sensing import NOISY
    from craftsim.models.world import PhysicsWorld
    from craftsim.robots.connecting import Connection

    # What is compiled at its first use is compiled now: robots do not wait for it.
    judge = judge_on(PhysicsWorld(Grid.empty((2, 1, 1), n_cars=1)), Setup(assumed=NOISY))
    judge.executor.paths()
    judge.perform(0, Action.MOVE_RIGHT)
    with ExitStack() as open_links:

        def connect(grid: Grid, setup: Setup, seed: Seed, goals: Sequence[Cell]) -> Judge:
            connection = Connection(address, grid, setup.machines, setup.simulation, goals, timeout_s)
            open_links.enter_context(connection)
            # Contacts are not seen from outside.
            return judge_on(connection.physics, setup, watch_contacts=False, fleet=connection.link)

        yield connect
