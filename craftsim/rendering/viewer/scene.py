"""A world of MuJoCo as a scene in the browser: one coloured mesh for everything that is seen to move by itself."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M, cell_position
from craftsim.discrete.grid import Cell
from craftsim.models.composition import ground_pose_and_size
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.cameras import label_strip_m
from craftsim.rendering.stage import FLOOR_RGB, dressed_rgb, floor, number_plate
from craftsim.rendering.trajectory import SeenWorld
from craftsim.workers.copying import NotCopyable
from craftsim.workers.interrupts import defer_interrupts

if TYPE_CHECKING:
    import trimesh  # loaded where it is used: every worker in physics imports this file
    from viser import SceneNodeHandle, ViserServer

_MOVED_M: Final = 1e-5
_TURNED: Final = (
    1e-4  # of a quaternion's part. What has moved less since it was last sent is not sent again
)
_FURTHER: Final = 1.3  # how much further away than the camera: the panel takes a part of the window
MARK: Final = 0.02
"""Height in levels of the mark of a cell whose content is not that of a whole cell."""
_LABEL_M: Final = 0.16  # height of a car's number above its centre
_FACE_UP_FORWARD: Final = (0.0, math.sqrt(0.5), -math.sqrt(0.5), 0.0)
"""The turn after which a picture lies flat with its top ahead along x: viser's own hang as a camera sees them, with y
down."""
_PLATE_SHARE: Final = 0.84  # side of a car's number plate, of that of the boss it lies on
_PLATE_PROUD_M: Final = 0.0012
_SHOWN_GROUPS: Final = 3
"""MuJoCo's viewer and renderer show the groups of geoms below this one; the others are there to collide."""
_Geom = mujoco.mjtGeom
_PROUD_M: Final = 0.001  # so high the floor lies on the bare ground, so that the two do not flicker


class BrowserScene(NotCopyable):
    """The meshes of a PhysicsWorld in the browsers of a server; it replaces the scene before."""

    _instead = "open another page"

    def __init__(
        self,
        server: ViserServer,
        physics: PhysicsWorld,
        marks: Mapping[Cell, float],
        on_pick: Callable[[int], None],
    ) -> None:
        """Send the meshes of a world, which is looked at alone.

        ``marks`` are cells to mark, such as those of a building that is to be put up, with how high in levels;
        ``on_pick`` is called with the number of a car that is clicked.
        """
        self._server = server
        self._seen = SeenWorld(physics)
        self._model = self._seen.model
        self.nodes: dict[int, SceneNodeHandle] = {}
        """Handles of what moves, by the number of its body."""
        self.sent = 0
        """Poses that were sent so far."""
        with server.atomic():
            server.scene.reset()
            self._add_surroundings(physics.size, marks)
            self._add_machines(physics, on_pick)
        self._look_from_overview()

    def show(self, qpos: NDArray[np.float64]) -> None:
        """Move everything to where it is at some positions, and send what has moved since the last call."""
        data = self._seen.at(qpos)
        with self._server.atomic():
            for body, node in self.nodes.items():
                position = data.xpos[body]
                quaternion = data.xquat[body]
                if np.abs(node.position - position).max() > _MOVED_M:
                    node.position = position
                    self.sent += 1
                if np.abs(node.wxyz - quaternion).max() > _TURNED:
                    node.wxyz = quaternion
                    self.sent += 1

    def _add_surroundings(self, size: Cell, marks: Mapping[Cell, float]) -> None:
        scene = self._server.scene
        scene.set_up_direction("+z")
        # An environment map looks better, but browsers without a GPU take seconds for a frame with it.
        scene.configure_environment_map(None)
        scene.configure_default_lights(True, cast_shadow=True)
        for number, side in enumerate([(-2.0, -3.0, 1.5), (3.0, 1.0, 1.0), (-1.0, 3.0, 1.0)]):
            scene.add_light_directional(f"/light/{number}", intensity=1.1, position=side)
        position, half = ground_pose_and_size(size)
        extent = 2 * np.array([half[0], half[1], 0.005])
        below = position - np.array([0, 0, 0.006])
        scene.add_box("/ground", FLOOR_RGB, extent, position=below, cast_shadow=False)
        scene.add_mesh_trimesh("/floor", floor_mesh(size), cast_shadow=False)
        look: dict[str, Any] = {"opacity": 0.16, "cast_shadow": False}
        for number, (cell, levels) in enumerate(marks.items()):
            height = levels * LEVEL_HEIGHT_M
            extent = np.array([0.98 * CELL_PITCH_M, 0.98 * CELL_PITCH_M, height])
            place = cell_position(*cell) + np.array([0, 0, 0.002 + height / 2])
            scene.add_box(f"/marks/{number}", (64, 168, 96), extent, position=place, **look)

    def _add_machines(self, physics: PhysicsWorld, on_pick: Callable[[int], None]) -> None:
        scene = self._server.scene
        model = self._model
        car_of = {
            int(model.dof_bodyid[car.base.dof]): number for number, car in enumerate(physics.cars)
        }
        for body, mesh in shapes_of(model).items():
            path = f"/machines/{model.body(body).name}"
            node = scene.add_mesh_trimesh(path, mesh, receive_shadow=False)
            if body:
                self.nodes[body] = node
            car = car_of.get(int(model.body_rootid[body]))
            if car is None:
                continue
            if path.endswith("/board"):  # its number lies on it, as in films
                parameters = physics.machines.car(car)
                side = _PLATE_SHARE * parameters.boss_top_side_m
                place = (0, 0, parameters.boss_height_m + _PLATE_PROUD_M)
                plate: dict[str, Any] = {
                    "format": "png",
                    "cast_shadow": False,
                    "wxyz": _FACE_UP_FORWARD,
                }
                scene.add_image(
                    f"{path}/plate", number_plate(car), side, side, position=place, **plate
                )
            node.on_click(partial(lambda car, event: on_pick(car), car))
            if body in car_of:
                above = (0, 0, _LABEL_M)
                scene.add_label(
                    f"{path}/number", f"car {car}", position=above, anchor="bottom-center"
                )

    def _look_from_overview(self) -> None:
        """Let browsers look from where the world's camera of that name does, at the ground before it."""
        model = self._model
        data = self._seen.at(model.qpos0)
        number = model.camera("overview").id
        position = data.cam_xpos[number].copy()
        forward = -data.cam_xmat[number].reshape(3, 3)[:, 2]
        target = position + forward * (position[2] / max(-forward[2], 0.1))
        position = target + _FURTHER * (position - target)
        camera = self._server.initial_camera
        camera.position = position
        camera.look_at = target
        camera.fov = np.radians(float(model.cam_fovy[number]))
        for client in self._server.get_clients().values():
            client.camera.position = position
            client.camera.look_at = target


