"""How hard the wheels of the reduced drive can push: by their grip, from the load that each of them carries.

Wheels without rollers do not touch the floor with friction; their motors push the car as if they did. A mecanum wheel
holds the ground along its roller's axis, at 45 degrees to its way, with a force of at most the friction coefficient
times its load N: no more of its motor's torque than mu N R / sqrt(2), less what the gear takes, reaches the ground. The
loads are those of the last physics step, and the limits hold for one control period.

Where the floor is uneven, or the wheels are not equal, they hold for one physics step, and of the four loads those
three parts count that equilibrium gives: their sum, and how it lies along the car and across. The fourth, how a stiff
car leans on one diagonal or the other, is left out: rollers, which rattle, share it out (docs/imperfections.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled
from craftsim.mjcf.reduced import WholeCar
from craftsim.models.parts import WHEELS, Car


class Grip:
    """The limits of the wheel motors of all cars of a compiled model with the reduced drive."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        cars: Sequence[Car],
        uneven: bool = False,
    ) -> None:
        """Take the motors' own limits as they are in the model now; ``uneven`` where wheels may come off the ground."""
        self._model, self._data = model, data
        self.limits = model.actuator_forcerange.copy()
        """(nu, 2): the motors' own."""
        prefixes = [model.body(car.base.body).name.rpartition("/")[0] + "/" for car in cars]
        geoms = np.array([model.geom(prefix + wheel).id for prefix in prefixes for wheel in WHEELS], np.int32)
        wheel = np.full(model.ngeom, -1, np.int32)
        wheel[geoms] = np.arange(len(geoms))
        gears = [model.actuator(p + w.replace("wheel", "gear")).id for p in prefixes for w in WHEELS]
        motors = np.array([motor for car in cars for motor in car.wheel_actuators], np.intp)
        radii = np.repeat([car.parameters.wheel_radius_m for car in cars], len(WHEELS))
        spin = np.repeat([WholeCar.of(car.parameters).spin_kgm2 for car in cars], len(WHEELS))
        self._arrays = (
            *(model.actuator_forcerange, self.limits),
            *(data.actuator_force, data.tree_asleep, data.qacc, data.xmat),
            # By geom its wheel, counted over all cars, or -1; by wheel its motors.
            *(wheel, motors, np.array(gears, np.intp)),
            np.repeat([car.base.tree for car in cars], len(WHEELS)),
            # By wheel: the torque that a newton of load lets it pass on.
            model.geom_friction[geoms, 0] * radii / math.sqrt(2),
            # By wheel: the torque that an acceleration of the car, in its own frame, takes to turn wheel and motor.
            spin[:, None] * model.actuator_gear[motors],
            np.repeat([car.base.dof for car in cars], len(WHEELS)),
            np.repeat([car.base.body for car in cars], len(WHEELS)),
            np.zeros(len(geoms)),
            uneven,
        )

    def begin(self) -> None:
        """Give the motors their own limits."""
        self._model.actuator_forcerange[:] = self.limits

    def limit(self) -> None:
        """Limit all motors for what their wheels carry now; of cars that sleep, the loads of which MuJoCo leaves out,
        not at all, so that limits depend on the state alone."""
        # Copies are laid out the same way however many contacts there are.
        contact = self._data.contact
        geoms, addresses = np.ascontiguousarray(contact.geom), np.ascontiguousarray(contact.efc_address)
        _limit(geoms, addresses, self._data.efc_force, *self._arrays)


@compiled
def _limit(
    geoms: NDArray[np.int32],
    addresses: NDArray[np.int32],
    forces: NDArray[np.float64],
    forcerange: NDArray[np.float64],
    limits: NDArray[np.float64],
    motor_forces: NDArray[np.float64],
    asleep: NDArray[np.int32],
    qacc: NDArray[np.float64],
    xmat: NDArray[np.float64],
    wheel_of: NDArray[np.int32],
    motors: NDArray[np.intp],
    gears: NDArray[np.intp],
    trees: NDArray[np.int64],
    nm_per_n: NDArray[np.float64],
    inertia: NDArray[np.float64],
    dofs: NDArray[np.int64],
    bodies: NDArray[np.int64],
    load: NDArray[np.float64],
    uneven: bool,
) -> None:
    for wheel in range(len(load)):
        load[wheel] = 0.0
    for contact in range(len(geoms)):
        if addresses[contact] < 0:
            continue
        for side in range(2):
            wheel = wheel_of[geoms[contact, side]]
            if wheel >= 0:
                load[wheel] += forces[addresses[contact]]
    for first in range(0, len(load) if uneven else 0, 4):
        twist = (load[first] - load[first + 1] - load[first + 2] + load[first + 3]) / 4
        for wheel, sign in ((first, -1), (first + 1, 1), (first + 2, 1), (first + 3, -1)):
            load[wheel] = max(0.0, load[wheel] + sign * twist)
    for wheel in range(len(motors)):
        motor, most = motors[wheel], load[wheel] * nm_per_n[wheel]
        low, high = limits[motor]
        if asleep[trees[wheel]] >= 0:
            forcerange[motor] = low, high
            continue
        friction, spin = motor_forces[gears[wheel]], 0.0
        for axis in range(2):
            for world in range(3):
                spin += (
                    inertia[wheel, axis] * xmat[bodies[wheel], 3 * world + axis] * qacc[dofs[wheel] + world]
                )
        spin += inertia[wheel, 5] * qacc[dofs[wheel] + 5]
        forcerange[motor, 0] = min(max(-most - friction + min(spin, 0.0), low), high)
        forcerange[motor, 1] = min(max(most - friction + max(spin, 0.0), low), high)
