"""How hard machines can press on each other: what counts as a blow, and what only an unsolved contact explains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.models.parameters import NOMINAL, ContactParameters, Machines
from craftsim.models.world import Site
from craftsim.skills.state import GRAVITY

_REACH_M: Final = 1.5 * CELL_PITCH_M
"""How far any part of a machine is from the middle of the machine at most: that of a flap's tip."""


@lru_cache(maxsize=16)
def impact_limit_n(machines: Machines = NOMINAL) -> float:
    """Return how hard two machines may press on each other, in newtons; 461 N for the nominal ones.

    The heaviest loaded car weighs W = 112 N, and its wheel motors push with F = 202 N at most. The weight acts down and
    the wheels push along the ground, so both together are sqrt(W^2 + F^2) = 231 N. What is put on at once loads a stiff
    contact up to twice as much as it does at rest: 461 N. More can only come from the motion of something that is
    stopped: a blow.
    """
    load = max(machines.block.mass_kg, machines.slope.mass_kg)
    return max(
        2 * math.hypot((car.mass_kg + load) * GRAVITY, 4 * car.wheel_torque_nm / car.wheel_radius_m)
        for car in machines.cars
    )


def stopping_ratio(contact: ContactParameters, timestep_s: float) -> float:
    """Return the speed that a contact takes from a thing in one step, by the speed at which it came.

    MuJoCo's contact is a spring and damper per unit of mass, b = 2 / (d T) and k = 1 / (d T z)^2, of time constant T,
    damping ratio z and largest impedance d (its documentation, "Solver parameters"). At a depth of one step's way it
    takes b v h + k v h^2 in a step of length h: 1.27 v with the nominal figures.
    """
    step = timestep_s / (contact.impedance_max * contact.time_constant_s)
    return 2 * step + (step / contact.damping_ratio) ** 2


class PossibleForce:
    """The largest force between two machines that weights, motors and motion account for.

    A force is passed on along machines that touch, so all of one island count. Weights, wheels, boards and hinges, the
    last by the lever of the gear, load a contact up to twice as much when they are put on at once. What moves has its
    momentum to lose, and loses it over one physics step at least: m v / h, times :func:`stopping_ratio`. A solver that
    has not converged knows none of these limits, and forces above are its doing.
    """

    def __init__(self, site: Site, roots: Sequence[int]) -> None:
        """Take masses and motors of a Site as they are drawn; ``roots`` are the bodies of its machines."""
        self._site = site
        model = site.model
        self._mass = model.body_subtreemass[list(roots)]
        self._dof = np.array([model.body_dofadr[root] for root in roots], np.intp)
        self._tree = model.dof_treeid[self._dof]
        at_tree = {int(tree): i for i, tree in enumerate(self._tree)}
        self._rest = GRAVITY * self._mass
        limit = model.actuator_forcerange[:, 1]
        for car in site.cars:
            wheels = limit[car.wheel_actuators].sum() / car.parameters.wheel_radius_m
            self._rest[at_tree[car.base.tree]] += wheels + limit[car.board.actuator]
        for slope in site.slopes:
            self._rest[at_tree[slope.base.tree]] += (
                limit[slope.hinge.actuator] / site.machines.slope.gear_radius_m
            )
        self._per_momentum = (
            stopping_ratio(site.machines.contact, site.config.timestep_s) / site.config.timestep_s
        )

    def newtons(self, machines: Sequence[int]) -> float:
        """Return the largest possible force in the last step between machines, by their place in ``roots``."""
        data, step = self._site.data, self._site.config.timestep_s
        islands = data.tree_island[self._tree]
        touching = np.isin(islands, islands[list(machines)])
        dofs = self._dof[touching, None] + np.arange(6)
        speed = data.qvel[dofs] - step * data.qacc[dofs]  # before the step
        motion = np.linalg.norm(speed[:, :3], axis=1) + _REACH_M * np.linalg.norm(speed[:, 3:], axis=1)
        rest, momentum = self._rest[touching].sum(), (self._mass[touching] * motion).sum()
        return float(2 * rest + self._per_momentum * momentum)
