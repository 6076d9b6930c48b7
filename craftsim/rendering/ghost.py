"""The goal ghost: what a design still wants, drawn translucent where it is to stand."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import cell_position, yaw_angle
from craftsim.mjcf.block import meshes as block_meshes
from craftsim.mjcf.parameters import Machines
from craftsim.mjcf.slope import meshes as slope_meshes
from craftsim.mjcf.solids import add_mesh
from craftsim.rendering.trajectory import GoalCell, Trajectory

_MESHES: Final = {
    "block": "block",
    "base": "slope_base",
    "flap": "slope_flap",
}
"""The names of the meshes."""
_RGBA: Final = np.array([0.10, 0.62, 0.42, 0.16], np.float32)
_NEAR_M: Final = 0.02
"""What stands nearer than this to its place fills it."""
_NEAR_RAD: Final = 0.15
_HINGE_RAD: Final = {"fslope": math.pi, "body": 0.0}
"""Angle at which the hinge of a slope is wanted."""


def add_ghost_meshes(spec: mujoco.MjSpec, machines: Machines) -> None:
    """Add the meshes of which ghosts are made to a scene."""
    meshes = block_meshes(machines.block) | slope_meshes(machines.slope)
    for name in _MESHES.values():
        add_mesh(spec, name, meshes[name])


@dataclass(frozen=True)
class _Piece:
    """A block, or the base or the flap of a slope, that the design wants."""

    place: NDArray[np.float64]
    """(3,) metres: of the frame of the block or slope."""
    angle: float | None
    """Of a flap's hinge."""
    slope: bool
    mesh: int
    pos: NDArray[np.float64]
    """(3,) metres: where the mesh is drawn."""
    mat: NDArray[np.float64]
    """(9,) how it is turned."""


class Ghost:
    """Draws what is missing of a trajectory's design."""

    def __init__(self, model: mujoco.MjModel, trajectory: Trajectory) -> None:
        """Prepare for the model of a stage."""
        physics, story = trajectory.physics, trajectory.story
        machines = story.recipe.setup.machines
        self._pieces = [piece for goal in story.design for piece in _pieces(model, machines, goal)]
        self._blocks = [block.qpos for block in physics.blocks]
        self._slopes = [(slope.base.qpos, slope.hinge.qpos) for slope in physics.slopes]

    def add(self, scene: mujoco.MjvScene, qpos: NDArray[np.float64]) -> None:
        """Add to a scene, after ``update_scene``, what does not stand in its place at these positions (nq,)."""
        for piece in self._pieces:
            if scene.ngeom == scene.maxgeom or self._stands(piece, qpos):
                continue
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_MESH, np.zeros(3), piece.pos, piece.mat, _RGBA)
            geom.dataid = 2 * piece.mesh
            # What decorates casts no shadow.
            geom.category, geom.transparent = mujoco.mjtCatBit.mjCAT_DECOR, 1
            scene.ngeom += 1

    def _stands(self, piece: _Piece, qpos: NDArray[np.float64]) -> bool:
        if not piece.slope:
            return any(_near(qpos[at : at + 3], piece.place) for at in self._blocks)
        return any(
            _near(qpos[at : at + 3], piece.place)
            and (piece.angle is None or abs(qpos[hinge] - piece.angle) < _NEAR_RAD)
            for at, hinge in self._slopes
        )


def _near(place: NDArray[np.float64], wanted: NDArray[np.float64]) -> bool:
    return math.dist(place, wanted) < _NEAR_M


def _pieces(model: mujoco.MjModel, machines: Machines, goal: GoalCell) -> Iterator[_Piece]:
    """Yield what is to stand in a cell; nothing for the foot of a slope, which the flap of its body reaches."""
    place, heading = cell_position(*goal.cell), yaw_angle(max(goal.yaw, 0))
    turn = np.array([math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)])
    if goal.kind == "block":
        yield _Piece(place, None, False, *_drawn(model, "block", place, turn))
    elif goal.kind in _HINGE_RAD:
        angle, slope, axis, folded = _HINGE_RAD[goal.kind], machines.slope, np.empty(3), np.empty(4)
        mujoco.mju_rotVecQuat(axis, np.array([slope.hinge_x_m, 0.0, slope.hinge_z_m]), turn)
        mujoco.mju_mulQuat(folded, turn, np.array([math.cos(angle / 2), 0.0, -math.sin(angle / 2), 0.0]))
        yield _Piece(place, None, True, *_drawn(model, "base", place, turn))
        yield _Piece(place, angle, True, *_drawn(model, "flap", place + axis, folded))


def _drawn(
    model: mujoco.MjModel, name: str, place: NDArray[np.float64], turn: NDArray[np.float64]
) -> tuple[int, NDArray[np.float64], NDArray[np.float64]]:
    """Return a mesh's number, position and rotation: MuJoCo keeps meshes in the frame of their own inertia."""
    mesh = model.mesh(_MESHES[name]).id
    pos, quat, mat = np.empty(3), np.empty(4), np.empty(9)
    mujoco.mju_rotVecQuat(pos, model.mesh_pos[mesh], turn)
    mujoco.mju_mulQuat(quat, turn, model.mesh_quat[mesh])
    mujoco.mju_quat2Mat(mat, quat)
    return mesh, place + pos, mat
