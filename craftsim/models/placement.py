"""Where each part of a Grid stands in the world: the start poses from which a PhysicsWorld is composed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.geometry import LEVEL_HEIGHT_M, cell_position, yaw_angle
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.kinds import STANDING
from craftsim.discrete.schedule import incline_under
from craftsim.errors import InputError
from craftsim.mjcf.block import TABLES
from craftsim.mjcf.parameters import NOMINAL, Machines, SmartcarParameters


@dataclass(frozen=True)
class Placement:
    """One part at its start: pose of its frame and position of its own joint."""

    kind: str
    """One of :data:`craftsim.models.composition.MACHINES`, but the ground."""
    position: NDArray[np.float64]
    """(3,) metres, world."""
    quaternion: NDArray[np.float64]
    """(4,) unit quaternion w, x, y, z."""
    joint: float = 0.0
    """Height of a smartcar's board (m) or angle of a slope's hinge (rad)."""


def placements(grid: Grid, machines: Machines = NOMINAL) -> list[Placement]:
    """Return the start pose of every part: cars by id, then loads by car, then objects in scan order x, y, z."""
    cars = [_car(grid, row, machines.car(i)) for i, row in enumerate(grid.cars)]
    loads = [
        _load(grid, row, cars[i], machines.car(i), machines)
        for i, row in enumerate(grid.cars)
        if row[CarField.LOAD] != Kind.AIR
    ]
    return cars + loads + _objects(grid, machines)


def _quaternion(heading: float, pitch_up: float = 0.0) -> NDArray[np.float64]:
    """Turn by ``heading`` about z, then raise the nose by ``pitch_up`` about the body's own y axis."""
    ch, sh = math.cos(heading / 2), math.sin(heading / 2)
    cp, sp = math.cos(pitch_up / 2), math.sin(pitch_up / 2)
    return np.array([ch * cp, sh * sp, -ch * sp, sh * cp])


def _car(grid: Grid, row: NDArray[np.int64], machine: SmartcarParameters) -> Placement:
    position = cell_position(*(int(row[f]) for f in (CarField.X, CarField.Y, CarField.Z)))
    position[2] += LEVEL_HEIGHT_M * (0.0, 0.25, -0.25)[row[CarField.SLOPE]]
    board = machine.board_travel_m if row[CarField.LOAD] != Kind.AIR else 0.0
    return Placement(
        "smartcar", position, _quaternion(yaw_angle(int(row[CarField.YAW])), incline_under(grid, row)), board
    )


def lift_m(load: Kind, car: SmartcarParameters, machines: Machines) -> float:
    """Return how high above its car's origin a load of a kind is carried."""
    underside_m = (machines.slope if load == Kind.FSLOPE else machines.block).underside_m
    return car.board_rest_m + car.board_travel_m - underside_m


def _load(
    grid: Grid, row: NDArray[np.int64], car: Placement, machine: SmartcarParameters, machines: Machines
) -> Placement:
    lift = lift_m(Kind(row[CarField.LOAD]), machine, machines)
    pitch, heading = incline_under(grid, row), yaw_angle(int(row[CarField.YAW]))
    up = np.array(
        [-math.sin(pitch) * math.cos(heading), -math.sin(pitch) * math.sin(heading), math.cos(pitch)]
    )
    position = car.position + lift * up
    if row[CarField.LOAD] == Kind.FSLOPE:
        # A carried slope faces away from the car's heading, so the same incline lowers its nose.
        quaternion = _quaternion(yaw_angle(int(row[CarField.LOAD_YAW])), -pitch)
        return Placement("slope", position, quaternion, machines.slope.hinge_range_rad)
    return Placement(Kind(row[CarField.LOAD]).name.lower(), position, car.quaternion)


def _objects(grid: Grid, machines: Machines) -> list[Placement]:
    found = []
    for x, y, z in np.argwhere(grid.kind[:, :, 1:]):
        kind = Kind(grid.kind[x, y, z + 1])
        position = cell_position(x, y, z + 1)
        turn = _quaternion(yaw_angle(int(grid.yaw[x, y, z + 1])))
        if kind in TABLES:
            found.append(Placement(kind.name.lower(), position, turn))
        elif kind in (Kind.FSLOPE, Kind.BODY):
            hinge = machines.slope.hinge_range_rad if kind == Kind.FSLOPE else 0.0
            found.append(Placement("slope", position, turn, hinge))
        elif kind in STANDING:
            raise InputError(
                f"{kind.name} in ({x}, {y}, {z + 1}) has no machine; add it to TABLES in craftsim/mjcf/block.py"
            )
    return found
