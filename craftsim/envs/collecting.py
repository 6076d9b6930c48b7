"""Collecting worlds that real skills reach, to be the starts of later training."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from craftsim.discrete.grid import Grid
from craftsim.envs.parallel import ParallelConstruction


def reached_worlds(
    env: ParallelConstruction,
    act: Callable[[dict[str, dict[str, NDArray[Any]]]], dict[str, int]],
    ticks: int,
    seed: int | None = None,
) -> list[Grid]:
    """Return the distinct worlds that an environment comes by, in the order in which it first does.

    Ends of episodes and what cannot be read as a grid are left out. :func:`craftsim.discrete.tasks.starts.save_starts`
    keeps the worlds in a file.

    Args:
        env: on physics, with noise and a randomization, it reaches what skills make of it there.
        act: the policy, from the observations by agent to the actions by agent.
        ticks: how many ticks to play, over as many episodes as that takes.
        seed: seed of the environment.
    """
    found: dict[bytes, Grid] = {}
    observations, _ = env.reset(seed=seed)
    for _ in range(ticks):
        observations = env.step(act(observations))[0]
        if env.agents:
            grid = env.grid
            found.setdefault(grid.kind.tobytes() + grid.yaw.tobytes() + grid.cars.tobytes(), grid)
        else:
            observations, _ = env.reset()
    return list(found.values())
