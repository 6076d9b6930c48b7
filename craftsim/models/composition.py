"""Composing a world from a Grid, ground, machines at their start poses, goal markers and cameras, and compiling it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, LEVEL_HEIGHT_M, cell_position, yaw_angle
from craftsim.discrete.grid import CarField, Cell, Grid, Kind
from craftsim.discrete.kinds import STANDING
from craftsim.discrete.schedule import incline_under
from craftsim.errors import InputError, StartError
from craftsim.mjcf.block import TABLE_NAMES, TABLES, add_block
from craftsim.mjcf.building import ORIGIN, Pose, new_world
from craftsim.mjcf.car import add_car
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.mjcf.slope import add_slope
from craftsim.models.cameras import overview_aim, top
from craftsim.models.config import SimulationConfig
from craftsim.models.floor import FLAT, LEVEL, Floor, add_tiles
from craftsim.storage.limits import PHYSICS_CARS, PHYSICS_GOALS, PHYSICS_PARTS

MACHINES: Final = ("ground", "smartcar", *TABLE_NAMES, "slope")
_MARGIN_CELLS: Final = 2
"""Width of bare floor around the area; whole cells, so that the floor's lines are the cells' borders."""
_PICTURE_ASPECT: Final = 4 / 3
"""Width over height for which a world's own cameras are fitted; a wider picture shows more on both sides."""
_MOST_DAMPING: Final = 0.25
"""Of a joint's speed in one physics step: forces that are integrated explicitly are unstable from 2 on, and physics
that is drawn may have several times the damping for a given inertia."""
_MOST_SERVO: Final = 2.0
"""The same of a motor's velocity loop, which would turn the joint's speed over; nominal wheels have 1.25."""


@dataclass(frozen=True)
class PlacedPart:
    """One part at its start: pose of its frame and position of its own joint."""

    kind: str
    """One of :data:`MACHINES`, but the ground."""
    position: NDArray[np.float64]
    """(3,) metres, world."""
    quaternion: NDArray[np.float64]
    """(4,) unit quaternion w, x, y, z."""
    joint: float = 0.0
    """Height of a smartcar's board (m) or angle of a slope's hinge (rad)."""


def placements(grid: Grid, machines: Machines = NOMINAL) -> list[PlacedPart]:
    """Return the start pose of every part: cars by id, then loads by car, then objects in scan order x, y, z."""
    cars = []
    loads = []
    objects = []
    for number, row in enumerate(grid.cars):
        machine = machines.car(number)
        load = Kind(row[CarField.LOAD])
        heading = yaw_angle(int(row[CarField.YAW]))
        pitch = incline_under(grid, row)
        position = cell_position(*(int(row[f]) for f in (CarField.X, CarField.Y, CarField.Z)))
        position[2] += LEVEL_HEIGHT_M * (0.0, 0.25, -0.25)[row[CarField.SLOPE]]
        turn = _quaternion(heading, pitch)
        raised = load != Kind.AIR
        cars.append(
            PlacedPart("smartcar", position, turn, machine.board_travel_m if raised else 0.0)
        )
        if not raised:
            continue
        back = -math.sin(pitch)
        up = np.array([back * math.cos(heading), back * math.sin(heading), math.cos(pitch)])
        carried = position + lift_m(load, machine, machines) * up
        if load == Kind.FSLOPE:
            # A carried slope faces away from the car's heading, so the same incline lowers its nose.
            turn = _quaternion(yaw_angle(int(row[CarField.LOAD_YAW])), -pitch)
            loads.append(PlacedPart("slope", carried, turn, machines.slope.hinge_range_rad))
        else:
            loads.append(PlacedPart(load.name.lower(), carried, turn))
    for x, y, z in np.argwhere(grid.kind[:, :, 1:]):
        kind = Kind(grid.kind[x, y, z + 1])
        position = cell_position(x, y, z + 1)
        turn = _quaternion(yaw_angle(int(grid.yaw[x, y, z + 1])))
        if kind in TABLES:
            objects.append(PlacedPart(kind.name.lower(), position, turn))
        elif kind in (Kind.FSLOPE, Kind.BODY):
            hinge = 0.0
            if kind == Kind.FSLOPE:
                hinge = machines.slope.hinge_range_rad
            objects.append(PlacedPart("slope", position, turn, hinge))
        elif kind in STANDING:
            raise InputError(
                f"{kind.name} in ({x}, {y}, {z + 1}) has no machine; add it to TABLES in craftsim/mjcf/block.py"
            )
    return cars + loads + objects


