"""Domain randomization: how far a real machine may be from its nominal figures, drawn from a seed, applied in place."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.errors import InputError
from craftsim.models.floor import lay, tiles_body
from craftsim.models.imperfection import AS_DRAWN, FLAT, IDEAL, Drivetrain, Floor, Making, check_shares
from craftsim.models.making import make
from craftsim.models.noise import EXACT, SensorNoise
from craftsim.models.overlaps import Overlap
from craftsim.models.site import Site, SiteState


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


@dataclass(frozen=True)
class Nominal:
    """The figures of a compiled model that randomization changes, as they were compiled."""

    geom_friction: NDArray[np.float64]
    body_mass: NDArray[np.float64]
    body_inertia: NDArray[np.float64]
    actuator_forcerange: NDArray[np.float64]
    actuator_gainprm: NDArray[np.float64]
    actuator_biasprm: NDArray[np.float64]
    dof_frictionloss: NDArray[np.float64]
    dof_damping: NDArray[np.float64]
    actuator_gear: NDArray[np.float64]
    body_pos: NDArray[np.float64]
    body_quat: NDArray[np.float64]
    geom_pos: NDArray[np.float64]
    geom_size: NDArray[np.float64]
    hfield_data: NDArray[np.float32]
    gravity: NDArray[np.float64]

    @classmethod
    def of(cls, site: Site) -> Nominal:
        """Return copies of the figures of a Site."""
        site.show_figures()
        found = cls(**{name: array.copy() for name, array in cls._arrays(site.model).items()})
        site.follow()
        return found

    def write(self, model: mujoco.MjModel) -> None:
        """Put the figures back into a model."""
        for name, array in self._arrays(model).items():
            array[:] = getattr(self, name)

    @classmethod
    def _arrays(cls, model: mujoco.MjModel) -> dict[str, NDArray[Any]]:
        """Return the model's own arrays by field name."""
        return {f.name: getattr(model.opt if f.name == "gravity" else model, f.name) for f in fields(cls)}


@dataclass(frozen=True)
class _Rested:
    """A start that has come to rest at nominal physics."""

    state: SiteState
    overlaps: tuple[Overlap, ...]


KEPT: Final = 4
"""Starts at rest that a process keeps, those used last: 1 MB each, and address space for more."""


@lru_cache(maxsize=KEPT)
def _kept(start: Hashable) -> list[_Rested]:
    """Return where what belongs to a start is kept: an empty list, the first time."""
    return []


class RandomizedSite:
    """A Site whose physics can be drawn anew, again and again, without compiling it again."""

    def __init__(self, site: Site, start: Hashable = None) -> None:
        """Remember the nominal figures of a Site.

        ``start`` is all that decides the world of a Site that is as it was composed: what comes to rest once is then
        shared by all of that start.
        """
        self.site = site
        self._nominal = Nominal.of(site)
        self._material = self._materials()
        self._is_nominal = False
        """Whether the physics is nominal, with all that follows from it; the first restore or draw sees to that."""
        self._rested: list[_Rested] = [] if start is None else _kept(start)

    def restore(self) -> None:
        """Go back to the nominal physics, ideal motors and gears, and to the start, as a reset leaves it."""
        self.site.set_drivetrain(IDEAL)
        self.site.show_figures()
        self._nominal.write(self.site.model)
        self.site.lift_m, self.site.uneven = 0.0, False
        if not self._is_nominal:
            self._follow()
            self._is_nominal = True
        if self._rested:
            rested = self._rested[0]
            self.site.restore(rested.state)
            self.site.overlaps = rested.overlaps
            return
        self.site.reset()
        self._rested.append(_Rested(self.site.save(), self.site.overlaps))

    def draw(self, randomization: DomainRandomization, rng: np.random.Generator) -> None:
        """Draw new physics around the nominal one and reset the Site; equal generators give equal physics.

        Motors and gears come to rest as ideal ones: what they lack is set afterwards.

        Raises InputError for a floor that the Site was not composed with.
        """
        model, tiles = self.site.model, self.site.tiles
        if (tiles.floor if tiles else None) != (None if randomization.floor.flat else randomization.floor):
            raise InputError("the floor that is drawn must be that of the Site: Site(..., floor=...)")
        self.site.set_drivetrain(IDEAL)
        self.site.show_figures()
        self._nominal.write(model)
        self._is_nominal = False

        def factors(width: float, count: int) -> NDArray[np.float64]:
            return rng.uniform(1 - width, 1 + width, count)

        tree = np.where(model.body_rootid > 0, model.body_rootid, 0)
        mass = factors(randomization.mass, model.nbody)[tree]
        model.body_mass[:] *= mass
        model.body_inertia[:] *= mass[:, None]
        model.geom_friction[:, 0] *= factors(randomization.friction, model.ngeom)[self._material]
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
        down = np.array(
            [math.sin(tilt) * math.cos(towards), math.sin(tilt) * math.sin(towards), -math.cos(tilt)]
        )
        model.opt.gravity[:] = float(np.linalg.norm(self._nominal.gravity)) * down
        self.site.lift_m = 0.0
        if tiles or not randomization.making.exact:
            # Generators of their own: what is drawn of one does not depend on what else is drawn.
            surface, workshop = rng.spawn(2)
            self.site.lift_m = lay(model, tiles, surface) if tiles else 0.0
            make(self.site, randomization.making, workshop)
        self.site.uneven = tiles is not None or randomization.making.wheel_radius_m > 0
        self._follow()
        self.site.reset()

    def _materials(self) -> NDArray[np.intp]:
        """Return (n,): for each geom the first one of its material, which one machine and one friction make."""
        model = self.site.model
        root = model.body_rootid[model.geom_bodyid]
        root = np.where(root == tiles_body(model), 0, root)
        surfaces = np.column_stack([root, model.geom_friction[:, 0]])
        _, first, material = np.unique(surfaces, axis=0, return_index=True, return_inverse=True)
        found: NDArray[np.intp] = first[material.reshape(-1)]
        return found

    def _follow(self) -> None:
        """Work out what follows from the figures."""
        model = self.site.model
        # MuJoCo keeps a pair's friction as it was compiled; as at any contact, the rougher of the two decides.
        sliding = model.geom_friction[:, 0]
        rougher = np.maximum(sliding[model.pair_geom1], sliding[model.pair_geom2])
        model.pair_friction[:, :2] = rougher[:, None]
        mujoco.mj_setConst(self.site.model, self.site.data)
        self.site.take_figures()
