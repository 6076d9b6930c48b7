"""How hard the wheels of the reduced drive can push: by their grip, from the load that each of them carries.

Wheels without rollers do not touch the floor with friction; their motors push the car as if they did. A mecanum wheel
holds the ground along its roller's axis, at 45 degrees to its way, with a force of at most the friction coefficient
times its load N: no more of its motor's torque than mu N R / sqrt(2), less what the gear takes, reaches the ground. The
loads are those of the last physics step, and the limits hold for one control period, where wheels come
off an uneven floor, or are not equal, for one physics step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.compiled import compiled
from craftsim.mjcf.reduced import WholeCar
from craftsim.models.parts import WHEELS, Car

TREAD_S: Final = 0.05
"""Time constant of the wheels' contacts with an uneven floor, or of unequal wheels with any. Assumed: each gives way by
0.17 mm under a quarter of the car, 150 kN/m, as a thin rubber tread does. As stiff as on a plane, the car would stand
on two or three wheels and drift sideways by ten times what it does on rollers (docs/imperfections.md)."""
SUNK_M: Final = 0.00017
"""By so much the wheels then stand lower in the car, which keeps its height."""


def sink(model: mujoco.MjModel, cars: Sequence[Car]) -> None:
    """Put the wheels of all cars so much lower as their tread gives way."""
    model.geom_pos[_wheels(model, cars), 2] -= SUNK_M


def _wheels(model: mujoco.MjModel, cars: Sequence[Car]) -> NDArray[np.int32]:
    """Return the geoms that stand for the wheels of all cars, car by car."""
    names = [f"{prefix}{wheel}" for prefix in _prefixes(model, cars) for wheel in WHEELS]
    return np.array([model.geom(name).id for name in names], np.int32)


def _prefixes(model: mujoco.MjModel, cars: Sequence[Car]) -> list[str]:
    return [model.body(car.base.body).name.rpartition("/")[0] + "/" for car in cars]


class Grip:
    """The limits of the wheel motors of all cars of a compiled model with the reduced drive."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        cars: Sequence[Car],
        ground: NDArray[np.bool_] | None = None,
    ) -> None:
        """Take the motors' own limits as they are in the model now.

        With ``ground``, which says of each geom whether it is of an uneven floor, wheels have a tread there.
        """
        self._model, self._data = model, data
        self.limits = model.actuator_forcerange.copy()
        """(nu, 2): the motors' own."""
        prefixes, geoms = _prefixes(model, cars), _wheels(model, cars)
        wheel = np.full(model.ngeom, -1, np.int32)
        wheel[geoms] = np.arange(len(geoms))
        gears = [model.actuator(p + w.replace("wheel", "gear")).id for p in prefixes for w in WHEELS]
        motors = np.array([motor for car in cars for motor in car.wheel_actuators], np.intp)
        self._tread = None
        if ground is not None:
            self._tread = (wheel, geoms, ground, model.geom_solref[geoms, 0].copy(), model.geom_solref)
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
        )

    def begin(self) -> None:
        """Give the motors their own limits, and the wheels their tread."""
        self._model.actuator_forcerange[:] = self.limits
        if self._tread is not None:
            _tread(np.empty((0, 2), np.int32), *self._tread)

    def limit(self) -> None:
        """Limit all motors for what their wheels carry now; of cars that sleep, the loads of which MuJoCo leaves out,
        not at all, so that limits depend on the state alone."""
        contact = self._data.contact
        if self._tread is not None:
            _tread(contact.geom, *self._tread)
        _limit(contact.geom, contact.efc_address, self._data.efc_force, *self._arrays)


@compiled
def _tread(
    geoms: NDArray[np.int32],
    wheel_of: NDArray[np.int32],
    wheels: NDArray[np.int32],
    ground: NDArray[np.bool_],
    stiffness: NDArray[np.float64],
    solref: NDArray[np.float64],
) -> None:
    """Let wheels have their tread but where they touch something else: into what is light they would sink."""
    for wheel in range(len(wheels)):
        solref[wheels[wheel], 0] = TREAD_S
    for contact in range(len(geoms)):
        for side in range(2):
            wheel = wheel_of[geoms[contact, side]]
            if wheel >= 0 and not ground[geoms[contact, 1 - side]]:
                solref[wheels[wheel], 0] = stiffness[wheel]


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
