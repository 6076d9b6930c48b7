"""The parameters of a compiled model that randomization and effects change."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, Final

import mujoco
from numpy.typing import NDArray

_VARIED: Final = (
    "geom_friction",
    "geom_user",
    "geom_pos",
    "geom_size",
    "body_mass",
    "body_inertia",
    "body_pos",
    "body_quat",
    "actuator_forcerange",
    "actuator_gainprm",
    "actuator_biasprm",
    "actuator_gear",
    "dof_frictionloss",
    "dof_damping",
    "hfield_data",
)


class Baseline(SimpleNamespace):
    """Parameters of a model that randomization and tests change, without what effects make of them; MuJoCo's names."""

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Baseline:
        """Return copies of the parameters of a model."""
        return cls(**_varied(model)).copy()

    def write(self, model: mujoco.MjModel) -> None:
        """Put the parameters into a model."""
        for name, array in _varied(model).items():
            array[:] = getattr(self, name)

    def copy(self) -> Baseline:
        """Return a copy, to be changed."""
        return Baseline(**{name: array.copy() for name, array in vars(self).items()})


def _varied(model: mujoco.MjModel) -> dict[str, NDArray[Any]]:
    arrays = {name: getattr(model, name) for name in _VARIED}
    arrays["gravity"] = model.opt.gravity
    return arrays
