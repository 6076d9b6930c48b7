"""The Site: one world of cars, blocks and slopes, compiled and running in MuJoCo.

A Site is composed from a Grid. After a reset the only thing that changes it is ``mj_step`` under motor commands.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from craftsim.discrete.geometry import CELL_PITCH_M, cell_position
from craftsim.discrete.grid import Grid, Kind
from craftsim.models.config import SimulationConfig
from craftsim.models.parts import Car, FreeBody, Slope, load_car, load_part, load_slope
from craftsim.models.placement import Placement, placements

_SLEEP = int(mujoco.mjtEnableBit.mjENBL_SLEEP)
_STAY_AWAKE = int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER)
_MAY_SLEEP = int(mujoco.mjtSleepPolicy.mjSLEEP_ALLOWED)

GoalCells = Sequence[tuple[int, int, int]]


class Site:
    """A compiled world with typed handles of its parts.

    ``cars`` are in the order of car ids; ``blocks``, ``flags`` and ``slopes`` in the order of :func:`placements`.
    ``model`` and ``data`` are MuJoCo's own, to look at; commands go through :meth:`drive`, :meth:`move_board` and
    :meth:`turn_hinge`.
    """

    def __init__(self, grid: Grid, config: SimulationConfig | None = None, goals: GoalCells = ()) -> None:
        """Compose, compile and reset the world of a grid; ``goals`` are cells that get a marker without contact."""
        self.config = config or SimulationConfig()
        self.size = grid.size
        self._placements = placements(grid)
        self.walls = np.argwhere(grid.kind == Kind.WALL)
        spec, names = _compose(grid, self._placements, self.config, goals)
        self.model: mujoco.MjModel = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.cars = tuple(Car.find(self.model, n) for n in names["smartcar"])
        self.slopes = tuple(Slope.find(self.model, n) for n in names["slope"])
        self.blocks = tuple(FreeBody.find(self.model, n + "block") for n in names["block"])
        self.flags = tuple(FreeBody.find(self.model, n + "flag") for n in names["flag"])
        self.reset()

    def reset(self) -> None:
        """Put everything back to its start, and let it come to rest for ``config.settle_s`` with all motors at zero."""
        mujoco.mj_resetData(self.model, self.data)
        joints: dict[str, list[float]] = {"smartcar": [], "slope": []}
        for placed in self._placements:
            if placed.kind in joints:
                joints[placed.kind].append(placed.joint)
        drives = [car.board for car in self.cars] + [slope.hinge for slope in self.slopes]
        for drive, position in zip(drives, joints["smartcar"] + joints["slope"], strict=True):
            self.data.qpos[drive.qpos] = position
            self.data.act[drive.activation] = position
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_step(self.model, self.data, round(self.config.settle_s / self.config.timestep_s))

    @property
    def time_s(self) -> float:
        """Simulated time since the reset."""
        return float(self.data.time)

    def drive(self, car: int, wheel_speeds: ArrayLike) -> None:
        """Command the four wheels of a car, in rad/s, in the order of WHEELS; the servo clips to its own limits."""
        self.data.ctrl[self.cars[car].wheel_actuators] = wheel_speeds

    def move_board(self, car: int, speed: float) -> None:
        """Command the speed of a car's board in m/s, up positive."""
        self.data.ctrl[self.cars[car].board.actuator] = speed

    def turn_hinge(self, slope: int, speed: float) -> None:
        """Command the speed of a slope's hinge in rad/s, folding positive."""
        self.data.ctrl[self.slopes[slope].hinge.actuator] = speed

    def advance(self) -> None:
        """Run one control period of physics under the commands that stand."""
        if self.config.sleep and self._rouse():
            # MuJoCo does not wake a tree because its motor is commanded; one step with sleep switched off does.
            self.model.opt.enableflags &= ~_SLEEP
            mujoco.mj_step(self.model, self.data)
            self.model.opt.enableflags |= _SLEEP
            if self.config.steps_per_period > 1:
                mujoco.mj_step(self.model, self.data, self.config.steps_per_period - 1)
        else:
            mujoco.mj_step(self.model, self.data, self.config.steps_per_period)

    def free_body_state(self, body: FreeBody) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return copies of a body's position (3,) in metres and unit quaternion (4,), w first, in the world frame."""
        pose = self.data.qpos[body.qpos : body.qpos + 7].copy()
        return pose[:3], pose[3:]

    def _rouse(self) -> bool:
        """Keep commanded trees awake, let the others sleep; return whether a commanded one is asleep."""
        asleep = False
        for part in (*self.cars, *self.slopes):
            actuators = part.motors
            busy = bool(np.any(self.data.ctrl[actuators]))
            self.model.tree_sleep_policy[part.base.tree] = _STAY_AWAKE if busy else _MAY_SLEEP
            asleep |= busy and self.data.tree_asleep[part.base.tree] >= 0
        return asleep


def _compose(
    grid: Grid, placed: list[Placement], config: SimulationConfig, goals: GoalCells
) -> tuple[mujoco.MjSpec, dict[str, list[str]]]:
    """Attach every part to the ground; return the spec and the name prefixes by kind of part."""
    spec = load_part("ground")
    names: dict[str, list[str]] = {"smartcar": [], "block": [], "flag": [], "slope": [], "wall": []}
    for item in placed:
        index = len(names[item.kind])
        prefix = f"{'car' if item.kind == 'smartcar' else item.kind}{index}/"
        names[item.kind].append(prefix)
        match item.kind:
            case "smartcar":
                part = load_car(index)
            case "slope":
                part = load_slope()
            case _:
                part = load_part(item.kind)
        frame = spec.worldbody.add_frame(pos=item.position, quat=item.quaternion)
        frame.attach_body(part.body(item.kind), prefix, "")
    for i, (x, y, z) in enumerate(goals):
        spec.worldbody.add_site(
            name=f"goal{i}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=cell_position(x, y, z) + np.array([0, 0, 0.002]),
            size=[0.45 * CELL_PITCH_M, 0.45 * CELL_PITCH_M, 0.001],
            rgba=[0.25, 0.75, 0.40, 0.45],
        )
    _configure(spec, grid, config)
    return spec, names


def _configure(spec: mujoco.MjSpec, grid: Grid, config: SimulationConfig) -> None:
    spec.modelname = "site"
    spec.option.timestep = config.timestep_s
    spec.option.impratio = config.friction_impedance_ratio
    spec.option.sleep_tolerance = config.sleep_tolerance_m_s
    if config.sleep:
        spec.option.enableflags |= _SLEEP
    length, width, _ = grid.size
    ground = spec.geom("ground")
    margin = 1.0
    ground.size = [(0.5 * length + margin) * CELL_PITCH_M, (0.5 * width + margin) * CELL_PITCH_M, 0.05]
    ground.pos = [0.5 * length * CELL_PITCH_M, 0.5 * width * CELL_PITCH_M, 0.0]
