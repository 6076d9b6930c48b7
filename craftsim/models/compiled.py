"""Compiled worlds, kept by the parts that they are made of; where the parts start is written into a copy.

Reading and compiling the MJCF of a world takes as long as fifty to a hundred of its physics steps, and worlds of equal
parts differ in a few numbers only. Each world is a copy of the compiled one of its parts with its own numbers in place,
the first of them too: whichever worlds were made before, it is the same, bit for bit, and the same as one that is
compiled where its parts stand (tests/models/test_compiled.py).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Cell
from craftsim.errors import InputError
from craftsim.mjcf.parameters import Machines
from craftsim.models.composition import (
    built_levels,
    cameras,
    compose,
    goal_position,
    ground_pose_and_size,
)
from craftsim.models.config import SimulationConfig
from craftsim.models.floor import Tiles, add_tiles, level, put_below, tiles_of
from craftsim.models.imperfection import Floor
from craftsim.models.overlaps import MachineNames
from craftsim.models.parts import Car, FreeBody, Slope, load_part, trees_of_motors
from craftsim.models.placement import Placement

KEPT: Final = 8
"""Compiled worlds that a process keeps, those used last: 2 to 4 MB each for a few cars, 35 MB for the largest."""

_NOWHERE: Final = 10.0
"""Metres between the parts of a kept world: too far apart to touch."""
_MOST_DAMPING: Final = 0.25
"""Of a joint's speed in one physics step: forces that are integrated explicitly are unstable from 2 on, and physics
that is drawn may have several times the damping for a given inertia."""
_UPRIGHT: Final = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class CompiledParts:
    """The compiled world of some parts, which stand nowhere yet, and typed handles of them."""

    model: mujoco.MjModel
    """Not to be changed."""
    roots: NDArray[np.intp]
    """The body of each part, in their order."""
    free: NDArray[np.intp]
    """The places in ``roots`` of those that move."""
    qpos: NDArray[np.intp]
    """(n, 7): the addresses of the poses of these."""
    cars: tuple[Car, ...]
    slopes: tuple[Slope, ...]
    blocks: tuple[FreeBody, ...]
    flags: tuple[FreeBody, ...]
    tree_of_motor: NDArray[np.intp]
    names: MachineNames
    tiles: Tiles | None
    """Of a floor that is not flat."""

    def placed(
        self, size: Cell, parts: Sequence[Placement], goals: Sequence[Cell]
    ) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Return a copy of the model in which the parts, markers, floor and cameras are in place, and new data."""
        model = copy.copy(self.model)
        positions = np.array([part.position for part in parts]).reshape(-1, 3)
        quaternions = np.array([_normalized(part.quaternion) for part in parts]).reshape(-1, 4)
        model.body_pos[self.roots] = positions
        model.body_quat[self.roots] = quaternions
        model.qpos0[self.qpos] = np.hstack([positions, quaternions])[self.free]
        model.qpos_spring[self.qpos] = model.qpos0[self.qpos]
        if goals:
            model.site_pos[model.site_bodyid == 0] = [goal_position(goal) for goal in goals]
        ground = model.geom("ground").id
        model.geom_pos[ground], model.geom_size[ground] = ground_pose_and_size(size)
        if self.tiles:
            put_below(model, self.tiles)
        for camera, aim in cameras(size, built_levels(parts, goals)).items():
            number = model.camera(camera).id
            model.cam_pos[number], model.cam_quat[number] = aim.position, _normalized(aim.quaternion)
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        _set_statistics(model, data)
        return model, data


