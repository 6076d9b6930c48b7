"""Measure what it costs to have joint steps done, and trials, by processes of this machine and by actors of Ray."""

from __future__ import annotations

import logging
import os
import resource
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np

from craftsim.commands.bench_campaign import of_nothing
from craftsim.discrete.kinds import Action
from craftsim.envs.central import CentralConstruction
from craftsim.envs.physics_vector import EngineName, PhysicsVectorEnv
from craftsim.envs.ray_connection import initialise

_TURNS: Final = 5
_CALLS: Final = 100
"""In a turn."""
_FEW, _MANY = 50, 350
"""Trials of campaigns, the second beyond the first."""


@dataclass(frozen=True)
class HandingOver:
    """What work costs more in another process than in this one, the best turn of either, in microseconds."""

    joint_step_cpu_us: float
    """CPU time of a joint step, of all processes together: those that ask, work, and belong to Ray."""
    joint_step_wall_us: float
    """How much later its answer is there."""
    trial_cpu_us: float
    """CPU time of a campaign for each trial, of all processes together."""


def hand_over(task: str) -> dict[str, HandingOver]:
    """Return what handing over costs, by engine: to local processes and, where Ray is installed, to its actors.

    Ray's is a cluster of this machine alone, which is started for it and ended.
    """
    found = {"local": _hand_over(task, "local")}
    if find_spec("ray") is not None:
        with _local_cluster():
            found["ray"] = _hand_over(task, "ray")
    return found


def _hand_over(task: str, engine: EngineName) -> HandingOver:
    here = CentralConstruction(task)
    here.reset(seed=0)
    still = np.full(here.core.n_cars, Action.STOP)

    def step_here() -> None:
        _, _, terminated, truncated, _ = here.step(still)
        if terminated or truncated:
            here.reset()

    with closing(here), closing(PhysicsVectorEnv(task, workers=1, engine=engine)) as envs:
        envs.reset(seed=0)

        def step_there() -> None:
            envs.step(still[None])

        turns = [(*_time(step_there), *_time(step_here)) for _ in range(_TURNS)]
    there_cpu_us, there_wall_us, here_cpu_us, here_wall_us = np.array(turns).min(axis=0).tolist()
    seconds = [of_nothing(n, engine, family_cpu_s) for n in (_FEW, _FEW + _MANY)]
    return HandingOver(
        there_cpu_us - here_cpu_us, there_wall_us - here_wall_us, 1e6 * (seconds[1] - seconds[0]) / _MANY
    )


def _time(step: Callable[[], None]) -> tuple[float, float]:
    """Return the CPU time of all processes, and the wall time, of a call, in microseconds."""
    begun, cpu_s = time.perf_counter(), family_cpu_s()
    for _ in range(_CALLS):
        step()
    wall_s = time.perf_counter() - begun
    return 1e6 * (family_cpu_s() - cpu_s) / _CALLS, 1e6 * wall_s / _CALLS


def family_cpu_s() -> float:
    """Return the CPU seconds of this process, of those that it has started, of those that these have, and so on.

    What has ended counts where somebody has waited for it.
    """
    parents: dict[int, int] = {}
    seconds: dict[int, float] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended meanwhile
            fields = path.read_text().rpartition(")")[2].split()
            pid = int(path.parent.name)
            parents[pid] = int(fields[1])
            seconds[pid] = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    total, family = time.process_time() + ended.ru_utime + ended.ru_stime, {os.getpid()}
    while young := {pid for pid, parent in parents.items() if parent in family} - family:
        total += sum(seconds[pid] for pid in young)
        family |= young
    return total


@contextmanager
def _local_cluster() -> Iterator[None]:
    """Have a Ray cluster of one processor on this machine, whichever others there are."""
    import ray

    kept = {name: os.environ.get(name) for name in ("RAY_ADDRESS", "RAY_USAGE_STATS_ENABLED")}
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    try:
        initialise(ray, "local", num_cpus=1, include_dashboard=False, logging_level=logging.ERROR)
        os.environ["RAY_ADDRESS"] = ray.get_runtime_context().gcs_address
        yield
    finally:
        ray.shutdown()
        for name, value in kept.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value
