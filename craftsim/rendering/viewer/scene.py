"""A world of MuJoCo as a scene in the browser."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.drawing import car_colour
from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M, cell_position
from craftsim.discrete.grid import Cell
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.composition import ground_pose_and_size
from craftsim.models.world import PhysicsWorld
from craftsim.rendering.painting import FLOOR_RGB, number_plate
from craftsim.rendering.playback import SeenWorld
from craftsim.rendering.viewer.shapes import floor_mesh, shapes_of

if TYPE_CHECKING:
    from viser import SceneNodeHandle, ViserServer

_MOVED_M: Final = 1e-5
_TURNED: Final = 1e-4
"""Of a quaternion's part. What has moved less since it was last sent is not sent again."""
_FURTHER: Final = 1.3
"""How much further away than the camera: the panel takes a part of the window."""
MARK: Final = 0.02
"""Height in levels of the mark of a cell whose content is not that of a whole cell."""
_LABEL_M: Final = 0.16
"""Height of a car's number above its centre."""


_FACE_UP_FORWARD: Final = (0.0, math.sqrt(0.5), -math.sqrt(0.5), 0.0)
"""The turn after which a picture lies flat with its top ahead along x: viser's own hang as a camera sees them, with y
down."""
_PLATE_SHARE: Final = 0.84
"""Side of a car's number plate, of that of the boss it lies on."""
_PLATE_PROUD_M: Final = 0.0012


def _pick(on_pick: Callable[[int], None], car: int, event: object) -> None:
    on_pick(car)


class BrowserScene:
    """The meshes of a PhysicsWorld in the browsers of a server; it replaces the scene before."""

    def __init__(
        self,
        server: ViserServer,
        physics: PhysicsWorld,
        marks: Mapping[Cell, float],
        on_pick: Callable[[int], None],
    ) -> None:
        """Send the meshes.

        Args:
            server: of the page.
            physics: the world, which is looked at alone.
            marks: cells to mark, such as those of a building that is to be put up, and how high in levels.
            on_pick: called with the number of a car that is clicked.
        """
        self._server, self._posed = server, SeenWorld(physics)
        self._model = self._posed.model
        self.nodes: dict[int, SceneNodeHandle] = {}
        """What moves, by the number of its body."""
        self.sent = 0
        """Poses that were sent so far."""
        scene = server.scene
        with server.atomic():
            scene.reset()
            self._light()
            self._add_ground(physics.size)
            self._add_machines(physics, on_pick)
            self._add_marks(marks)
        self._look_from_overview()

    def show(self, qpos: NDArray[np.float64]) -> None:
        """Move everything to where it is at some positions, and send what has moved since the last call."""
        data = self._posed.at(qpos)
        with self._server.atomic():
            for body, node in self.nodes.items():
                position, quaternion = data.xpos[body], data.xquat[body]
                if np.abs(node.position - position).max() > _MOVED_M:
                    node.position = position
                    self.sent += 1
                if np.abs(node.wxyz - quaternion).max() > _TURNED:
                    node.wxyz = quaternion
                    self.sent += 1

    def _light(self) -> None:
        scene = self._server.scene
        scene.set_up_direction("+z")
        # An environment map looks better, but browsers without a GPU take seconds for a frame with it.
        scene.configure_environment_map(None)
        scene.configure_default_lights(True, cast_shadow=True)
        for number, side in enumerate([(-2.0, -3.0, 1.5), (3.0, 1.0, 1.0), (-1.0, 3.0, 1.0)]):
            scene.add_light_directional(f"/light/{number}", intensity=1.1, position=side)

    def _add_ground(self, size: Cell) -> None:
        position, half = ground_pose_and_size(size)
        extent = 2 * np.array([half[0], half[1], 0.005])
        below = position - np.array([0, 0, 0.006])
        self._server.scene.add_box("/ground", FLOOR_RGB, extent, position=below, cast_shadow=False)
        self._server.scene.add_mesh_trimesh("/floor", floor_mesh(size), cast_shadow=False)

    def _add_machines(self, physics: PhysicsWorld, on_pick: Callable[[int], None]) -> None:
        car_of = {
            int(self._model.dof_bodyid[car.base.dof]): number for number, car in enumerate(physics.cars)
        }
        for shape in shapes_of(self._model):
            name = self._model.body(shape.body).name
            node = self._server.scene.add_mesh_trimesh(f"/machines/{name}", shape.mesh, receive_shadow=False)
            if shape.body:
                self.nodes[shape.body] = node
            root = int(self._model.body_rootid[shape.body])
            if root not in car_of:
                continue
            car = car_of[root]
            if name.endswith("/board"):
                self._add_plate(f"/machines/{name}/plate", car, physics.machines.car(car))
            node.on_click(partial(_pick, on_pick, car))
            if shape.body == root:
                self._server.scene.add_label(
                    f"/machines/{name}/number",
                    f"car {car}",
                    position=(0, 0, _LABEL_M),
                    anchor="bottom-center",
                )

    def _add_plate(self, name: str, car: int, figures: SmartcarParameters) -> None:
        """Put a car's number on its board, as in films."""
        side = _PLATE_SHARE * figures.boss_top_side_m
        self._server.scene.add_image(
            name,
            number_plate(car, car_colour(car)),
            side,
            side,
            format="png",
            cast_shadow=False,
            wxyz=_FACE_UP_FORWARD,
            position=(0, 0, figures.boss_height_m + _PLATE_PROUD_M),
        )

    def _add_marks(self, marks: Mapping[Cell, float]) -> None:
        for number, (cell, levels) in enumerate(marks.items()):
            height = levels * LEVEL_HEIGHT_M
            extent = np.array([0.98 * CELL_PITCH_M, 0.98 * CELL_PITCH_M, height])
            position = cell_position(*cell) + np.array([0, 0, 0.002 + height / 2])
            self._server.scene.add_box(
                f"/marks/{number}", (64, 168, 96), extent, position=position, opacity=0.16, cast_shadow=False
            )

    def _look_from_overview(self) -> None:
        """Let browsers look from where the world's camera of that name does, at the ground before it."""
        model = self._model
        data = self._posed.at(model.qpos0)
        number = model.camera("overview").id
        position, forward = data.cam_xpos[number].copy(), -data.cam_xmat[number].reshape(3, 3)[:, 2]
        target = position + forward * (position[2] / max(-forward[2], 0.1))
        position = target + _FURTHER * (position - target)
        camera = self._server.initial_camera
        camera.position, camera.look_at = position, target
        camera.fov = np.radians(float(model.cam_fovy[number]))
        for client in self._server.get_clients().values():
            client.camera.position, client.camera.look_at = position, target
