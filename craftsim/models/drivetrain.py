"""What wheel motors, gears and batteries lack, written into a model's motors and gears after each physics step.

- The most torque of a motor that drives falls in proportion to its speed, by ``torque_slope`` at its top speed (the
  torque-speed line of a DC motor); a motor that brakes has all of its torque.
- A battery sags in proportion to the torque that the four motors of its car drive with: that line falls, all of it.
- Of a motor's torque its gear takes ``gear_loss`` while the motor drives, and adds as much while it brakes. At rest the
  gear's dry friction alone holds.
- In its backlash a gear passes nothing on, friction neither. Its motor then turns as commanded, less what the gear's
  friction makes of that, and takes up the play.

Torques and speeds are those as the last physics step began; grip, of the reduced drive, takes up what a motor has left
once in a control period. Of the backlash is left out that the rotor turns by itself: its inertia stays with the wheel,
so teeth meet without an impact, and a play ends with a physics step. MuJoCo's DC motor has a torque-speed line of its
own, but takes a voltage; the wheels' servos take a speed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled
from craftsim.models.imperfection import Drivetrain
from craftsim.models.parts import WHEELS, Car

_TINY_NM = 1e-9
_SLOW_RAD_S = 0.1
"""Below this speed a gear's loss falls to 0, which it is at rest: it would otherwise turn over with the speed."""


class Drivetrains:
    """Those of all cars of a compiled model, none of them ideal."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        cars: Sequence[Car],
        lacks: Drivetrain,
        limits: NDArray[np.float64],
    ) -> None:
        """Take motors and gears as they are in the model now; ``limits``, (nu, 2), get what the motors have left."""
        self.lacks, self._data = lacks, data
        motors = np.array([motor for car in cars for motor in car.wheel_actuators], np.intp)
        gears = np.array([dof for car in cars for dof in car.wheel_dofs], np.intp)
        friction, dry_nm = model.dof_frictionloss.reshape(-1, 1), model.dof_frictionloss[gears]
        if bristles := not len(gears):
            # The gears of the reduced drive are motors without power; what they pass on is in proportion to their gear.
            names = [model.actuator(motor).name.replace("wheel", "gear") for motor in motors]
            gears = np.array([model.actuator(name).id for name in names], np.intp)
            friction, dry_nm = model.actuator_gear, model.actuator_biasprm[gears, 3]
        gains, biases = model.actuator_gainprm, model.actuator_biasprm
        changed = ((limits, motors), (gains, motors), (biases, motors), (friction, gears))
        self._figures = [(array, rows, array[rows]) for array, rows in changed]
        self.played = np.zeros(len(motors))
        """By wheel: the angle that its gear has gone through its backlash, forwards."""
        self._arrays = (
            *(data.ctrl, data.actuator_force, data.actuator_velocity, data.tree_asleep),
            *(limits, gains, biases, friction, limits[motors], gains[motors, 0]),
            *(model.actuator_ctrlrange[motors], friction[gears], dry_nm, self.played),
            *(motors, gears, np.repeat([car.base.tree for car in cars], len(WHEELS))),
            *(lacks.torque_slope, lacks.gear_loss, lacks.backlash_rad, lacks.sag, bristles),
        )
        self.start()

    def start(self, played: NDArray[np.float64] | None = None) -> None:
        """Go on from a state, with all gears in the middle of their backlash unless it says where they are."""
        self.played[:] = self.lacks.backlash_rad / 2 if played is None else played
        self._last_s = self._data.time

    def show(self) -> None:
        """Put the own figures of motors and gears into the model."""
        for array, rows, own in self._figures:
            array[rows] = own

    def follow(self) -> None:
        """Let motors and gears be as the state leaves them; plays go on for the time since the last call."""
        elapsed_s, self._last_s = self._data.time - self._last_s, self._data.time
        _follow(elapsed_s, *self._arrays)


@compiled
def _follow(
    elapsed_s: float,
    ctrl: NDArray[np.float64],
    forces: NDArray[np.float64],
    speeds: NDArray[np.float64],
    asleep: NDArray[np.int32],
    limits: NDArray[np.float64],
    gains: NDArray[np.float64],
    biases: NDArray[np.float64],
    friction: NDArray[np.float64],
    own_limits: NDArray[np.float64],
    own_gains: NDArray[np.float64],
    ranges: NDArray[np.float64],
    own_friction: NDArray[np.float64],
    dry_nm: NDArray[np.float64],
    played: NDArray[np.float64],
    motors: NDArray[np.intp],
    gears: NDArray[np.intp],
    trees: NDArray[np.int64],
    torque_slope: float,
    gear_loss: float,
    backlash: float,
    sag: float,
    bristles: bool,
) -> None:
    voltage = 1.0
    for wheel in range(len(motors)):
        motor, awake = motors[wheel], asleep[trees[wheel]] < 0
        if wheel % 4 == 0:
            voltage = 1.0
            for other in range(wheel, wheel + 4):
                torque = forces[motors[other]] if awake else 0.0
                drives = torque * speeds[motors[other]] >= 0.0
                share = abs(torque) / max(own_limits[other, 1], _TINY_NM)
                voltage -= sag / 4 * min(share, 1.0) if drives else 0.0
        speed = speeds[motor] if awake else 0.0
        low, high = own_limits[wheel]
        slowest, fastest = ranges[wheel]
        low *= max(voltage - torque_slope * max(speed / slowest, 0.0), 0.0)
        high *= max(voltage - torque_slope * max(speed / fastest, 0.0), 0.0)
        taken = gear_loss * min(max(speed / _SLOW_RAD_S, -1.0), 1.0)
        told = min(max(ctrl[motor], slowest), fastest)
        gain, engaged = own_gains[wheel], True
        if backlash > 0.0:
            # In the play the gear's friction alone is before the servo.
            turns = math.copysign(max(abs(told) - dry_nm[wheel] / gain, 0.0), told)
            passed = forces[motor] + forces[gears[wheel]] if bristles else 0.0
            # By how far the motor turns more than the wheel.
            way = elapsed_s * (turns - speed)
            # One that stands, and whose friction is still strained by what the wheel has passed to it, does not let go.
            strained_ahead = played[wheel] == backlash and way < 0.0 and passed > 0.0 and turns >= 0.0
            strained_back = played[wheel] == 0.0 and way > 0.0 and passed < 0.0 and turns <= 0.0
            if not (strained_ahead or strained_back):
                played[wheel] = min(max(played[wheel] + way, 0.0), backlash)
            engaged = played[wheel] == 0.0 or played[wheel] == backlash
        gain *= (1 - taken if told > speed else 1 + taken) if engaged else 0.0
        gains[motor, 0], biases[motor, 2] = gain, -gain
        limits[motor, 0], limits[motor, 1] = low * (1 + taken), high * (1 - taken)
        for k in range(friction.shape[1]):
            friction[gears[wheel], k] = own_friction[wheel, k] if engaged else 0.0
