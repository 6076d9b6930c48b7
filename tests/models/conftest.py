"""Instruments that the physics tests share: a lone car on a tilting plane, a ramp, a bisection, MuJoCo's warnings."""

import math
from collections.abc import Callable
from importlib.resources import files

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from craftsim.discrete.grid import Grid, Kind
from craftsim.mjcf.car import WHEELS
from craftsim.models.effects import Bearings
from craftsim.models.world import Baseline

GRAVITY = 9.81


def part(name: str) -> mujoco.MjModel:
    """Open one MJCF file as a person would in the viewer: alone, from its path."""
    return mujoco.MjModel.from_xml_path(str(files("craftsim.mjcf") / f"{name}.xml"))


def warnings(data: mujoco.MjData) -> dict[str, int]:
    """Return the warnings that MuJoCo has counted, by name."""
    names = list(mujoco.mjtWarning.__members__)
    return {name: int(data.warning[i].number) for i, name in enumerate(names[: len(data.warning)])}


class LoneCar:
    """One smartcar on an endless plane that tilts: gravity turns instead, which is the same."""

    def __init__(self) -> None:
        self.model = part("smartcar")
        self.data = mujoco.MjData(self.model)
        self.motors = [self.model.actuator(w).id for w in WHEELS]
        self.wheels = [int(self.model.joint(w).dofadr[0]) for w in WHEELS]
        self.wheel_angles = [int(self.model.joint(w).qposadr[0]) for w in WHEELS]
        rollers = [j for j in range(self.model.njnt) if self.model.joint(j).name.startswith("roller")]
        self.rollers = self.model.jnt_dofadr[rollers]

    @property
    def mass(self) -> float:
        return float(self.model.body_mass.sum())

    def unpower(self) -> None:
        """Take the wheel motors away: no torque at all, not even the servo's damping."""
        self.model.actuator_gainprm[self.motors] = 0
        self.model.actuator_biasprm[self.motors] = 0

    def oil(self) -> None:
        """Take the dry friction of gears and rollers away."""
        self.model.dof_frictionloss[self.wheels] = 0
        self.model.dof_frictionloss[self.rollers] = 0

    def tilt(self, angle: float, downhill: float = math.pi) -> None:
        """Tilt the plane; downhill is the direction (rad from the car's nose) in which it falls."""
        s, c = GRAVITY * math.sin(angle), GRAVITY * math.cos(angle)
        self.model.opt.gravity[:] = s * math.cos(downhill), s * math.sin(downhill), -c

    def rest(self) -> None:
        """Start over, and come to rest on the level plane."""
        mujoco.mj_resetData(self.model, self.data)
        self.tilt(0)
        self.run(0.4)

    def run(self, seconds: float) -> None:
        """Step as a PhysicsWorld does; the figures in the model stay what a test has made of them."""
        self.baseline = Baseline.of(self.model)
        bearings = Bearings(self)
        bearings.start(self)
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)
            bearings.after_step(self)
        self.baseline.write(self.model)

    def drive(self, speeds: object) -> None:
        self.data.ctrl[self.motors] = speeds

    @property
    def position(self) -> NDArray[np.float64]:
        return self.data.qpos[:3].copy()

    @property
    def heading(self) -> float:
        w, x, y, z = self.data.qpos[3:7]
        return math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))

    @property
    def speed(self) -> float:
        return float(np.linalg.norm(self.data.qvel[:3]))

    @property
    def angles(self) -> NDArray[np.float64]:
        return self.data.qpos[self.wheel_angles].copy()


def _threshold(happens: Callable[[float], bool], low: float, high: float, steps: int = 12) -> float:
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


@pytest.fixture
def lone_car() -> LoneCar:
    return LoneCar()


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
