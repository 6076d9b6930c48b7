"""The machines of a compiled world: handles of their bodies, joints and motors, and which stand in each other."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kinds import CARRIED, Kind
from craftsim.mjcf.block import TABLE_NAMES
from craftsim.mjcf.building import GROUND
from craftsim.mjcf.car import WHEELS
from craftsim.mjcf.machines import Machines
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.floor import tiles_body

WALL: Final = "wall"
ALLOWED_M: Final = 1e-3
"""How deep things may stand in each other at a start: more than a drawing is inexact by."""


@dataclass(frozen=True)
class Joint:
    """Places of a joint of a machine, its body and its motor in the arrays of MjData."""

    name: str
    body: int
    tree: int
    qpos: int
    """Address of its position; of a free joint the seven numbers x, y, z and a unit quaternion (w, x, y, z)."""
    dof: int
    """Address of its velocity; of a free joint six numbers."""
    actuator: int = -1
    """Its motor, -1 for none."""
    activation: int = -1
    """Address of the position that a motor holds in MjData.act, -1 for a pure speed servo."""

    @classmethod
    def find(cls, model: mujoco.MjModel, name: str) -> Joint:
        """Return the handle of the joint of this full name; its motor bears the same name."""
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        actuator = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
        dof = int(model.jnt_dofadr[joint])
        qpos = int(model.jnt_qposadr[joint])
        activation = -1
        if actuator >= 0:
            activation = int(model.actuator_actadr[actuator])
        body = int(model.jnt_bodyid[joint])
        tree = int(model.dof_treeid[dof])
        return cls(name, body, tree, qpos, dof, actuator, activation)


@dataclass(frozen=True)
class Car:
    """One smartcar: its parameters, and handles of its body, its board and its wheels, in the order of WHEELS."""

    parameters: SmartcarParameters
    base: Joint
    board: Joint
    wheel_actuators: NDArray[np.intp]
    wheel_dofs: NDArray[np.intp]


@dataclass(frozen=True)
class Slope:
    """Handles of one foldable slope: its base and the hinge of its flap."""

    base: Joint
    hinge: Joint


Parts = tuple[tuple[Car, ...], tuple[Slope, ...], dict[Kind, tuple[Joint, ...]]]


def parts_of(model: mujoco.MjModel, machines: Machines) -> Parts:
    """Return a model's cars, slopes, and by kind blocks, flags, and what else has a block's shape and is carried."""
    bases: dict[str, list[Joint]] = {}
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        base = Joint.find(model, model.joint(joint).name)
        bases.setdefault(base.name.partition("/")[2], []).append(base)
    cars = []
    for number, base in enumerate(bases.get("smartcar", ())):
        prefix = base.name.removesuffix("smartcar")
        motors = [model.actuator(prefix + wheel).id for wheel in WHEELS]
        dofs = [model.joint(prefix + wheel).dofadr[0] for wheel in WHEELS]
        board = Joint.find(model, f"{prefix}board")
        wheels = np.array(motors, np.intp), np.array(dofs, np.intp)
        cars.append(Car(machines.car(number), base, board, *wheels))
    hinges = [base.name.removesuffix("slope") + "hinge" for base in bases.get("slope", ())]
    slopes = tuple(
        map(Slope, bases.get("slope", ()), (Joint.find(model, hinge) for hinge in hinges))
    )
    tables = {
        kind: tuple(bases.get(name, ())) for name, kind in TABLE_NAMES.items() if kind in CARRIED
    }
    return tuple(cars), slopes, tables


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
        # "car 0" for the body "car0/smartcar".
        words = [re.match(r"(\D+)(\d*)/", model.body(body).name) for body in roots]
        names = (GROUND, WALL, *(" ".join(word.groups()) for word in words if word))
        return cls(names, roots, np.array(machine, np.intp))


def overlaps(machines: MachineNames, data: mujoco.MjData) -> tuple[str, ...]:
    """Return sentences of what stands more than :data:`ALLOWED_M` in something else, by pairs; all must be awake."""
    contact = data.contact
    pairs = np.sort(machines.of_geom[contact.geom], axis=1)
    deepest: dict[tuple[int, int], float] = {}
    for (a, b), distance in zip(pairs.tolist(), contact.dist.tolist(), strict=True):
        if a != b and -distance > max(ALLOWED_M, deepest.get((a, b), 0.0)):
            deepest[a, b] = -distance
    names = machines.names
    sentences = []
    for (a, b), depth in sorted(deepest.items()):
        sentences.append(f"{names[a]} and {names[b]} stand {1e3 * depth:.1f} mm in each other")
    return tuple(sentences)
