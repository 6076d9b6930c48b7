"""Playing a trajectory back: its positions, sample by sample, in data that no simulation uses."""

from __future__ import annotations

import mujoco

from craftsim.rendering.trajectory import Trajectory


class Playback:
    """Data of a model whose ``qpos`` are those of a trajectory, to be drawn or measured, never stepped."""

    def __init__(self, model: mujoco.MjModel, trajectory: Trajectory) -> None:
        """Prepare for a model: of the trajectory or of its stage."""
        self._model, self._trajectory = model, trajectory
        self._data = mujoco.MjData(model)

    def at(self, sample: int) -> mujoco.MjData:
        """Return the data with everything where it was in a sample; the next call overwrites it."""
        self._data.time = self._trajectory.time[sample]
        self._data.qpos[:] = self._trajectory.qpos[sample]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        return self._data
