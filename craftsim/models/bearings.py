"""The dry friction of the rollers' bearings, in force where a roller touches something or is about to.

MuJoCo solves a row for each joint with dry friction, and of a car's forty rollers four to eight touch at a time. One
that touches nothing has 1e-6 kg m^2 and no force to pass on: whether its bearing is dry or not, the car feels nothing
of it, and its grease stops it within a tenth of a second. So such a roller turns on its grease alone. The friction is
there before it touches: MuJoCo lists what comes within the rollers' gap of 0.2 mm as a contact without force. Which
rollers have it follows from the contacts of the last step, which are part of the state.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled

ROLLERS = 2
"""The bit by which a roller collides: its contype (craftsim/mjcf/templates/smartcar.xml)."""


class Bearings:
    """The bearings of all rollers of a compiled model.

    Who steps such a model calls :meth:`follow` after each ``mj_step``; who does not has dry friction in all of them.

    Example:
        >>> import mujoco
        >>> from importlib.resources import as_file, files
        >>> with as_file(files("craftsim.mjcf")) as folder:
        ...     model = mujoco.MjModel.from_xml_path(str(folder / "smartcar.xml"))
        >>> data, bearings = mujoco.MjData(model), Bearings(model)
        >>> for _ in range(10):
        ...     mujoco.mj_step(model, data)
        ...     bearings.follow(data)
        >>> bool(4 <= (model.dof_frictionloss == 0.004).sum() <= 8)
        True
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Take the friction of the bearings as it is in the model now."""
        self._friction = model.dof_frictionloss
        geoms = np.flatnonzero(model.geom_contype == ROLLERS)
        self._dofs = model.body_dofadr[model.geom_bodyid[geoms]].astype(np.intp)
        self._trees = model.dof_treeid[self._dofs].astype(np.intp)
        self._roller = np.full(model.ngeom, -1, np.int32)
        self._roller[geoms] = np.arange(len(geoms))
        """By geom: its roller, counted over all cars, or -1."""
        self._dry = self._friction[self._dofs]
        """By roller, in Nm."""
        self._shown = True

    def show(self) -> None:
        """Put the friction of all bearings into the model."""
        self._friction[self._dofs] = self._dry
        self._shown = True

    def take(self) -> None:
        """Take the friction over from the model, where it stands since it was shown."""
        if self._shown:
            self._dry = self._friction[self._dofs]

    def follow(self, data: mujoco.MjData) -> None:
        """Let the bearings have friction whose rollers touched something in the last step, or were about to.

        Of cars that sleep, whose contacts MuJoCo leaves out, all have it.
        """
        _follow(
            self._friction,
            self._dry,
            # A copy is laid out the same way however many there are.
            np.ascontiguousarray(data.contact.geom),
            data.tree_asleep,
            *(self._roller, self._dofs, self._trees),
        )
        self._shown = False


@compiled
def _follow(
    friction: NDArray[np.float64],
    dry: NDArray[np.float64],
    geoms: NDArray[np.int32],
    asleep: NDArray[np.int32],
    roller_of: NDArray[np.int32],
    dofs: NDArray[np.intp],
    trees: NDArray[np.intp],
) -> None:
    for roller in range(len(dofs)):
        friction[dofs[roller]] = dry[roller] if asleep[trees[roller]] >= 0 else 0.0
    for contact in range(len(geoms)):
        for side in range(2):
            roller = roller_of[geoms[contact, side]]
            if roller >= 0:
                friction[dofs[roller]] = dry[roller]
