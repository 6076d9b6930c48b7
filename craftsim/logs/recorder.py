"""Recording commands and measurements of cars while they run."""

from __future__ import annotations

from typing import Final

import numpy as np

from craftsim.logs.log import Log
from craftsim.models.measuring import READING
from craftsim.models.world import PhysicsWorld
from craftsim.skills.executor import Executor
from craftsim.skills.state import COMMAND

MOST_ROWS: Final = 250_000
"""Maximum number of rows of all cars together, as readers accept them; later rows are left out."""


class LogRecorder:
    """Records the measurements and commands of all cars in every control period."""

    def __init__(self, executor: Executor) -> None:
        """Start recording the cars of an executor."""
        self._executor = executor
        self._readings = [executor.fleet.read().tobytes()]
        self._commands: list[bytes] = []
        self._time = [executor.physics.time_s]
        self._most = MOST_ROWS // max(1, len(executor.physics.cars))
        executor.observers.append(self._look)

    def _look(self, physics: PhysicsWorld) -> None:
        # A simulation that breaks down starts its time over: what it does then is no part of the run.
        if not self._time[-1] < physics.time_s or len(self._time) >= self._most:
            return
        self._commands.append(self._executor.commands.tobytes())
        self._readings.append(self._executor.fleet.read().tobytes())
        self._time.append(physics.time_s)

    def logs(self) -> dict[int, Log]:
        """Return the log of each car; empty if fewer than two control periods have passed."""
        n = len(self._commands)
        if n < 2:
            return {}
        read = np.frombuffer(b"".join(self._readings[:n]), READING).reshape(n, -1)
        told = np.frombuffer(b"".join(self._commands), COMMAND).reshape(n, -1)
        time = np.array(self._time[:n])
        return {car: log_of(time, read[:, car], told[:, car]) for car in range(read.shape[1])}


def log_of(time_s: np.ndarray, readings: np.ndarray, commands: np.ndarray) -> Log:
    """Return the log of one car: times, records of READING and of COMMAND, each (n,)."""
    docked = readings["slope"] >= 0
    return Log(
        time_s,
        np.column_stack([commands["wheels"], commands["board"], commands["hinge"]]),
        np.column_stack([readings[name] for name in ("x", "y", "heading")]),
        np.column_stack([readings["pitch"], readings["roll"]]),
        readings["wheel_speeds"].copy(),
        np.column_stack([readings["board_m"], readings["board_force_n"]]),
        np.where(docked[:, None], np.column_stack([readings["slope"], readings["hinge_rad"]]), np.nan),
    )
