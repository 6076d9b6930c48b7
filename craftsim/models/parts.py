"""The parts of a world: loading their MJCF and finding their joints and motors in a compiled model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.drawing import CAR_COLOURS, car_colour
from craftsim.mjcf.meshes import Figures, mesh_bytes, mesh_file
from craftsim.mjcf.parameters import Machines, SmartcarParameters
from craftsim.mjcf.reduced import WholeCar
from craftsim.mjcf.rendering import render

WHEELS = ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")
"""Order of everything that is given per wheel: front left, front right, rear left, rear right."""


def load_part(name: str, machines: Machines, car: int = 0) -> mujoco.MjSpec:
    """Return the editable spec of a part: smartcar, block, slope, flag, wall or ground.

    All but the ground come without the floor that their files show them on. The spec holds its meshes as assets, which
    whoever attaches it has to hand on to the world. A smartcar has the colour of car number ``car``; it and a slope may
    sleep when idle, unlike other trees with motors.
    """
    return shared_part(name, machines, car).copy()


def shared_part(name: str, machines: Machines, car: int = 0) -> mujoco.MjSpec:
    """Return the same spec as :func:`load_part`, to attach copies of and not to be changed: it is read once."""
    return _part(name, machines, _figures(name, machines, car), car % len(CAR_COLOURS))


@lru_cache(maxsize=64)
def _part(name: str, machines: Machines, figures: Figures | None, colour: int) -> mujoco.MjSpec:
    meshes = {} if figures is None else mesh_bytes(figures)
    spec = mujoco.MjSpec.from_string(_text(name, machines, figures), assets=meshes)
    if name == "smartcar":
        spec.geom("chassis_visual").rgba = [*car_colour(colour), 1.0]
    if name in ("smartcar", "slope"):
        spec.body(name).sleep = mujoco.mjtSleepPolicy.mjSLEEP_ALLOWED
    return spec


def _figures(name: str, machines: Machines, car: int) -> Figures | None:
    match name:
        case "ground":
            return None
        case "smartcar":
            return machines.car(car)
        case "slope":
            return machines.slope
    return machines.block


def _text(name: str, machines: Machines, figures: Figures | None) -> str:
    car = figures if isinstance(figures, SmartcarParameters) else None

    def file(mesh: str) -> str:
        assert figures is not None
        return mesh_file(figures, mesh)

    return render(name, machines, car, alone=False, mesh=file)


@dataclass(frozen=True)
class FreeBody:
    """Where a free body's state lies in the arrays of MjData."""

    name: str
    body: int
    tree: int
    qpos: int
    """Address of the seven position numbers: x, y, z and a unit quaternion (w, x, y, z)."""
    dof: int
    """Address of the six velocity numbers."""

    @classmethod
    def find(cls, model: mujoco.MjModel, name: str) -> FreeBody:
        """Return the handle of the body of this full name."""
        body = model.body(name).id
        joint = model.body_jntadr[body]
        dof = int(model.jnt_dofadr[joint])
        return cls(name, body, int(model.dof_treeid[dof]), int(model.jnt_qposadr[joint]), dof)


@dataclass(frozen=True)
class Drive:
    """A motor and the joint that it turns or slides."""

    actuator: int
    qpos: int
    dof: int
    activation: int
    """Address of the drive's held position in MjData.act, or -1 for a pure speed servo."""

    @classmethod
    def find(cls, model: mujoco.MjModel, name: str) -> Drive:
        """Return the handle of the actuator of this full name; its joint bears the same name."""
        actuator = model.actuator(name).id
        joint = model.joint(name).id
        return cls(
            actuator,
            int(model.jnt_qposadr[joint]),
            int(model.jnt_dofadr[joint]),
            int(model.actuator_actadr[actuator]),
        )


def trees_of_motors(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the kinematic tree (nu,) that each motor moves."""
    bodies = [
        model.jnt_bodyid[target] if kind == mujoco.mjtTrn.mjTRN_JOINT else model.site_bodyid[target]
        for kind, target in zip(model.actuator_trntype, model.actuator_trnid[:, 0], strict=True)
    ]
    roots = model.body_rootid[np.array(bodies, np.intp)]
    return model.dof_treeid[model.body_dofadr[roots]].astype(np.intp)


@dataclass(frozen=True)
class Car:
    """One smartcar: its figures, and handles of its body, its wheel drives (in the order of WHEELS) and its board."""

    parameters: SmartcarParameters
    base: FreeBody
    board: Drive
    wheel_actuators: NDArray[np.intp]
    wheel_dofs: NDArray[np.intp]
    """Empty for the reduced drive, whose wheels do not turn."""

    @classmethod
    def find(cls, model: mujoco.MjModel, prefix: str, parameters: SmartcarParameters) -> Car:
        """Return the smartcar of these figures that is attached under this prefix."""
        wheels = [model.actuator(prefix + wheel) for wheel in WHEELS]
        on_axles = wheels[0].trntype[0] == mujoco.mjtTrn.mjTRN_JOINT
        dofs = [model.joint(prefix + wheel).dofadr[0] for wheel in WHEELS] if on_axles else []
        return cls(
            parameters,
            FreeBody.find(model, prefix + "smartcar"),
            Drive.find(model, prefix + "board"),
            np.array([wheel.id for wheel in wheels], np.intp),
            np.array(dofs, np.intp),
        )

    def add_spin(self, model: mujoco.MjModel) -> None:
        """Let a car with the reduced drive be as heavy to speed up as its wheels and motors make it.

        MJCF has one armature for all six directions of a free joint, and the wheels' spin has none along z.
        """
        model.dof_armature[self.base.dof : self.base.dof + 6] = WholeCar.of(self.parameters).armature


@dataclass(frozen=True)
class Slope:
    """Handles of one foldable slope: its base and the hinge of its flap."""

    base: FreeBody
    hinge: Drive

    @classmethod
    def find(cls, model: mujoco.MjModel, prefix: str) -> Slope:
        """Return the handles of the slope attached under this prefix."""
        return cls(FreeBody.find(model, prefix + "slope"), Drive.find(model, prefix + "hinge"))
