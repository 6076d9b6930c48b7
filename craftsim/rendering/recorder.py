"""Recording a run as a trajectory while it goes on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.checking.attempt import Attempt
from craftsim.checking.episode import Recipe
from craftsim.checking.judge import Judge
from craftsim.discrete.files.design import Design
from craftsim.models.measuring import READING
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.trajectory import (
    KINDS,
    SCHEMA_VERSION,
    GoalCell,
    Story,
    Trajectory,
    motors_of,
    poses_of,
)
from craftsim.reports.json_file import versions
from craftsim.storage.limits import TRAJECTORY

_Samples = list[NDArray[np.float64]]

MOST_SAMPLES: Final = 180_000
"""An hour of simulated time at the usual control period; what comes later is left out."""
MOST_BYTES: Final = TRAJECTORY.content_bytes // 2
"""Of all samples together, so that a reader takes them; what comes later is left out."""


class Recorder:
    """Takes a sample of a world after every control period, and makes a trajectory of them."""

    def __init__(self) -> None:
        """Record nothing yet."""
        self._time: list[float] = []
        self._contact: list[float] = []

    def begin(self, judge: Judge) -> None:
        """Record a world from now on; what was recorded before is dropped."""
        self._judge, self._executor, self._log = judge, judge.executor, judge.log
        self._time, self._contact = [], []
        self._qpos: _Samples = []
        self._ctrl: _Samples = []
        self._force: _Samples = []
        self._readings: list[bytes] = []
        self._path: _Samples = []
        data, n_cars = judge.physics.data, len(judge.physics.cars)
        numbers = len(data.qpos) + len(data.ctrl) + 3 * n_cars + 2
        self._most = min(MOST_SAMPLES, MOST_BYTES // (8 * numbers))
        self._look(judge.physics)
        judge.executor.observers.append(self._look)

    def _look(self, physics: PhysicsWorld) -> None:
        data = physics.data
        # A simulation that breaks down starts its time over: what it does then is no part of the run.
        if (self._time and not self._time[-1] < data.time) or len(self._time) == self._most:
            return
        self._time.append(data.time)
        self._qpos.append(data.qpos.copy())
        self._ctrl.append(data.ctrl.copy())
        self._force.append(data.actuator_force.copy())
        self._readings.append(self._executor.readings().tobytes())
        self._path.append(self._executor.paths())
        self._contact.append(np.nan if self._log is None else self._log.period_n)

    def trajectory(
        self, title: str, recipe: Recipe, attempts: Iterable[Attempt], design: Design | None = None
    ) -> Trajectory:
        """Return what was recorded so far.

        Args:
            title: what it is of.
            recipe: what was done, from the world's start.
            attempts: what was tried since the recording began.
            design: the building that is to be put up.
        """
        physics = self._judge.physics
        story = Story(
            SCHEMA_VERSION,
            title,
            versions(),
            recipe,
            tuple(attempts),
            poses_of(physics),
            motors_of(physics),
            () if design is None else tuple(_targets(design)),
        )
        kept = len(self._time)
        readings = np.frombuffer(b"".join(self._readings), READING).reshape(kept, -1)
        return Trajectory(
            story,
            np.array(self._time),
            np.array(self._qpos),
            np.array(self._ctrl, np.float32).reshape(kept, len(story.motors)),
            np.array(self._force, np.float32).reshape(kept, len(story.motors)),
            np.stack([readings[name] for name in ("x", "y", "heading")], axis=2).astype(np.float32),
            np.array(self._path, np.float32),
            np.array(self._contact, np.float32),
        )


def _targets(design: Design) -> Iterator[GoalCell]:
    for target in design.targets:
        yield GoalCell(KINDS[target.kind], target.cell, target.yaw)
