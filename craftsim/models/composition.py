"""Composing a world from a Grid: every part attached to the ground at its start pose, goal markers, cameras."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M, cell_position
from craftsim.discrete.grid import Cell
from craftsim.mjcf.parameters import NOMINAL, Machines
from craftsim.models.config import SimulationConfig
from craftsim.models.framing import Aim, overview, top
from craftsim.models.parts import shared_part
from craftsim.models.placement import Placement

_MARGIN_CELLS = 2
"""Width of bare floor around the area; whole cells, so that the floor's lines are the cells' borders."""
PICTURE_ASPECT: Final = 4 / 3
"""Width over height for which a world's own cameras are fitted; a wider picture shows more on both sides."""


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
    for name, aim in cameras(size, built_levels(placed, goals)).items():
        spec.worldbody.add_camera(name=name, pos=aim.position, quat=aim.quaternion, fovy=aim.fovy_deg)
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
