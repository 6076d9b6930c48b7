"""Composing a world from a Grid, ground, machines at their start poses, goal markers and cameras, and compiling it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M, cell_position
from craftsim.discrete.grid import Cell, Grid
from craftsim.errors import InputError
from craftsim.mjcf.block import TABLE_NAMES, add_block
from craftsim.mjcf.building import Frame, new_world
from craftsim.mjcf.car import add_car
from craftsim.mjcf.parameters import NOMINAL, Drive, Machines
from craftsim.mjcf.slope import add_slope
from craftsim.models.config import SimulationConfig
from craftsim.models.floor import add_tiles, level, tiles_of
from craftsim.models.framing import Aim, overview, top
from craftsim.models.imperfection import FLAT, Floor
from craftsim.models.placement import Placement, placements

MACHINES: Final = ("ground", "smartcar", *TABLE_NAMES, "slope")
_MARGIN_CELLS: Final = 2
"""Width of bare floor around the area; whole cells, so that the floor's lines are the cells' borders."""
PICTURE_ASPECT: Final = 4 / 3
"""Width over height for which a world's own cameras are fitted; a wider picture shows more on both sides."""
_MOST_DAMPING: Final = 0.25
"""Of a joint's speed in one physics step: forces that are integrated explicitly are unstable from 2 on, and physics
that is drawn may have several times the damping for a given inertia."""


@dataclass(frozen=True)
class WorldSpec:
    """All that decides a world in physics at its start, before anything of it is drawn from a seed."""

    grid: Grid
    config: SimulationConfig
    machines: Machines = NOMINAL
    goals: Sequence[Cell] = ()
    """Cells that get a marker without contact."""
    floor: Floor = FLAT

    def spec(self, visual: bool = True) -> mujoco.MjSpec:
        """Return the spec of the world; ``visual`` adds what is only seen: it changes no number of the physics."""
        size = self.grid.size
        middle, half = ground_pose_and_size(size)
        spec = new_world(self.machines.contact, half, middle, visual)
        spec.modelname = "site"
        configure(spec, self.config, self.machines.drive)
        placed = placements(self.grid, self.machines)
        numbers: Counter[str] = Counter()
        for item in placed:
            number = numbers[item.kind]
            prefix = f"car{number}/" if item.kind == "smartcar" else f"{item.kind}{number}/"
            _add(
                spec, item.kind, prefix, Frame(item.position, item.quaternion), self.machines, number, visual
            )
            numbers[item.kind] += 1
        if visual:
            _add_markers(spec, self.goals)
            for name, aim in cameras(size, built_levels(placed, self.goals)).items():
                spec.worldbody.add_camera(name=name, pos=aim.position, quat=aim.quaternion, fovy=aim.fovy_deg)
        if not self.floor.flat:
            add_tiles(spec, tiles_of(self.floor, size))
        return spec

    def model(self, visual: bool = True) -> mujoco.MjModel:
        """Return the compiled world, its floor level.

        Raises InputError for parameters of which MuJoCo makes no world.
        """
        try:
            model: mujoco.MjModel = self.spec(visual).compile()
        except ValueError as error:
            raise InputError(f"MuJoCo makes no world of these figures: {error}") from error
        if not self.floor.flat:
            level(model)
        _check_damping(model)
        return model


def _add(
    spec: mujoco.MjSpec, kind: str, prefix: str, pose: Frame, machines: Machines, number: int, visual: bool
) -> None:
    """Add one of MACHINES; ``number`` is of the car. The ground is there already."""
    match kind:
        case "smartcar":
            add_car(spec, prefix, pose, machines, number, visual)
        case "slope":
            add_slope(spec, prefix, pose, machines, visual)
        case name if name in TABLE_NAMES:
            add_block(spec, prefix, pose, machines, kind, visual)


def machine_spec(kind: str, machines: Machines, number: int = 0, visual: bool = True) -> mujoco.MjSpec:
    """Return the spec of one of MACHINES on the floor, or of the floor alone; ``number`` is of the car."""
    spec = new_world(machines.contact, (0.0, 0.0, 0.05), (0.0, 0.0, 0.0), visual)
    spec.modelname = kind
    configure(spec, replace(SimulationConfig.of(machines.drive), sleep=False), machines.drive)
    _add(spec, kind, "", Frame(), machines, number, visual)
    return spec


def configure(spec: mujoco.MjSpec, config: SimulationConfig, drive: Drive) -> None:
    """Put the settings of a simulation into a spec of cars with a drive."""
    # Dense, which MuJoCo chooses below 60 degrees of freedom, suits bodies without joints. A car of rollers has 49
    # alone, most of them apart from each other: it would take three times as long.
    dense = mujoco.mjtJacobian.mjJAC_AUTO if drive == "reduced" else mujoco.mjtJacobian.mjJAC_SPARSE
    spec.option.jacobian = dense
    spec.option.timestep = config.timestep_s
    spec.option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{config.solver.upper()}")
    spec.option.iterations = config.solver_iterations
    spec.option.impratio = config.friction_impedance_ratio
    spec.option.sleep_tolerance = config.sleep_tolerance_m_s
    if config.sleep:
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)


def _add_markers(spec: mujoco.MjSpec, goals: Sequence[Cell]) -> None:
    for number, goal in enumerate(goals):
        spec.worldbody.add_site(
            name=f"goal{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=cell_position(*goal) + np.array([0, 0, 0.002]),
            size=[0.45 * CELL_PITCH_M, 0.45 * CELL_PITCH_M, 0.001],
            rgba=[0.25, 0.75, 0.40, 0.45],
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


def ground_pose_and_size(size: Cell) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return position and half-lengths, (3,) each, in metres, of the floor of an area of this size in cells."""
    length, width, _ = size
    half = [(0.5 * n + _MARGIN_CELLS) * CELL_PITCH_M for n in (length, width)]
    middle = [0.5 * length * CELL_PITCH_M, 0.5 * width * CELL_PITCH_M, 0.0]
    return np.array(middle), np.array([*half, 0.05])


def built_levels(parts: Sequence[Placement], goals: Sequence[Cell]) -> int:
    """Return how many levels, at least two, the parts and goals of a world take up."""
    tops = [round(float(part.position[2]) / LEVEL_HEIGHT_M) + 1 for part in parts]
    return max([2, *tops, *(goal[2] for goal in goals)])


@lru_cache(maxsize=64)
def cameras(size: Cell, levels: int) -> dict[str, Aim]:
    """Return the cameras of a world by their names: ``overview`` and ``top``, both with the whole area in view.

    Args:
        size: of the area, in cells.
        levels: how high it is built, cars on top included.
    """
    return {aim.__name__: aim(size, levels * LEVEL_HEIGHT_M, PICTURE_ASPECT) for aim in (overview, top)}
