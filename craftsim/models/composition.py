"""Composing a world from a Grid: every part attached to the ground at its start pose, goal markers, cameras."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M, cell_position
from craftsim.discrete.grid import Cell
from craftsim.models.config import SimulationConfig
from craftsim.models.parameters import NOMINAL, Machines
from craftsim.models.parts import shared_part
from craftsim.models.placement import Placement

_MARGIN_CELLS = 2
"""Width of bare floor around the area; whole cells, so that the floor's lines are the cells' borders."""
_FIELD_OF_VIEW_DEG = 38.0


def compose(
    spec: mujoco.MjSpec,
    size: Cell,
    placed: list[Placement],
    config: SimulationConfig,
    goals: Sequence[Cell],
    machines: Machines = NOMINAL,
) -> tuple[mujoco.MjSpec, dict[str, list[str]]]:
    """Attach every part to the spec of the ground; return it and the name prefixes by kind of part."""
    spec.copy_during_attach = True
    names: dict[str, list[str]] = {"smartcar": [], "block": [], "flag": [], "slope": [], "wall": []}
    for item in placed:
        index = len(names[item.kind])
        prefix = f"{'car' if item.kind == 'smartcar' else item.kind}{index}/"
        names[item.kind].append(prefix)
        part = shared_part(item.kind, machines, index if item.kind == "smartcar" else 0)
        spec.assets.update(part.assets)
        frame = spec.worldbody.add_frame(pos=item.position, quat=item.quaternion)
        frame.attach_body(part.body(item.kind), prefix, "")
    for i, goal in enumerate(goals):
        spec.worldbody.add_site(
            name=f"goal{i}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=goal_position(goal),
            size=[0.45 * CELL_PITCH_M, 0.45 * CELL_PITCH_M, 0.001],
            rgba=[0.25, 0.75, 0.40, 0.45],
        )
    for name, (position, quaternion) in camera_poses(size).items():
        spec.worldbody.add_camera(name=name, pos=position, quat=quaternion, fovy=_FIELD_OF_VIEW_DEG)
    _configure(spec, size, config)
    return spec, names


def _configure(spec: mujoco.MjSpec, size: Cell, config: SimulationConfig) -> None:
    spec.modelname = "site"
    spec.option.timestep = config.timestep_s
    spec.option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{config.solver.upper()}")
    spec.option.iterations = config.solver_iterations
    spec.option.impratio = config.friction_impedance_ratio
    spec.option.sleep_tolerance = config.sleep_tolerance_m_s
    if config.sleep:
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    ground = spec.geom("ground")
    ground.pos, ground.size = ground_pose_and_size(size)


def goal_position(goal: Cell) -> NDArray[np.float64]:
    """Return (3,), in metres: the centre of a goal's marker."""
    return cell_position(*goal) + np.array([0, 0, 0.002])


def ground_pose_and_size(size: Cell) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return position and half-lengths, (3,) each, in metres, of the floor of an area of this size in cells."""
    length, width, _ = size
    half = [
        (0.5 * length + _MARGIN_CELLS) * CELL_PITCH_M,
        (0.5 * width + _MARGIN_CELLS) * CELL_PITCH_M,
        0.05,
    ]
    return np.array([0.5 * length * CELL_PITCH_M, 0.5 * width * CELL_PITCH_M, 0.0]), np.array(half)


@lru_cache(maxsize=64)
def camera_poses(size: Cell) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return position (3,), in metres, and quaternion (4,) of each camera by its name.

    They are ``overview`` (from the front right, above) and ``top``, both with the whole area in view.
    """
    length, width, height = size
    centre = 0.5 * CELL_PITCH_M * np.array([length, width, 0.0])
    centre[2] = 0.5 * LEVEL_HEIGHT_M * min(height, 2)
    span = CELL_PITCH_M * math.hypot(length, width)
    distance = 0.42 * span / math.tan(math.radians(_FIELD_OF_VIEW_DEG) / 2)
    towards = np.array([0.55, -0.62, 0.56])
    towards /= np.linalg.norm(towards)
    views = {"overview": centre + distance * towards, "top": centre + np.array([0.0, -1e-3, 1.15 * distance])}
    return {name: (position, _looking_at(centre, position)) for name, position in views.items()}


def _looking_at(target: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quaternion of a camera at ``position`` that looks at ``target`` with the horizon level."""
    backward = (position - target) / np.linalg.norm(position - target)
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    axes = np.column_stack([right, np.cross(backward, right), backward])
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    return quaternion
