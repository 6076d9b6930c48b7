"""Domain randomization: how far a real machine may be from its nominal figures, drawn from a seed, applied in place."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.errors import InputError
from craftsim.models.site import Site, SiteState


@dataclass(frozen=True)
class DomainRandomization:
    """Half-widths of the uniform distributions from which a Site's physics is drawn; hashable.

    All are fractions of the nominal figure but the tilt. Raises InputError for a figure outside [0, 1).

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

    def __post_init__(self) -> None:
        for field in fields(self):
            if not 0 <= getattr(self, field.name) < 1:
                raise InputError(
                    f"DomainRandomization.{field.name} must be at least 0 and below 1, not {getattr(self, field.name)}"
                )


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
    gravity: NDArray[np.float64]

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Nominal:
        """Return copies of a model's figures."""
        return cls(**{name: array.copy() for name, array in cls._arrays(model).items()})

    def write(self, model: mujoco.MjModel) -> None:
        """Put the figures back into a model."""
        for name, array in self._arrays(model).items():
            array[:] = getattr(self, name)

    @classmethod
    def _arrays(cls, model: mujoco.MjModel) -> dict[str, NDArray[np.float64]]:
        """Return the model's own arrays by field name."""
        return {f.name: getattr(model.opt if f.name == "gravity" else model, f.name) for f in fields(cls)}


class RandomizedSite:
    """A Site whose physics can be drawn anew, again and again, without compiling it again."""

    def __init__(self, site: Site) -> None:
        """Remember the nominal figures of a Site."""
        self.site = site
        self._nominal = Nominal.of(site.model)
        self._is_nominal = True
        self._rested: SiteState | None = None

    def restore(self) -> None:
        """Go back to the nominal physics and to the start, as a reset leaves it."""
        if self._rested is not None and self._is_nominal:
            self.site.restore(self._rested)
            return
        self._nominal.write(self.site.model)
        self._is_nominal = True
        self._refresh()
        self._rested = self.site.save()

    def draw(self, randomization: DomainRandomization, rng: np.random.Generator) -> None:
        """Draw new physics around the nominal one and reset the Site; equal generators give equal physics."""
        model = self.site.model
        self._nominal.write(model)
        self._is_nominal = False

        def factors(width: float, count: int) -> NDArray[np.float64]:
            return rng.uniform(1 - width, 1 + width, count)

        tree = np.where(model.body_rootid > 0, model.body_rootid, 0)
        mass = factors(randomization.mass, model.nbody)[tree]
        model.body_mass[:] *= mass
        model.body_inertia[:] *= mass[:, None]
        model.geom_friction[:, 0] *= self._by_material(factors(randomization.friction, model.ngeom))
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
        self._refresh()

    def _by_material(self, factors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return one factor a geom, the same for all geoms of one machine that had one friction: one material."""
        model = self.site.model
        first: dict[tuple[int, float], int] = {}
        index = [
            first.setdefault(
                (int(model.body_rootid[model.geom_bodyid[g]]), float(model.geom_friction[g, 0])), g
            )
            for g in range(model.ngeom)
        ]
        return factors[index]

    def _refresh(self) -> None:
        model = self.site.model
        # MuJoCo keeps a pair's friction as it was compiled; as at any contact, the rougher of the two decides.
        sliding = model.geom_friction[:, 0]
        rougher = np.maximum(sliding[model.pair_geom1], sliding[model.pair_geom2])
        model.pair_friction[:, :2] = rougher[:, None]
        mujoco.mj_setConst(self.site.model, self.site.data)
        self.site.take_figures()
        self.site.reset()
