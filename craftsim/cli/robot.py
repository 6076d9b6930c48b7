"""Robots on a network: ``craftsim robot serve``."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from craftsim.cli.text import print_error, print_safe, warn_if_exposed
from craftsim.errors import InputError
from craftsim.options import Dir, Physics, number
from craftsim.robots import LOOPBACK, PORT, need_network
from craftsim.storage.folders import owning
from craftsim.storage.limits import DELAY_MS, PACE, PATIENCE_S, PORTS, SHARE


@owning
def serve(
    task: str = "simple_two_story",
    *,
    host: Annotated[str, Parameter(metavar="ADDRESS")] = LOOPBACK,
    port: Annotated[int, number(PORTS)] = PORT,
    delay_ms: Annotated[float, number(DELAY_MS, "MS")] = 0.0,
    jitter_ms: Annotated[float, number(DELAY_MS, "MS")] = 0.0,
    loss: Annotated[float, number(SHARE)] = 0.0,
    silent: Annotated[tuple[str, ...], Parameter(metavar="CAR:SECONDS")] = (),
    pace: Annotated[float, number(PACE)] = 1.0,
    lockstep: bool = False,
    timeout: Annotated[float, number(PATIENCE_S, "SECONDS")] = 60.0,
    once: bool = False,
    physics: Physics = Physics(),  # noqa: B008
    out: Dir = Path("out/robot"),
) -> int:
    """Simulate robots in the world of a task, and serve them on a network: 'craftsim demo --robot ADDRESS' drives them.

    Prints the address, and serves them until Ctrl-C. Exit status: 0, or 2 for invalid input.

    Args:
        task: world of the robots: the name of a task, a start or task file, or 'module:factory'.
        host: address to listen on; the default is reachable from this machine only. There is no password.
        port: port; 0 takes a free one.
        delay_ms: network delay of a message in each direction; drawn from the seed, as jitter and loss.
        jitter_ms: half-width of the uniform distribution of the delay.
        loss: share of lost messages.
        silent: a car that stops and does not answer any more after so many seconds of its clock, such as 1:5; may be
            repeated.
        pace: seconds of the robots' time per second.
        lockstep: stop the robots' time until each measurement has been answered, so that a seed gives the same run on
            any machine.
        timeout: time limit of an answer in lock-step, after which time goes on without it.
        once: exit when the client disconnects.
        out: folder for report.json.
    """
    need_network()
    import numpy as np

    from craftsim.checking.setup import Seed, set_up
    from craftsim.discrete.tasks import as_task
    from craftsim.reports.json_file import write_report
    from craftsim.robots.link import world_digest
    from craftsim.robots.server import Network, Server, Service
    from craftsim.robots.simulated import simulated_robots
    from craftsim.robots.sockets import Host
    from craftsim.skills.fleet import PhysicsFleet

    network = Network(delay_ms / 1e3, jitter_ms / 1e3, loss, tuple(map(_silent, silent)))
    setup = physics.setup()
    found = as_task(task)
    seeds = np.random.SeedSequence(physics.seed).spawn(4)
    grid = found.draw(np.random.default_rng(seeds[0]))
    started = time.perf_counter()
    with contextlib.closing(Host(host, port)) as sockets:
        world = set_up(grid, setup, Seed.of(seeds[1]), watch_contacts=False).executor.fleet
        assert isinstance(world, PhysicsFleet)
        rngs = np.random.default_rng(seeds[2]), np.random.default_rng(seeds[3])
        robots = simulated_robots(world, network.silent)
        service = Service(
            robots, world, sockets.send, network, rngs, world_digest(grid), lockstep, print_error
        )
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


def _silent(text: str) -> tuple[int, float]:
    car, _, seconds = text.partition(":")
    try:
        return int(car), float(seconds)
    except ValueError:
        raise InputError(
            f"--silent {text}: allowed: a car and seconds, such as 1:5 for car 1 after 5 s"
        ) from None
