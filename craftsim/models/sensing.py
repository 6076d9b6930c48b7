"""What a robot can measure: its own pose, its joints, and the slope that it stands under.

Skills see the world through :class:`CarMeasurement` alone; noise and delay will be added here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.grid import Kind
from craftsim.discrete.readback import Poses, rotation_matrix
from craftsim.models.parameters import BLOCK
from craftsim.models.parts import Drive
from craftsim.models.site import Site

_DOCKING_RANGE_M = 0.04


@dataclass(frozen=True)
class CarMeasurement:
    """One car's view of itself at one instant; world frame, metres and radians."""

    time_s: float
    x: float
    y: float
    z: float
    """Height of the point on the floor between the wheels."""
    heading: float
    pitch: float
    """Nose up positive."""
    roll: float
    """Left side up positive."""
    wheel_speeds: NDArray[np.float64]
    """(4,) rad/s, in the order of WHEELS."""
    board_m: float
    """Height of the board above its lower stop."""
    board_force_n: float
    """Force of the board's motor, up positive: the weight of board and load when it is at rest."""
    slope: int | None
    """The slope whose plug the car is docked to, if any."""
    hinge_rad: float | None
    """Hinge angle of that slope."""


def measure(site: Site, car: int) -> CarMeasurement:
    """Return what car number ``car`` measures now."""
    handle = site.cars[car]
    position, quaternion = site.free_body_state(handle.base)
    turn = rotation_matrix(quaternion)
    slope = _docked_slope(site, position, turn)
    data = site.data
    return CarMeasurement(
        time_s=site.time_s,
        x=float(position[0]),
        y=float(position[1]),
        z=float(position[2]),
        heading=math.atan2(turn[1, 0], turn[0, 0]),
        pitch=math.asin(max(-1.0, min(1.0, turn[2, 0]))),
        roll=math.asin(max(-1.0, min(1.0, turn[2, 1]))),
        wheel_speeds=data.qvel[handle.wheel_dofs].copy(),
        board_m=float(data.qpos[handle.board.qpos]),
        board_force_n=_drive_force(site, handle.board),
        slope=slope,
        hinge_rad=None if slope is None else float(data.qpos[site.slopes[slope].hinge.qpos]),
    )


def _drive_force(site: Site, drive: Drive) -> float:
    """Return the force of a position-holding drive; MuJoCo's own figure is 0 while the drive's tree sleeps."""
    model, data, motor = site.model, site.data, drive.actuator
    gain, (offset, stiffness, damping) = model.actuator_gainprm[motor, 0], model.actuator_biasprm[motor, :3]
    force = gain * data.act[drive.activation] + offset
    force += stiffness * data.qpos[drive.qpos] + damping * data.qvel[drive.dof]
    return float(np.clip(force, *model.actuator_forcerange[motor]))


def _docked_slope(site: Site, position: NDArray[np.float64], turn: NDArray[np.float64]) -> int | None:
    """Return the slope right above a car: its plug reaches a car that is centred below it."""
    for index, slope in enumerate(site.slopes):
        base, _ = site.free_body_state(slope.base)
        relative = turn.T @ (base - position)
        if np.hypot(relative[0], relative[1]) < _DOCKING_RANGE_M and abs(relative[2]) < BLOCK.underside_m / 2:
            return index
    return None


def read_poses(site: Site) -> Poses:
    """Return the true poses of everything that moves: cars by id; then blocks, flags and slopes."""
    objects = [(Kind.BLOCK, b, math.nan) for b in site.blocks] + [
        (Kind.FLAG, f, math.nan) for f in site.flags
    ]
    objects += [(Kind.FSLOPE, s.base, float(site.data.qpos[s.hinge.qpos])) for s in site.slopes]
    cars = [site.free_body_state(car.base) for car in site.cars]
    states = [site.free_body_state(body) for _, body, _ in objects]
    return Poses(
        car_positions=np.array([p for p, _ in cars]).reshape(-1, 3),
        car_quaternions=np.array([q for _, q in cars]).reshape(-1, 4),
        kinds=tuple(kind for kind, _, _ in objects),
        positions=np.array([p for p, _ in states]).reshape(-1, 3),
        quaternions=np.array([q for _, q in states]).reshape(-1, 4),
        hinges=np.array([angle for _, _, angle in objects]),
    )
