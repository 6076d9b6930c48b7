"""Positions to be drawn or measured, in data that no simulation uses."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.models.world import PhysicsWorld


class Posed:
    """Data of a model with everything where one wants it, never stepped."""

    def __init__(self, model: mujoco.MjModel) -> None:
        """Prepare for a model."""
        self.model, self._data = model, mujoco.MjData(model)

    def at(self, qpos: NDArray[np.float64], time_s: float = 0.0) -> mujoco.MjData:
        """Return the data with everything where MuJoCo's positions ``qpos`` (nq,) say; the next call overwrites it."""
        self._data.time = time_s
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_camlight(self.model, self._data)
        return self._data


class SeenWorld(Posed):
    """A world as it is seen: its world with what is only seen, its cameras and markers, in a model of its own."""

    def __init__(self, physics: PhysicsWorld) -> None:
        """Build the world of a PhysicsWorld again."""
        super().__init__(physics.seen_model())
        self._physics = physics
        names = [physics.model.geom(geom).name for geom in range(physics.model.ngeom)]
        self._geoms = np.array([self.model.geom(name).id for name in names], np.intp)
        """By geom of the physics, which has fewer: its number here."""

    def at(self, qpos: NDArray[np.float64], time_s: float = 0.0) -> mujoco.MjData:
        """Return the data with everything where ``qpos`` (nq,) say, and as drawn; the next call overwrites it."""
        for name in ("body_pos", "body_quat", "hfield_data"):
            getattr(self.model, name)[:] = getattr(self._physics.model, name)
        for name in ("geom_pos", "geom_quat", "geom_size"):
            getattr(self.model, name)[self._geoms] = getattr(self._physics.model, name)
        return super().at(qpos, time_s)

    def now(self) -> mujoco.MjData:
        """Return the data with everything where it is in the PhysicsWorld; the next call overwrites it."""
        return self.at(self._physics.data.qpos.copy())
