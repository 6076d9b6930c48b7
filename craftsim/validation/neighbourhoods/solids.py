"""The convex solids of each part, in its own frame: those that collide in physics, from the same compiled models."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from craftsim.mjcf.parameters import Machines
from craftsim.models.composition import machine_spec
from craftsim.models.placement import Placement

Pose = NDArray[np.float64]
"""(4, 4): a homogeneous transform, metres."""


@dataclass(frozen=True, eq=False)
class Solid:
    """One convex solid of a part."""

    name: str
    points: NDArray[np.float64]
    """(n, 3) corners in the part's frame, its joint at zero; curved faces have corners on them."""
    jointed: bool
    """Whether the part's own joint moves it: a car's board, a slope's flap."""


@dataclass(frozen=True, eq=False)
class Figure:
    """The solids of a part, and the joint that moves some of them."""

    solids: tuple[Solid, ...]
    hinge: bool = False
    """Whether the joint turns; else it slides."""
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    anchor: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def joint(self, position: float) -> Pose:
        """Return how the joint moves its solids at a position in metres or radians."""
        if self.hinge:
            turn: Pose = trimesh.transformations.rotation_matrix(position, self.axis, self.anchor)
            return turn
        slide: Pose = trimesh.transformations.translation_matrix(position * np.array(self.axis))
        return slide

    def posed(self, pose: Pose, joint: float) -> list[NDArray[np.float64]]:
        """Return the corners of each solid in the world, for a part at this pose with its joint at this position."""
        moved = pose @ self.joint(joint)
        return [trimesh.transform_points(s.points, moved if s.jointed else pose) for s in self.solids]


def pose_of(placement: Placement) -> Pose:
    """Return the pose of a part as a transform."""
    pose: Pose = trimesh.transformations.quaternion_matrix(placement.quaternion)
    pose[:3, 3] = placement.position
    return pose


@lru_cache(maxsize=64)
def figure_of(kind: str, machines: Machines) -> Figure:
    """Return the solids of a part: smartcar, block, flag, slope or wall.

    A wheel is the cylinder round its rollers. Visual geometry is left out, and a car is the first of the machines'.
    """
    model = machine_spec(kind, machines, visual=False).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    root = model.body(kind).id
    base = np.linalg.inv(_transform(data.xpos[root], data.xmat[root]))
    own = [j for j in range(model.njnt) if model.joint(j).name in ("board", "hinge")]
    solids = []
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if not (body and touches) or model.body(body).name.startswith("roller_"):
            continue
        pose = base @ _transform(data.geom_xpos[geom], data.geom_xmat[geom])
        points = trimesh.transform_points(_mesh(model, geom).vertices, pose)
        jointed = any(model.jnt_bodyid[j] == body for j in own)
        solids.append(Solid(model.geom(geom).name, points, jointed))
    if not own:
        return Figure(tuple(solids))
    hinge = model.jnt_type[own[0]] == mujoco.mjtJoint.mjJNT_HINGE
    axis = base[:3, :3] @ data.xaxis[own[0]]
    anchor = trimesh.transform_points(data.xanchor[own], base)[0]
    return Figure(tuple(solids), bool(hinge), tuple(axis), tuple(anchor))


def _transform(position: NDArray[np.float64], rotation: NDArray[np.float64]) -> Pose:
    pose = np.eye(4)
    pose[:3, :3] = rotation.reshape(3, 3)
    pose[:3, 3] = position
    return pose


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """Return a collision geometry as a convex mesh in its own frame."""
    size = model.geom_size[geom]
    match mujoco.mjtGeom(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_BOX:
            return trimesh.creation.box(2 * size)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return trimesh.creation.cylinder(size[0], 2 * size[1], sections=64)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return trimesh.creation.icosphere(subdivisions=1, radius=size[0])
        case mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            start = model.mesh_vertadr[mesh]
            return trimesh.convex.convex_hull(
                model.mesh_vert[start : start + model.mesh_vertnum[mesh]].astype(float)
            )
    raise NotImplementedError(f"no solid for {model.geom(geom).name}: add its type here")
