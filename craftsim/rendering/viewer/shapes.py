"""What MuJoCo draws of a world, as one coloured mesh for everything that is seen to move by itself."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Final, cast

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.util import concatenate

_SHOWN_GROUPS: Final = 3
"""MuJoCo's viewer and renderer show the groups of geoms below this one; the others are there to collide."""
_BOX, _ELLIPSOID, _MESH = (
    int(kind)
    for kind in (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_ELLIPSOID, mujoco.mjtGeom.mjGEOM_MESH)
)
_HINGE: Final = int(mujoco.mjtJoint.mjJNT_HINGE)


@dataclass(frozen=True)
class BodyMesh:
    """A mesh in the frame of a body."""

    body: int
    """Number of the body; 0 does not move."""
    mesh: trimesh.Trimesh


def shapes_of(model: mujoco.MjModel) -> list[BodyMesh]:
    """Return what is to be seen of a model besides its ground, by body.

    A roller is drawn as a part of its wheel: it is round, so that its own spin does not show.
    """
    meshes: dict[int, list[trimesh.Trimesh]] = defaultdict(list)
    for geom in range(model.ngeom):
        kind = int(model.geom_type[geom])
        if model.geom_group[geom] >= _SHOWN_GROUPS or kind not in (_BOX, _ELLIPSOID, _MESH):
            continue
        mesh = _mesh(model, geom, kind)
        body = int(model.geom_bodyid[geom])
        mesh.apply_transform(_transform(model.geom_pos[geom], model.geom_quat[geom]))
        while body and (model.body_jntnum[body] == 0 or _is_roller(model, body)):
            mesh.apply_transform(_transform(model.body_pos[body], model.body_quat[body]))
            body = int(model.body_parentid[body])
        meshes[body].append(mesh)
    return [
        BodyMesh(body, cast(trimesh.Trimesh, concatenate(found))) for body, found in sorted(meshes.items())
    ]


def _is_roller(model: mujoco.MjModel, body: int) -> bool:
    """Whether all that a body can do is to spin about an axis around which it is round."""
    joint, geom = int(model.body_jntadr[body]), int(model.body_geomadr[body])
    if model.body_jntnum[body] != 1 or model.body_geomnum[body] != 1 or model.jnt_type[joint] != _HINGE:
        return False
    size = model.geom_size[geom]
    own = np.zeros(3)
    mujoco.mju_rotVecQuat(own, np.array([0.0, 0.0, 1.0]), model.geom_quat[geom])
    return bool(
        model.geom_type[geom] == _ELLIPSOID
        and size[0] == size[1]
        and np.allclose(model.geom_pos[geom], model.jnt_pos[joint])
        and abs(own @ model.jnt_axis[joint]) > 1 - 1e-9
    )


def _mesh(model: mujoco.MjModel, geom: int, kind: int) -> trimesh.Trimesh:
    size = model.geom_size[geom]
    if kind == _MESH:
        mesh = _asset(model, int(model.geom_dataid[geom]))
    elif kind == _BOX:
        box = trimesh.creation.box(extents=2 * size)
        mesh = _faceted(box.triangles.reshape(-1, 3), np.repeat(box.face_normals, 3, axis=0))
    else:
        ball = trimesh.creation.icosphere(subdivisions=2)
        normals = ball.vertices / size
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        mesh = trimesh.Trimesh(ball.vertices * size, ball.faces, vertex_normals=normals, process=False)
    colour = (255 * model.geom_rgba[geom]).astype(np.uint8)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.tile(colour, (len(mesh.vertices), 1)))
    return mesh


def _asset(model: mujoco.MjModel, number: int) -> trimesh.Trimesh:
    """Return a mesh with MuJoCo's own normals, so that edges that are sharp there are sharp here."""
    corners = slice(model.mesh_faceadr[number], model.mesh_faceadr[number] + model.mesh_facenum[number])
    points = model.mesh_vert[model.mesh_vertadr[number] + model.mesh_face[corners].ravel()]
    normals = model.mesh_normal[model.mesh_normaladr[number] + model.mesh_facenormal[corners].ravel()]
    return _faceted(points, normals)


def _faceted(points: NDArray[np.floating], normals: NDArray[np.floating]) -> trimesh.Trimesh:
    """Return the triangles between each three points (3 n, 3)."""
    faces = np.arange(len(points)).reshape(-1, 3)
    return trimesh.Trimesh(points, faces, vertex_normals=normals, process=False)


def _transform(position: NDArray[np.float64], quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix, rotation = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(rotation, quaternion)
    matrix[:3, :3], matrix[:3, 3] = rotation.reshape(3, 3), position
    return matrix