@lru_cache(maxsize=KEPT)
def compiled_parts(
    kinds: tuple[str, ...],
    n_goals: int,
    config: SimulationConfig,
    machines: Machines,
    uneven: tuple[Floor, Cell] | None = None,
) -> CompiledParts:
    """Return the compiled world of parts of these kinds, in their order.

    ``uneven`` is a floor that is not flat and the size of its area.

    Raises InputError for figures of which MuJoCo makes no world.
    """
    apart = [
        Placement(kind, np.array([_NOWHERE * number, 0.0, 0.0]), _UPRIGHT)
        for number, kind in enumerate(kinds)
    ]
    goals = [(0, 0, 1)] * n_goals
    spec, names = compose(_painted_ground(machines).copy(), (1, 1, 1), apart, config, goals, machines)
    tiles = tiles_of(*uneven) if uneven else None
    if tiles:
        add_tiles(spec, tiles)
    try:
        model: mujoco.MjModel = spec.compile()
    except ValueError as error:
        raise InputError(f"MuJoCo makes no world of these figures: {error}") from error
    if tiles:
        level(model)
    _check_damping(model)
    roots = np.flatnonzero(model.body_parentid == 0)[1 : len(kinds) + 1]  # the first is the world itself
    free = np.flatnonzero(model.body_jntnum[roots])
    first = model.jnt_qposadr[model.body_jntadr[roots[free]]]
    return CompiledParts(
        model,
        roots,
        free,
        first[:, None] + np.arange(7),
        tuple(Car.find(model, name, machines.car(i)) for i, name in enumerate(names["smartcar"])),
        tuple(Slope.find(model, name) for name in names["slope"]),
        tuple(FreeBody.find(model, name + "block") for name in names["block"]),
        tuple(FreeBody.find(model, name + "flag") for name in names["flag"]),
        trees_of_motors(model),
        MachineNames.of(model),
        tiles,
    )


def _check_damping(model: mujoco.MjModel) -> None:
    """Raise InputError, naming the joint, where a step takes so much of a joint's speed that it could swing up."""
    share = model.opt.timestep * model.dof_damping / model.dof_M0
    if not (share <= _MOST_DAMPING).all():
        dof = int(share.argmax())
        raise InputError(
            f"the joint {model.joint(model.dof_jntid[dof]).name} is damped by {model.dof_damping[dof]:g}: at most "
            f"{model.dof_damping[dof] * _MOST_DAMPING / share[dof]:.3g} goes with its inertia in physics steps of "
            f"{model.opt.timestep:g} s; enlarge what turns there, or take shorter steps"
        )


@lru_cache(maxsize=4)
def _painted_ground(machines: Machines) -> mujoco.MjSpec:
    """Return the ground with the pixels of its textures: working them out takes half of the time of compiling."""
    spec = load_part("ground", machines)
    model = spec.copy().compile()
    shapes = np.column_stack([model.tex_height, model.tex_width, model.tex_nchannel]).tolist()
    for texture, start, shape in zip(spec.textures, model.tex_adr.tolist(), shapes, strict=True):
        texture.height, texture.width, texture.nchannel = shape
        texture.builtin, texture.mark = mujoco.mjtBuiltin.mjBUILTIN_NONE, mujoco.mjtMark.mjMARK_NONE
        texture.data = model.tex_data[start : start + math.prod(shape)].tobytes()
    return spec


def _normalized(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a quaternion as the compiler of MuJoCo leaves it, its zeros positive."""
    found = np.empty(4)
    mujoco.mju_mulQuat(found, quaternion, _UPRIGHT)
    mujoco.mju_normalize4(found)
    return found


def _set_statistics(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Set what the compiler measures of a start, and ``mj_setConst``, which leaves ``data`` there, does not.

    The mean inertia scales the solver's tolerance; centre and extent serve cameras and shadows.
    """
    model.stat.meaninertia = sum(model.dof_M0.tolist()) / model.nv if model.nv else 1.0
    radius = model.geom_rbound.copy()
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    radius[plane] = 0.1 * model.geom_size[plane, :2].max(axis=1)
    points = np.vstack([data.xipos[1:], data.xanchor, data.site_xpos])
    low = np.vstack([points, data.geom_xpos - radius[:, None]]).min(axis=0)
    high = np.vstack([points, data.geom_xpos + radius[:, None]]).max(axis=0)
    model.stat.center[:] = 0.5 * (low + high)
    model.stat.extent = max(1e-5, float((high - low).max()))
