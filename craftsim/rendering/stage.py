"""The model that pictures of a trajectory are taken of."""

from __future__ import annotations

from typing import Literal

import mujoco

from craftsim.rendering.trajectory import Trajectory

Quality = Literal["draft", "paper"]


def stage(trajectory: Trajectory, quality: Quality, size: tuple[int, int]) -> mujoco.MjModel:
    """Return the model of a trajectory's pictures."""
    return trajectory.model
