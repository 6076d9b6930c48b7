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

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import Cell
from craftsim.rendering.dressing import dressed_rgb
from craftsim.rendering.painting import floor, label_strip_m

_SHOWN_GROUPS: Final = 3
"""MuJoCo's viewer and renderer show the groups of geoms below this one; the others are there to collide."""
_BOX, _CYLINDER, _ELLIPSOID, _MESH = (
    int(kind)
    for kind in (
        mujoco.mjtGeom.mjGEOM_BOX,
        mujoco.mjtGeom.mjGEOM_CYLINDER,
        mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        mujoco.mjtGeom.mjGEOM_MESH,
    )
)
_PROUD_M: Final = 0.001
"""So high the floor lies on the bare ground, so that the two do not flicker."""
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
        if model.geom_group[geom] >= _SHOWN_GROUPS or kind not in (_BOX, _CYLINDER, _ELLIPSOID, _MESH):
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


def floor_mesh(size: Cell) -> trimesh.Trimesh:
    """Return the floor of an area of ``size`` cells with its grid and its coordinates, as films show it.

    A picture in the page would show no shadows, so that things float; a mesh with that picture does.
    """
    from PIL import Image

    (length, width), strip = (n * CELL_PITCH_M for n in size[:2]), label_strip_m(*size[:2])
    low, high = np.array([-strip, -strip]), np.array([length + strip, width + strip])
    share = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    points = np.column_stack([low + share * (high - low), np.full(4, _PROUD_M)])
    picture = Image.fromarray(floor(*size[:2]))
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0
    )
    return trimesh.Trimesh(
        points,
        [(0, 1, 2), (0, 2, 3)],
        vertex_normals=np.tile((0.0, 0.0, 1.0), (4, 1)),
        visual=trimesh.visual.TextureVisuals(uv=share, material=material),
        process=False,
    )


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
    elif kind in (_BOX, _CYLINDER):
        solid = (
            trimesh.creation.box(extents=2 * size)
            if kind == _BOX
            else trimesh.creation.cylinder(size[0], 2 * size[1])
        )
        mesh = _faceted(solid.triangles.reshape(-1, 3), np.repeat(solid.face_normals, 3, axis=0))
    else:
        ball = trimesh.creation.icosphere(subdivisions=2)
        normals = ball.vertices / size
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        mesh = trimesh.Trimesh(ball.vertices * size, ball.faces, vertex_normals=normals, process=False)
    name, group = model.geom(geom).name, int(model.geom_group[geom])
    rgba = np.array(model.geom_rgba[geom])
    if (rgb := dressed_rgb(name, group)) is not None:
        rgba[:3] = rgb
    colour = (255 * rgba).astype(np.uint8)
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
