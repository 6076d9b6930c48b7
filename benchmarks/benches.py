"""What benchmarks share: a clock over processes, worlds that grow, and MuJoCo's steps without craftsim."""

from __future__ import annotations

import math
import os
import resource
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.envs.options import Options
from craftsim.envs.parallel import ParallelConstruction
from craftsim.models.world import PhysicsWorld
from craftsim.tasks import Task, free_play


def cpu_s() -> float:
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


def yard(n_cars: int, n_blocks: int) -> Task:
    """Return a task of two ticks on 64 cells' width: cars in every second cell of one edge, rows of blocks beyond."""
    n_rows = max(1, math.ceil(n_blocks / 64))
    grid = Grid.empty((4 + 2 * n_rows, 64, 3), n_cars)
    for car in range(n_cars):
        grid.cars[car, :4] = 0, 2 * car, 1, 0
    for block in range(n_blocks):
        grid.kind[3 + 2 * (block // 64), block % 64, 1] = Kind.BLOCK
    grid.derive_marks()
    name = f"yard_{n_cars}_{n_blocks}"
    return free_play(name, (parse_blueprint(blueprint_text(grid), name),), max_steps=0)


class ToAndFro:
    """Episodes in which all cars drive a cell to and back, in physics; each period's commands are kept for a replay."""

    def __init__(self, task: Task, **options: object) -> None:
        """Play one episode, and keep what was commanded."""
        self.env = ParallelConstruction(task, Options(**options))  # type: ignore[arg-type]
        self.env.reset(seed=0)
        self.periods: list[_Period] = []
        self.env.core.backend.judge.executor.observers.append(  # type: ignore[attr-defined]
            lambda physics: self.periods.append(_Period.of(physics))
        )
        self.play()
        self.end = self.physics.data.qpos.copy()
        self.env.reset(seed=0)
        for period in self.periods:
            period.replay(self.physics)

    @property
    def physics(self) -> PhysicsWorld:
        """The world of the episode."""
        world: PhysicsWorld = self.env.core.backend.judge.physics  # type: ignore[attr-defined]
        return world

    def reset(self) -> None:
        """Begin again from the same start."""
        self.env.reset(seed=0)

    def play(self) -> None:
        """Play an episode that has begun: two joint steps."""
        for action in (Action.MOVE_RIGHT, Action.MOVE_LEFT):
            self.env.step(dict.fromkeys(self.env.agents, int(action)))

    def replay(self) -> None:
        """Let MuJoCo alone do the steps of an episode that has begun, under the commands that were kept.

        Raises RuntimeError where that ends in another state.
        """
        for period in self.periods:
            period.replay(self.physics)
        if not np.array_equal(self.physics.data.qpos, self.end):
            raise RuntimeError("the replay of the commands does not end where the environment did")


@dataclass
class _Period:
    """What stood when a control period ran."""

    ctrl: NDArray[np.float64]
    policies: NDArray[np.int32]

    @classmethod
    def of(cls, physics: PhysicsWorld) -> _Period:
        """Return what stood in the period that has just run."""
        return cls(physics.data.ctrl.copy(), physics.model.tree_sleep_policy.copy())

    def replay(self, physics: PhysicsWorld) -> None:
        """Let MuJoCo do the steps of the period again."""
        model, data = physics.model, physics.data
        data.ctrl[:] = self.ctrl
        model.tree_sleep_policy[:] = self.policies
        physics.run(physics.config.steps_per_period)
