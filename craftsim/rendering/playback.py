"""Positions to be drawn or measured, in data that no simulation uses: of a trajectory, sample by sample, or any."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.rendering.trajectory import Trajectory


class Posed:
    """Data of a model with everything where one wants it, never stepped."""

    def __init__(self, model: mujoco.MjModel) -> None:
        """Prepare for a model."""
        self._model, self._data = model, mujoco.MjData(model)

    def at(self, qpos: NDArray[np.float64], time_s: float = 0.0) -> mujoco.MjData:
        """Return the data with everything where MuJoCo's positions ``qpos`` (nq,) say; the next call overwrites it."""
        self._data.time = time_s
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        return self._data


class Playback:
    """Data of a model whose ``qpos`` are those of a trajectory."""

    def __init__(self, model: mujoco.MjModel, trajectory: Trajectory) -> None:
        """Prepare for a model: of the trajectory or of its stage."""
        self._posed, self._trajectory = Posed(model), trajectory

    def at(self, sample: int) -> mujoco.MjData:
        """Return the data with everything where it was in a sample; the next call overwrites it."""
        return self._posed.at(self._trajectory.qpos[sample], self._trajectory.time[sample])
