"""Domain randomization: how far a real machine may be from its nominal figures, drawn from a seed, applied in place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.errors import InputError
from craftsim.models.floor import lay, tiles_body
from craftsim.models.imperfection import AS_DRAWN, FLAT, IDEAL, Drivetrain, Floor, Making, check_shares
from craftsim.models.making import make
from craftsim.models.sensing import EXACT, SensorNoise
from craftsim.models.world import Baseline, Site


@dataclass(frozen=True)
class DomainRandomization:
    """How far a world is from the ideal one, as distributions from which a seed draws; hashable.

    Those of the physics are half-widths of uniform distributions, all of them fractions of the nominal figure but the
    tilt. Raises InputError for a figure outside [0, 1).

    Example:
        >>> import craftsim
        >>> craftsim.DomainRandomization(friction=0.1, tilt_rad=0.0).mass
        0.2
    """

    friction: float = 0.30
    """Of every contact surface, drawn for each machine and each of its materials."""
    mass: float = 0.20
    """Masses and inertias, drawn for each machine."""
    motor: float = 0.15
    """Torque and force limits and servo gains, drawn for each motor."""
    joint_friction: float = 0.50
    """Dry friction and damping of gears, rollers, boards and hinges, drawn for each joint."""
    tilt_rad: float = math.radians(0.5)
    """Largest tilt of the floor, in a direction that is drawn uniformly."""
    floor: Floor = FLAT
    drivetrain: Drivetrain = IDEAL
    making: Making = AS_DRAWN
    sensors: SensorNoise = EXACT
    """Of the cars' sensors and motors: what the world does, whatever the cars assume of it."""

    def __post_init__(self) -> None:
        check_shares(self)

    @property
    def nominal(self) -> bool:
        """Whether the physics is the nominal one, so that nothing of it is drawn; sensors and motors aside."""
        drawn = self.friction or self.mass or self.motor or self.joint_friction or self.tilt_rad
        return not drawn and self.floor.flat and self.making.exact


NONE: Final = DomainRandomization(0.0, 0.0, 0.0, 0.0, 0.0)
"""The nominal physics, exact sensors and ideal motors."""


def randomize(site: Site, randomization: DomainRandomization, rng: np.random.Generator) -> None:
    """Draw new physics around that of a Site as it was compiled, and reset it; equal generators give equal physics.

    Motors and gears come to rest as ideal ones: what they lack is set afterwards.

    Raises InputError for a floor that the Site was not composed with.
    """
    model, tiles = site.model, site.tiles
    if (tiles.floor if tiles else None) != (None if randomization.floor.flat else randomization.floor):
        raise InputError("the floor that is drawn must be that of the Site: Site(..., floor=...)")
    site.compiled.write(model)

    def factors(width: float, count: int) -> NDArray[np.float64]:
        return rng.uniform(1 - width, 1 + width, count)

    tree = np.where(model.body_rootid > 0, model.body_rootid, 0)
    mass = factors(randomization.mass, model.nbody)[tree]
    model.body_mass[:] *= mass
    model.body_inertia[:] *= mass[:, None]
    model.geom_friction[:, 0] *= factors(randomization.friction, model.ngeom)[_materials(site)]
    motor = factors(randomization.motor, model.nu)
    model.actuator_forcerange[:] *= motor[:, None]
    model.actuator_gainprm[:, 0] *= motor
    gears = model.actuator_biastype == mujoco.mjtBias.mjBIAS_DCMOTOR
    model.actuator_biasprm[~gears, 1:] *= motor[~gears, None]
    friction = factors(randomization.joint_friction, model.nv)
    model.dof_frictionloss[:] *= friction
    model.dof_damping[:] *= friction
    # Coulomb and static friction of the reduced drive's gears.
    model.actuator_biasprm[gears, 3:5] *= factors(randomization.joint_friction, int(gears.sum()))[:, None]
    tilt, towards = randomization.tilt_rad * math.sqrt(rng.uniform()), rng.uniform(0, math.tau)
    down = np.array([math.sin(tilt) * math.cos(towards), math.sin(tilt) * math.sin(towards), -math.cos(tilt)])
    model.opt.gravity[:] = float(np.linalg.norm(model.opt.gravity)) * down
    lift_m = 0.0
    if tiles or not randomization.making.exact:
        # Generators of their own: what is drawn of one does not depend on what else is drawn.
        surface, workshop = rng.spawn(2)
        lift_m = lay(model, tiles, surface) if tiles else 0.0
        make(site, randomization.making, workshop)
    site.drivetrain = IDEAL
    site.set_baseline(
        Baseline.of(model), tiles is not None or randomization.making.wheel_radius_m > 0, lift_m
    )
    site.reset()


def _materials(site: Site) -> NDArray[np.intp]:
    """Return (n,): for each geom the first one of its material, which one machine and one friction make."""
    model = site.model
    root = model.body_rootid[model.geom_bodyid]
    root = np.where(root == tiles_body(model), 0, root)
    surfaces = np.column_stack([root, site.compiled.geom_friction[:, 0]])
    _, first, material = np.unique(surfaces, axis=0, return_index=True, return_inverse=True)
    found: NDArray[np.intp] = first[material.reshape(-1)]
    return found
