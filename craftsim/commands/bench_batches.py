"""Measure what many worlds in physics cost: workers, memory."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.tasks import make_task
from craftsim.envs.central import CentralConstruction
from craftsim.envs.physics_vector import PhysicsVectorEnv
from craftsim.errors import CraftsimError
from craftsim.processes import spawn_context

WORLDS: Final = 8
"""That workers share, and that memory is divided by."""
_TICKS: Final = 4
"""Of each world in a turn."""


@dataclass(frozen=True)
class WorkersTiming:
    """The same play in many worlds with one worker process and with two."""

    one_worker: float
    """Joint steps a second of wall time."""
    two_workers: float
    one_worker_cpu_s: float
    """CPU seconds a joint step: of the worker, and of the process that chooses the actions."""
    two_workers_cpu_s: float
    """The same of the busier of the two workers, while the other one works beside it."""
    load: float
    """How many processes wanted a processor in the last minute, those measured included."""
    processors: int

    @property
    def ratio(self) -> float:
        """How many times as many joint steps two workers do, on a machine as busy as this one."""
        return self.two_workers / self.one_worker

    @property
    def free_ratio(self) -> float:
        """How many times as many they would do each on a processor of its own, by CPU times.

        As if no worker did anything while actions are chosen and handed over.
        """
        return self.one_worker_cpu_s / self.two_workers_cpu_s


def time_workers(task: str, options: Mapping[str, Any], seconds: float, seed: int) -> WorkersTiming:
    """Play the same with one worker and with two, in turns for so many seconds each; the best turn of either counts.

    Raises CraftsimError where their results differ.
    """
    with (
        closing(PhysicsVectorEnv(task, WORLDS, workers=1, **options)) as one,
        closing(PhysicsVectorEnv(task, WORLDS, workers=2, **options)) as two,
    ):
        walls: dict[int, list[float]] = {1: [], 2: []}
        cpus: dict[int, list[float]] = {1: [], 2: []}
        end = time.perf_counter() + 2 * seconds
        while time.perf_counter() < end or not walls[2]:
            for envs in (one, two):
                wall_s, cpu_s = _play(envs, seed)
                walls[envs.workers].append(wall_s)
                cpus[envs.workers].append(cpu_s)
            if not np.array_equal(one.car_vectors(), two.car_vectors()):
                raise CraftsimError("two workers gave other results than one")
    return WorkersTiming(
        one_worker=1 / min(walls[1]),
        two_workers=1 / min(walls[2]),
        one_worker_cpu_s=min(cpus[1]),
        two_workers_cpu_s=min(cpus[2]),
        load=os.getloadavg()[0],
        processors=len(os.sched_getaffinity(0)),
    )


def _play(envs: PhysicsVectorEnv, seed: int) -> tuple[float, float]:
    """Play some ticks of each world at its own pace; return wall and CPU seconds a joint step.

    The latter are those of this process and of the busiest worker.
    """
    rngs = [np.random.default_rng([seed, world]) for world in range(envs.num_envs)]

    def act(ids: NDArray[np.int64], masks: NDArray[np.int8]) -> None:
        picked = [
            (rngs[world].random(mask.shape) * mask).argmax(-1) for world, mask in zip(ids, masks, strict=True)
        ]
        envs.send(np.array(picked), ids)

    masks = envs.reset(seed=seed)[0]["action_mask"]
    left = np.full(envs.num_envs, _TICKS)
    begun, cpu_s = time.perf_counter(), np.array(_cpu_s(envs))
    act(np.arange(envs.num_envs), masks)
    while left.any():
        observation, *_, infos = envs.recv()
        ids = infos["env_id"]
        left[ids] -= 1
        if (goes_on := left[ids] > 0).any():
            act(ids[goes_on], observation["action_mask"][goes_on])
    n = _TICKS * envs.num_envs
    wall_s = time.perf_counter() - begun
    own_s, *workers_s = np.array(_cpu_s(envs)) - cpu_s
    return wall_s / n, float(own_s + max(workers_s)) / n


def _cpu_s(envs: PhysicsVectorEnv) -> list[float]:
    """Return the CPU seconds of this process and of each worker so far."""
    seconds = [time.process_time()]
    for pid in envs.pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        seconds.append((int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"))
    return seconds


def mib_a_world(task: str, options: Mapping[str, Any]) -> float:
    """Return what each world beyond the first adds to the memory of a process that plays it, in MiB."""
    with ProcessPoolExecutor(1, spawn_context()) as process:
        return process.submit(_grown_mib, task, dict(options), WORLDS).result() / WORLDS


def _grown_mib(task: str, options: dict[str, Any], n_worlds: int) -> float:
    """Return by how much the memory of this process grows for so many worlds after a first one."""
    short = make_task(task, max_steps=0)
    rng = np.random.default_rng(0)
    envs, before = [], 0.0
    for number in range(1 + n_worlds):
        env = CentralConstruction(short, **options)
        masks = env.reset(seed=number)[0]["action_mask"]
        env.step((rng.random(masks.shape) * masks).argmax(-1))
        envs.append(env)
        if number == 0:
            before = _resident_mib()
    return _resident_mib() - before


def _resident_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
