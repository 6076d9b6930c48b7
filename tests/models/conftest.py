"""Instruments that the physics tests share: a lone car on a tilting plane, a ramp, a bisection, MuJoCo's warnings."""

import math
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid, Kind
from craftsim.mjcf.car import ACROSS
from craftsim.mjcf.drives import DRIVES
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.config import SimulationConfig
from craftsim.models.wheel_contacts import tyres_of
from craftsim.models.world import PhysicsWorld

GRAVITY = 9.81


def part(name: str) -> mujoco.MjModel:
    """Open one MJCF file as a person would in the viewer: alone, from its path."""
    return mujoco.MjModel.from_xml_path(str(files("craftsim.mjcf") / f"{name}.xml"))


def warnings(data: mujoco.MjData) -> dict[str, int]:
    """Return the warnings that MuJoCo has counted, by name."""
    names = list(mujoco.mjtWarning.__members__)
    return {name: int(data.warning[i].number) for i, name in enumerate(names[: len(data.warning)])}


class LoneCar:
    """One car on an endless plane that tilts: gravity turns instead, which is the same.

    What a test makes of ``baseline`` holds from the next :meth:`rest` on.
    """

    def __init__(self, drive: str, timestep_s: float = 0.004) -> None:
        machines, config = replace(NOMINAL, drive=drive), SimulationConfig(timestep_s, sleep=False)
        self.physics = PhysicsWorld(Grid.empty((12, 12, 1), 1), config, machines=machines)
        self.model, self.data, self.car = (
            self.physics.model,
            self.physics.data,
            self.physics.cars[0],
        )
        self.baseline = self.physics.baseline.copy()
        self.drive = drive
        self.motors, self.wheels = self.car.wheel_actuators, self.car.wheel_dofs
        rollers = [j for j in range(self.model.njnt) if "/roller_" in self.model.joint(j).name]
        self.rollers = self.model.jnt_dofadr[rollers]
        self.tyres = tyres_of(self.model)

    def set_gears(self, friction_nm: float) -> None:
        """Give the gears another dry friction."""
        self.baseline.dof_frictionloss[self.wheels] = friction_nm

    def oil_rollers(self) -> None:
        """Take the friction of the rollers' bearings away."""
        self.baseline.dof_frictionloss[self.rollers] = 0
        if len(self.tyres):
            self.baseline.geom_user[self.tyres, ACROSS] = 1e-5

    def brake_rollers(self, friction: float) -> None:
        """Let no roller turn; ``friction`` is that of its surface."""
        self.baseline.dof_frictionloss[self.rollers] = 50.0
        if len(self.tyres):
            self.baseline.geom_user[self.tyres, ACROSS] = friction

    def unpower(self) -> None:
        """Take the wheel motors away: no torque at all, not even the servo's damping, and no friction of gears."""
        self.baseline.actuator_gainprm[self.motors] = self.baseline.actuator_biasprm[
            self.motors
        ] = 0
        self.set_gears(0.0)

    def limit(self, torque_nm: float) -> None:
        """Let the wheel motors give no more than this."""
        self.baseline.actuator_forcerange[self.motors] = [-torque_nm, torque_nm]

    def tilt(self, angle: float, downhill: float = math.pi) -> None:
        """Tilt the plane; downhill is the direction (rad from the car's nose) in which it falls."""
        s, c = GRAVITY * math.sin(angle), GRAVITY * math.cos(angle)
        self.model.opt.gravity[:] = s * math.cos(downhill), s * math.sin(downhill), -c

    def rest(self) -> None:
        """Start over, and come to rest on the level plane."""
        self.physics.set_baseline(self.baseline)
        self.physics.reset()

    def run(
        self, seconds: float, speeds: object = None, observe: Callable[[], None] | None = None
    ) -> None:
        """Run whole control periods, with the wheels' speeds in rad/s, or those that stand."""
        if speeds is not None:
            self.physics.drive(0, speeds)
        for _ in range(round(seconds / 0.02)):
            self.physics.advance(observe)

    @property
    def position(self) -> NDArray[np.float64]:
        return self.data.qpos[:3].copy()

    @property
    def heading(self) -> float:
        w, x, y, z = self.data.qpos[3:7]
        return math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))

    @property
    def up(self) -> float:
        """The z component of the car's own z axis."""
        return 1 - 2 * float(self.data.qpos[4] ** 2 + self.data.qpos[5] ** 2)

    @property
    def speed(self) -> float:
        return float(np.linalg.norm(self.data.qvel[:3]))

    @property
    def twist(self) -> NDArray[np.float64]:
        """Forward, left and turn, in the car's frame."""
        turn = self.data.body("car0/smartcar").xmat.reshape(3, 3)
        return np.array([*(turn.T @ self.data.qvel[:3])[:2], self.data.qvel[5]])


def _threshold(happens: Callable[[float], bool], low: float, high: float, steps: int = 9) -> float:
    """Bisect for the least value at which something happens that does not happen at ``low`` but does at ``high``."""
    assert not happens(low)
    assert happens(high)
    for _ in range(steps):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if happens(middle) else (middle, high)
    return 0.5 * (low + high)


def _ramp(state: int, load: Kind = Kind.AIR, yaw: int = 2) -> Grid:
    """Return a ramp that falls in +x from a block at (1, 1), with one car before it, on it (1 low, 2 high) or above it.

    The car faces uphill with yaw 2 and downhill with yaw 0.
    """
    grid = Grid.empty((5, 3, 3), 1)
    grid.kind[1, 1, 1] = Kind.BLOCK
    grid.kind[2, 1, 1] = Kind.BODY
    grid.kind[3, 1, 1] = Kind.FOOT
    x, z, slope = [(4, 1, 0), (3, 1, 1), (2, 2, 2), (1, 2, 0)][state]
    grid.cars[0] = x, 1, z, yaw, load, (yaw + 2) % 4 if load == Kind.FSLOPE else 0, slope
    grid.derive_marks()
    return grid


@pytest.fixture(params=DRIVES)
def lone_car(request) -> LoneCar:
    return LoneCar(request.param)


@pytest.fixture
def make_car() -> Callable[[str], LoneCar]:
    return LoneCar


@pytest.fixture(scope="session")
def open_part() -> Callable[[str], mujoco.MjModel]:
    return part


@pytest.fixture(scope="session")
def warned() -> Callable[[mujoco.MjData], dict[str, int]]:
    return warnings


@pytest.fixture(scope="session")
def threshold() -> Callable[..., float]:
    return _threshold


@pytest.fixture(scope="session")
def ramp() -> Callable[..., Grid]:
    return _ramp