def _quaternion(heading: float, pitch_up: float = 0.0) -> NDArray[np.float64]:
    """Turn by ``heading`` about z, then raise the nose by ``pitch_up`` about the body's own y axis."""
    ch = math.cos(heading / 2)
    sh = math.sin(heading / 2)
    cp = math.cos(pitch_up / 2)
    sp = math.sin(pitch_up / 2)
    return np.array([ch * cp, sh * sp, -ch * sp, sh * cp])


def lift_m(load: Kind, car: SmartcarParameters, machines: Machines) -> float:
    """Return how high above its car's origin a load of a kind is carried."""
    underside_m = (machines.slope if load == Kind.FSLOPE else machines.block).underside_m
    return car.board_rest_m + car.board_travel_m - underside_m


def world_spec(
    grid: Grid,
    config: SimulationConfig,
    machines: Machines = NOMINAL,
    goals: Sequence[Cell] = (),
    floor: Floor = FLAT,
    visual: bool = True,
) -> mujoco.MjSpec:
    """Return the spec of a world at its start, of the arguments of a PhysicsWorld, before anything is drawn.

    ``visual`` adds what is only seen, which changes no number. Raises InputError for a floor that is too fine.
    """
    middle, half = ground_pose_and_size(grid.size)
    spec = _floor_spec("site", machines, config, half, middle, visual)
    placed = placements(grid, machines)
    numbers: Counter[str] = Counter()
    for item in placed:
        number = numbers[item.kind]
        if item.kind == "smartcar":
            prefix = f"car{number}/"
        else:
            prefix = f"{item.kind}{number}/"
        _add(spec, item.kind, prefix, (item.position, item.quaternion), machines, number, visual)
        numbers[item.kind] += 1
    if visual:
        for number, goal in enumerate(goals):
            spec.worldbody.add_site(
                name=f"goal{number}",
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=cell_position(*goal) + np.array([0, 0, 0.002]),
                size=[0.45 * CELL_PITCH_M, 0.45 * CELL_PITCH_M, 0.001],
                rgba=[0.25, 0.75, 0.40, 0.45],
            )
        tops = [round(float(placement.position[2]) / LEVEL_HEIGHT_M) + 1 for placement in placed]
        height_m = max([2, *tops, *(goal[2] for goal in goals)]) * LEVEL_HEIGHT_M
        for name, aim_at in (("overview", overview_aim), ("top", top)):
            aim = aim_at(grid.size, height_m, _PICTURE_ASPECT)
            place = {"pos": aim.position, "quat": aim.quaternion}
            spec.worldbody.add_camera(name=name, fovy=aim.fovy_deg, **place)
    if not floor.flat:
        add_tiles(spec, floor, grid.size)
    return spec


