"""The stage: the model that pictures are made of. It has the positions of the physics, and what is only to be seen.

Both qualities have a floor with the grid and its coordinates, and numbers on the cars. ``draft`` is quick; ``paper``
has shadows, materials and smoother edges.
"""

from __future__ import annotations

import math
from typing import Final, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.drawing import CAR_COLOURS
from craftsim.mjcf.parameters import Machines
from craftsim.models.composition import WorldSpec
from craftsim.models.config import SimulationConfig
from craftsim.rendering.cameras import reached_m
from craftsim.rendering.dressing import dress
from craftsim.rendering.floor import FLOORS, lay_floor
from craftsim.rendering.ghost import Ghost, add_ghost_meshes
from craftsim.rendering.painting import number_plate, painted
from craftsim.rendering.trajectory import Trajectory

Quality = Literal["draft", "paper"]

_BRIGHTNESS: Final[dict[Quality, float]] = {"draft": 0.9, "paper": 1.0}
"""Of the floor."""
_PLATE_M: Final = 0.0004
"""Half of the thickness of a car's number plates."""
_ONLY_SEEN: Final = {"contype": 0, "conaffinity": 0, "mass": 0.0, "group": 2}


class Stage:
    """The model of which pictures of a trajectory are made, and what its scenes still lack.

    A picture is made of the data of a :class:`~craftsim.rendering.playback.Playback` of its model:
    ``renderer.update_scene(data, camera)``, ``stage.finish(renderer.scene, data.qpos)``, ``renderer.render()``.
    """

    def __init__(self, trajectory: Trajectory, quality: Quality) -> None:
        """Build the stage of a trajectory, in ``draft`` or ``paper`` quality."""
        recipe = trajectory.story.recipe
        setup = recipe.setup
        machines = setup.machines
        config = setup.simulation or SimulationConfig.of(machines.drive)
        spec = WorldSpec(recipe.grid, config, machines, recipe.goals).spec()
        _number_cars(spec, machines, recipe.grid.n_cars)
        add_ghost_meshes(spec, machines)
        if trajectory.story.design:
            for marker in [physics for physics in spec.sites if physics.name.startswith("goal")]:
                spec.delete(marker)  # the ghost shows them
        quads = spec.visual.quality
        quads.numslices, quads.numstacks = 14, 8  # of a roller: forty a car are most of a picture's cost
        lay_floor(spec, recipe.grid.size, _BRIGHTNESS[quality])
        if quality == "paper":
            dress(spec, recipe.grid.size, reached_m(trajectory))
        self.model: mujoco.MjModel = spec.compile()
        """Its ``qpos`` are those of the trajectory."""
        self.shadows = quality == "paper"
        """Whether it is meant to be drawn with shadows: ``scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW]``."""
        _check_columns(self.model, trajectory.model)
        self._ghost = Ghost(self.model, trajectory)
        names = (self.model.geom(i).name for i in range(self.model.ngeom))
        self._floors = {i for i, name in enumerate(names) if name in FLOORS}

    def finish(self, scene: mujoco.MjvScene, qpos: NDArray[np.float64], ghost: bool = True) -> None:
        """Complete a scene after ``update_scene``, which makes it anew.

        Args:
            scene: of the renderer.
            qpos: (nq,) the positions that it shows.
            ghost: whether to draw what the design wants and does not stand in its place.
        """
        left = len(self._floors)
        for number in range(scene.ngeom):
            if left == 0:
                break
            geom = scene.geoms[number]
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in self._floors:
                # What decorates shows shadows and casts none: without it a floor is speckled with its own.
                geom.category = mujoco.mjtCatBit.mjCAT_DECOR
                left -= 1
        if ghost:
            self._ghost.add(scene, qpos)


def _number_cars(spec: mujoco.MjSpec, machines: Machines, n_cars: int) -> None:
    """Put each car's number on its boss, upright as seen from behind, on its nose and on its tail."""
    for number in range(n_cars):
        car, name = machines.car(number), f"plate{number}"
        painted(spec, name, number_plate(number, CAR_COLOURS[number % len(CAR_COLOURS)])).specular = 0.2
        lid, nose = 0.42 * car.boss_top_side_m, 0.012
        end, height = car.chassis_length_m / 2 - 0.0018, car.wheel_radius_m + car.chassis_top_m - 0.017
        turn = [0.0, 0.0, -math.pi / 2]
        for body, place, half, euler in (
            ("board", [0.0, 0.0, car.boss_height_m + 0.0008], lid, turn),
            ("smartcar", [end, 0.0, height], nose, [0.0, math.pi / 2, math.pi / 2]),
            ("smartcar", [-end, 0.0, height], nose, [0.0, -math.pi / 2, -math.pi / 2]),
        ):
            spec.body(f"car{number}/{body}").add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=place,
                quat=_quaternion(euler),
                size=[half, half, _PLATE_M],
                material=name,
                rgba=[1.0, 1.0, 1.0, 1.0],
                **_ONLY_SEEN,
            )


def _check_columns(model: mujoco.MjModel, physics: mujoco.MjModel) -> None:
    """Raise RuntimeError unless both models have the same joints at the same places of ``qpos``."""
    pairs = [
        [(m.joint(j).name, int(m.jnt_type[j]), int(m.jnt_qposadr[j])) for j in range(m.njnt)]
        for m in (model, physics)
    ]
    if pairs[0] != pairs[1]:
        raise RuntimeError("the stage has other joints than the physics")


def _quaternion(euler: list[float]) -> NDArray[np.float64]:
    """Return the unit quaternion (4,), w first, of turns about x, then the new y, then the new z."""
    quaternion = np.empty(4)
    mujoco.mju_euler2Quat(quaternion, np.array(euler), "xyz")
    return quaternion
