"""The machines of a compiled world: handles of their bodies, joints and motors, and which stand in each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kinds import CARRIED, Kind
from craftsim.mjcf.block import TABLE_NAMES
from craftsim.mjcf.building import GROUND
from craftsim.mjcf.car import WHEELS
from craftsim.mjcf.parameters import Machines, SmartcarParameters
from craftsim.models.floor import tiles_body

WALL: Final = "wall"
ALLOWED_M: Final = 1e-3
"""How deep things may stand in each other at a start: more than a drawing is inexact by."""


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
        added, lever = self.parameters.spin_mass_kg, self.parameters.turn_radius_m
        armature = (added, added, 0.0, 0.0, 0.0, added * lever**2)
        model.dof_armature[self.base.dof : self.base.dof + 6] = armature


@dataclass(frozen=True)
class Slope:
    """Handles of one foldable slope: its base and the hinge of its flap."""

    base: FreeBody
    hinge: Drive

    @classmethod
    def find(cls, model: mujoco.MjModel, prefix: str) -> Slope:
        """Return the handles of the slope attached under this prefix."""
        return cls(FreeBody.find(model, prefix + "slope"), Drive.find(model, prefix + "hinge"))


def parts_of(
    model: mujoco.MjModel, machines: Machines
) -> tuple[tuple[Car, ...], tuple[Slope, ...], dict[Kind, tuple[FreeBody, ...]]]:
    """Return a model's cars, slopes, and by kind blocks, flags, and what else has a block's shape and is carried."""
    names = [model.body(body).name for body in range(model.nbody)]

    def prefixes(kind: str) -> list[str]:
        return [name.removesuffix(kind) for name in names if name.endswith(f"/{kind}")]

    cars = tuple(Car.find(model, name, machines.car(i)) for i, name in enumerate(prefixes("smartcar")))
    slopes = tuple(Slope.find(model, name) for name in prefixes("slope"))
    tables = {
        kind: tuple(FreeBody.find(model, prefix + name) for prefix in prefixes(name))
        for name, kind in TABLE_NAMES.items()
        if kind in CARRIED
    }
    return cars, slopes, tables


@dataclass(frozen=True)
class MachineNames:
    """The machines of a compiled world."""

    names: tuple[str, ...]
    """Such as ``car 0``: of what is fixed first, then of those that move in the order of their bodies."""
    roots: tuple[int, ...]
    """The bodies of those that move."""
    of_geom: NDArray[np.intp]
    """By geom: its machine's place in ``names``."""

    @classmethod
    def of(cls, model: mujoco.MjModel) -> MachineNames:
        """Return the machines of a model."""
        free = int(mujoco.mjtJoint.mjJNT_FREE)
        roots = tuple(int(body) for body in model.jnt_bodyid[model.jnt_type == free])
        number = {0: 0, tiles_body(model): 0} | {body: i + 2 for i, body in enumerate(roots)}
        root = model.body_rootid[model.geom_bodyid].tolist()
        machine = [number.get(body, 1) for body in root]
        names = (GROUND, WALL, *(_name(model.body(body).name) for body in roots))
        return cls(names, roots, np.array(machine, np.intp))


@dataclass(frozen=True)
class Overlap:
    """Two machines that stand in each other."""

    first: str
    """Name of a machine, such as ``car 0``, ``block 3``, ``slope 1``, ``flag 0``, ``wall`` or ``ground``."""
    second: str
    depth_m: float

    def __str__(self) -> str:
        return f"{self.first} and {self.second} stand {1e3 * self.depth_m:.1f} mm in each other"


def overlaps(machines: MachineNames, data: mujoco.MjData) -> Iterator[Overlap]:
    """Yield what stands more than :data:`ALLOWED_M` in something else, each pair once; all must be awake."""
    contact = data.contact
    pairs = np.sort(machines.of_geom[contact.geom], axis=1)
    deepest: dict[tuple[int, int], float] = {}
    for (a, b), distance in zip(pairs.tolist(), contact.dist.tolist(), strict=True):
        if a != b and -distance > max(ALLOWED_M, deepest.get((a, b), 0.0)):
            deepest[a, b] = -distance
    for (a, b), depth in sorted(deepest.items()):
        yield Overlap(machines.names[a], machines.names[b], depth)


def _name(body: str) -> str:
    """Return a machine's name for people: ``car 0`` for the body ``car0/smartcar``."""
    prefix = body.split("/", 1)[0]
    word = prefix.rstrip("0123456789")
    return f"{word} {prefix[len(word) :]}"