def compile_spec(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Return the model of a world, its floor level.

    Raises InputError for parameters of which MuJoCo makes no world, and, naming the joint, where a step takes so much
    of a joint's speed that it could swing up.
    """
    try:
        model: mujoco.MjModel = spec.compile()
    except ValueError as error:
        raise InputError(f"MuJoCo makes no world of these figures: {error}") from error
    model.hfield_data[:] = LEVEL
    share = model.opt.timestep * model.dof_damping / model.dof_M0
    if not (share <= _MOST_DAMPING).all():
        dof = int(share.argmax())
        raise InputError(
            f"the joint {model.joint(model.dof_jntid[dof]).name} is damped by {model.dof_damping[dof]:g}: at most "
            f"{model.dof_damping[dof] * _MOST_DAMPING / share[dof]:.3g} goes with its inertia in physics steps of "
            f"{model.opt.timestep:g} s; enlarge what turns there, or take shorter steps"
        )
    _check_servos(model)
    return model


def _check_servos(model: mujoco.MjModel) -> None:
    """Raise InputError for a motor whose velocity loop is unstable in steps of this length."""
    dofs = model.jnt_dofadr[model.actuator_trnid[:, 0]]
    gains = -model.actuator_biasprm[:, 2]
    shares = model.opt.timestep * gains / model.dof_M0[dofs]
    if (shares < _MOST_SERVO).all():
        return
    motor = int(shares.argmax())
    raise InputError(
        f"the velocity loop of the motor {model.actuator(motor).name} has a gain of {gains[motor]:g}: below "
        f"{gains[motor] * _MOST_SERVO / shares[motor]:.3g} goes with the inertia that it turns, in physics steps of "
        f"{model.opt.timestep:g} s; lower the gain, enlarge that inertia, or take shorter steps"
    )


def machine_spec(kind: str, machines: Machines, visual: bool = True) -> mujoco.MjSpec:
    """Return the spec of one of MACHINES, the first car, on the floor, or of the floor alone."""
    config = SimulationConfig(sleep=False)
    spec = _floor_spec(kind, machines, config, (0.0, 0.0, 0.05), (0.0, 0.0, 0.0), visual)
    _add(spec, kind, "", ORIGIN, machines, 0, visual)
    return spec


def _add(
    spec: mujoco.MjSpec,
    kind: str,
    prefix: str,
    pose: Pose,
    machines: Machines,
    number: int,
    visual: bool,
) -> None:
    """Add one of MACHINES; ``number`` is of the car. The ground is there already."""
    if kind == "smartcar":
        add_car(spec, prefix, pose, machines, number, visual)
    elif kind == "slope":
        add_slope(spec, prefix, pose, machines, visual)
    elif kind in TABLE_NAMES:
        add_block(spec, prefix, pose, machines, kind, visual)


def _floor_spec(
    name: str,
    machines: Machines,
    config: SimulationConfig,
    half: ArrayLike,
    middle: ArrayLike,
    visual: bool,
) -> mujoco.MjSpec:
    """Return the spec of a floor, drawn with half-lengths and a middle, under the settings of a simulation."""
    spec = new_world(machines.contact, half, middle, visual)
    spec.modelname = name
    # Cars apart share no row. Dense, a step takes 10 % longer with tyres, three times as long on rollers.
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    spec.option.timestep = config.timestep_s
    spec.option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{config.solver.upper()}")
    spec.option.iterations = config.solver_iterations
    spec.option.impratio = config.friction_impedance_ratio
    spec.option.sleep_tolerance = config.sleep_tolerance_m_s
    if config.sleep:
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    return spec


def ground_pose_and_size(size: Cell) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return position and half-lengths, (3,) each, in metres, of the floor of an area of this size in cells."""
    length, width, _ = size
    half = [(0.5 * n + _MARGIN_CELLS) * CELL_PITCH_M for n in (length, width)]
    middle = [0.5 * length * CELL_PITCH_M, 0.5 * width * CELL_PITCH_M, 0.0]
    return np.array(middle), np.array([*half, 0.05])


def check_extent(grid: Grid, goals: Sequence[Cell] = ()) -> None:
    """Raise InputError for a world that is too large for physics, or goals outside; StartError for cars in one cell."""
    if not isinstance(grid, Grid):
        raise InputError(
            f"a world is made of a Grid, not of a {type(grid).__name__}; read_blueprint(name).grid(rng) returns one"
        )
    loads = int((grid.cars[:, CarField.LOAD] != Kind.AIR).sum())
    parts = grid.n_cars + loads + int(np.isin(grid.kind, STANDING).sum())
    length, width, height = grid.size
    for number, allowed, counted in (
        (grid.n_cars, PHYSICS_CARS, "cars"),
        (
            parts,
            PHYSICS_PARTS,
            "parts, which are cars, loads, blocks, slopes, flags and walls together",
        ),
        (len(goals), PHYSICS_GOALS, "marked goals"),
    ):
        if number > allowed:
            raise InputError(
                f"a world of {number} {counted}: too large for physics; allowed: at most {allowed}. "
                "The grid alone takes it"
            )
    places = Counter(
        (x, y, z) for x, y, z in grid.cars[:, [CarField.X, CarField.Y, CarField.Z]].tolist()
    )
    for cell, cars in places.items():
        if cars > 1:
            raise StartError(f"this world cannot be: {cars} cars are in one cell, {cell}")
    for goal in goals:
        if not all(0 <= c < n for c, n in zip(goal, (length, width, height + 2), strict=True)):
            raise InputError(f"the goal {goal} is outside of the area of {grid.size} cells")
