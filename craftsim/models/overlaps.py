"""Machines by their geoms, and which of them stand in each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.mjcf.building import GROUND
from craftsim.models.floor import tiles_body

WALL: Final = "wall"
ALLOWED_M: Final = 1e-3
"""How deep things may stand in each other at a start: more than a drawing is inexact by."""


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