def shapes_of(model: mujoco.MjModel) -> dict[int, trimesh.Trimesh]:
    """Return what is seen of a model but its ground, by body and in its frame, rollers with their wheel; 0 rests."""
    with defer_interrupts():
        from trimesh.util import concatenate

    meshes: dict[int, list[trimesh.Trimesh]] = defaultdict(list)
    for geom in np.flatnonzero(model.geom_group < _SHOWN_GROUPS).tolist():
        mesh = _mesh(model, geom)
        if mesh is None:
            continue
        body = int(model.geom_bodyid[geom])
        mesh.apply_transform(_transform(model.geom_pos[geom], model.geom_quat[geom]))
        while body and (model.body_jntnum[body] == 0 or _is_roller(model, body)):
            mesh.apply_transform(_transform(model.body_pos[body], model.body_quat[body]))
            body = int(model.body_parentid[body])
        meshes[body].append(mesh)
    shapes = {}
    for body, meshes_of_body in sorted(meshes.items()):
        shapes[body] = cast("trimesh.Trimesh", concatenate(meshes_of_body))
    return shapes


def floor_mesh(size: Cell) -> trimesh.Trimesh:
    """Return the floor of an area of ``size`` cells with its grid and its coordinates, as films show it.

    A picture in the page would show no shadows, so that things float; a mesh with that picture does.
    """
    with defer_interrupts():
        import trimesh
    from PIL import Image

    (length, width), strip = (n * CELL_PITCH_M for n in size[:2]), label_strip_m(*size[:2])
    low = np.array([-strip, -strip])
    high = np.array([length + strip, width + strip])
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
    joint = int(model.body_jntadr[body])
    geom = int(model.body_geomadr[body])
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    if (
        model.body_jntnum[body] != 1
        or model.body_geomnum[body] != 1
        or model.jnt_type[joint] != hinge
    ):
        return False
    size = model.geom_size[geom]
    axis = np.zeros(3)
    mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, 1.0]), model.geom_quat[geom])
    return bool(
        model.geom_type[geom] == _Geom.mjGEOM_ELLIPSOID
        and size[0] == size[1]
        and np.allclose(model.geom_pos[geom], model.jnt_pos[joint])
        and abs(axis @ model.jnt_axis[joint]) > 1 - 1e-9
    )


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    import trimesh

    size = model.geom_size[geom]
    match _Geom(model.geom_type[geom]):
        case _Geom.mjGEOM_MESH:
            # With MuJoCo's own normals, so that edges that are sharp there are sharp here.
            number = int(model.geom_dataid[geom])
            first = model.mesh_faceadr[number]
            count = model.mesh_facenum[number]
            faces = model.mesh_face[first : first + count].ravel()
            face_normals = model.mesh_facenormal[first : first + count].ravel()
            points = model.mesh_vert[model.mesh_vertadr[number] + faces]
            mesh = _faceted(points, model.mesh_normal[model.mesh_normaladr[number] + face_normals])
        case _Geom.mjGEOM_BOX | _Geom.mjGEOM_CYLINDER as kind:
            box = kind == _Geom.mjGEOM_BOX
            make = trimesh.creation
            if box:
                solid = make.box(extents=2 * size)
            else:
                solid = make.cylinder(size[0], 2 * size[1])
            mesh = _faceted(
                solid.triangles.reshape(-1, 3), np.repeat(solid.face_normals, 3, axis=0)
            )
        case _Geom.mjGEOM_ELLIPSOID:
            ball = trimesh.creation.icosphere(subdivisions=2)
            normals = ball.vertices / size
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            mesh = trimesh.Trimesh(
                ball.vertices * size, ball.faces, vertex_normals=normals, process=False
            )
        case _:
            return None
    rgba = np.array(model.geom_rgba[geom])
    rgb = dressed_rgb(model.geom(geom).name, int(model.geom_group[geom]))
    if rgb is not None:
        rgba[:3] = rgb
    colour = (255 * rgba).astype(np.uint8)
    mesh.visual = trimesh.visual.ColorVisuals(
        mesh, vertex_colors=np.tile(colour, (len(mesh.vertices), 1))
    )
    return mesh


def _faceted(points: NDArray[np.floating], normals: NDArray[np.floating]) -> trimesh.Trimesh:
    import trimesh

    faces = np.arange(len(points)).reshape(-1, 3)
    return trimesh.Trimesh(points, faces, vertex_normals=normals, process=False)


def _transform(
    position: NDArray[np.float64], quaternion: NDArray[np.float64]
) -> NDArray[np.float64]:
    from trimesh.transformations import quaternion_matrix

    matrix: NDArray[np.float64] = quaternion_matrix(quaternion)
    matrix[:3, 3] = position
    return matrix
