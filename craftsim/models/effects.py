"""Effects that change a model's parameters while its world runs: rollers' bearings, drivetrains.

MuJoCo has no elements for these. Each is a :class:`StepEffect`, which writes model parameters between physics steps,
worked out from the world's baseline and its state, and never a position, a speed or a force.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Final, Protocol

import mujoco
import numpy as np

from craftsim.compiled.arrays import Arrays, Floats, Ints, Records
from craftsim.compiled.jit import Record, compiled, layout, records
from craftsim.mjcf.building import TOUCHES
from craftsim.mjcf.machines import Machines
from craftsim.models.baseline import Baseline
from craftsim.models.config import Amount
from craftsim.models.parts import WHEELS, Car
from craftsim.storage.records import record
from craftsim.workers.copying import NotCopyable

ROLLERS: Final = TOUCHES["wheels"]["contype"]
"""The bit by which a roller collides: its contype."""
_TINY_NM: Final = 1e-9
_SLOW_RAD_S: Final = 0.1
"""Below this speed a gear's loss falls to 0, which it is at rest: it would otherwise turn over with the speed."""


WHEEL: Final = layout(
    i8="motor gear tree",
    f8="slowest fastest own_low own_high own_gain dry_nm played",
)
"""A wheel, its motor and its gear: where they and their car lie in MuJoCo's arrays, and the range of commanded speeds.

``own_`` are parameters of the baseline. ``dry_nm`` is the gear's dry friction, ``played`` the angle gone through its
backlash, forwards.
"""


@record()
class Drivetrain:
    """Shortcomings of wheel motors and gears; hashable. Raises InputError for a figure outside [0, 1)."""

    torque_slope: Amount = 0.0
    """Share of a driving motor's largest torque that is lost at its top speed, in proportion to the speed."""
    gear_loss: Amount = 0.0
    """Share of a driving motor's torque that the gear takes, on top of its dry friction; it helps a brake as much."""
    backlash_rad: Amount = 0.0
    """Angle by which the gear leaves the wheel free when the torque changes its sign."""
    sag: Amount = 0.0
    """Share of the largest torque, of that at standstill, that is lost at any speed when all motors of a car drive with
    all they have: the battery's voltage drops."""


IDEAL: Final = Drivetrain()
"""Motors and gears that lack nothing."""


class EffectWorld(Protocol):
    """A world as effects see it: a :class:`craftsim.models.world.PhysicsWorld`."""

    model: mujoco.MjModel
    data: mujoco.MjData
    baseline: Baseline
    cars: tuple[Car, ...]
    machines: Machines


class StepEffect(NotCopyable):
    """Something that changes parameters of a world's model; a new one is made for each baseline, and in each copy."""

    _instead = "copy its PhysicsWorld"

    state: Floats = np.zeros(0)
    """State beyond that of MuJoCo; saved and restored with it."""

    def start(self, world: EffectWorld) -> None:
        """Begin without a past: the model's parameters are the baseline's."""

    def after_step(self, world: EffectWorld) -> None:
        """Act after a physics step, and after a saved state was restored."""


def effects_of(world: EffectWorld, drivetrain: Drivetrain) -> list[StepEffect]:
    """Return the effects of a world with its present baseline, in their order."""
    effects: list[StepEffect] = []
    if drivetrain != IDEAL:
        effects.append(DrivetrainLosses(world, _wheels(world), drivetrain))
    if world.machines.drive == "rollers":
        effects.append(Bearings(world))
    return effects


def _wheels(world: EffectWorld) -> Records:
    """Return the wheels of all cars, (4 n,) of WHEEL, in the order of WHEELS."""
    model = world.model
    baseline = world.baseline
    cars = world.cars
    wheels = records(4 * len(cars), WHEEL)
    motors = np.array([car.wheel_actuators for car in cars], np.intp).ravel()
    wheels["tree"] = np.repeat([car.base.tree for car in cars], len(WHEELS))
    wheels["slowest"], wheels["fastest"] = model.actuator_ctrlrange[motors].T
    wheels["own_low"], wheels["own_high"] = baseline.actuator_forcerange[motors].T
    wheels["own_gain"] = baseline.actuator_gainprm[motors, 0]
    gears = np.array([car.wheel_dofs for car in cars], np.intp).ravel()
    wheels["dry_nm"] = baseline.dof_frictionloss[gears]
    wheels["motor"] = motors
    wheels["gear"] = gears
    return wheels


class Bearings(StepEffect):
    """The dry friction of the rollers' bearings, in force where a roller touches something or is about to.

    MuJoCo solves a row for each joint with dry friction, and of a car's forty rollers four to eight touch at a time.
    One in the air, of 1e-6 kg m^2, has no force to pass on and is stopped by its grease within a tenth of a second: it
    turns on that alone. MuJoCo lists what comes within the rollers' gap of 0.2 mm as a contact without force, so the
    friction is there before it touches. It follows from the contacts of the last step, which are part of the state; of
    cars that sleep, whose contacts MuJoCo leaves out, all rollers have it.
    """

    def __init__(self, world: EffectWorld) -> None:
        model = world.model
        geoms = np.flatnonzero(model.geom_contype == ROLLERS)
        dofs = model.body_dofadr[model.geom_bodyid[geoms]].astype(np.intp)
        roller = np.full(model.ngeom, -1, np.int32)
        roller[geoms] = np.arange(len(geoms))
        trees = model.dof_treeid[dofs].astype(np.intp)
        # By geom its roller, counted over all cars, or -1; by roller its joint, its car and its friction in Nm.
        bearings = roller, dofs, trees, world.baseline.dof_frictionloss[dofs]
        self._follow = partial(
            _follow_contacts, bearings, world.data.tree_asleep, model.dof_frictionloss
        )

    def start(self, world: EffectWorld) -> None:
        """Go by the contacts of the start."""
        self.after_step(world)

    def after_step(self, world: EffectWorld) -> None:
        """Let the bearings have friction whose rollers touched something in the last step, or were about to."""
        # A copy is laid out the same way however many contacts there are.
        geoms = np.ascontiguousarray(world.data.contact.geom)
        self._follow(geoms)


@compiled
def _follow_contacts(
    bearings: tuple[Any, ...], asleep: Ints, friction: Floats, geoms: Ints
) -> None:
    roller_of, dofs, trees, dry = bearings
    for roller in range(len(dofs)):
        friction[dofs[roller]] = dry[roller] if asleep[trees[roller]] >= 0 else 0.0
    for contact in range(len(geoms)):
        for side in range(2):
            roller = roller_of[geoms[contact, side]]
            if roller >= 0:
                friction[dofs[roller]] = dry[roller]


_LOSSES: Final = layout(f8="torque_slope gear_loss backlash_rad sag elapsed_s")
"""Figures of a Drivetrain, and the time since they were last taken into account."""


class DrivetrainLosses(StepEffect):
    """The effect of the shortcomings of wheel motors, gears and batteries.

    - The most torque of a motor that drives falls in proportion to its speed, by ``torque_slope`` at its top speed; a
      motor that brakes has all of its torque. A battery's ``sag`` lowers that line by the torque that the four motors
      of its car drive with.
    - Of a motor's torque its gear takes ``gear_loss`` while the motor drives, and adds as much while it brakes.
    - In its backlash a gear passes nothing on, friction neither. Its motor then turns as commanded, less what the
      gear's friction makes of that, and takes up the play.

    Torques and speeds are those as the last physics step began. Left out is that the rotor turns by itself: teeth meet
    without an impact, and a play ends with a physics step. MuJoCo's DC motor has a torque-speed line of its own, but
    takes a voltage; the wheels' servos take a speed.
    """

    def __init__(self, world: EffectWorld, wheels: Records, drivetrain: Drivetrain) -> None:
        model = world.model
        data = world.data
        losses = records(1, _LOSSES)
        for name in ("torque_slope", "gear_loss", "backlash_rad", "sag"):
            losses[name] = getattr(drivetrain, name)
        self._losses = losses
        self._wheels = wheels
        self._last_s = 0.0
        state = data.ctrl, data.actuator_force, data.actuator_velocity
        limits = model.actuator_forcerange
        friction = model.dof_frictionloss
        changed = limits, model.actuator_gainprm, model.actuator_biasprm, friction
        self._lose = partial(_lose, state, changed, data.tree_asleep, losses, wheels)

    @property
    def state(self) -> Floats:
        """(n + 1,): by wheel where its gear is in its backlash, and when that was."""
        return np.append(self._wheels["played"], self._last_s)

    @state.setter
    def state(self, saved: Floats) -> None:
        self._wheels["played"] = saved[:-1]
        self._last_s = float(saved[-1])

    def start(self, world: EffectWorld) -> None:
        """Begin with all gears in the middle of their backlash."""
        self._wheels["played"] = self._losses["backlash_rad"] / 2
        self._last_s = world.data.time
        self.after_step(world)

    def after_step(self, world: EffectWorld) -> None:
        """Let motors and gears be as the state leaves them; plays go on for the time since the last call."""
        self._losses["elapsed_s"] = world.data.time - self._last_s
        self._last_s = world.data.time
        self._lose()


@compiled
def _lose(state: Arrays, changed: Arrays, asleep: Ints, losses: Records, wheels: Records) -> None:
    ctrl, forces, speeds = state
    limits, gains, biases, friction = changed
    lost = losses[0]
    voltage = 1.0
    for number in range(len(wheels)):
        wheel = wheels[number]
        motor = wheel.motor
        awake = asleep[wheel.tree] < 0
        if number % 4 == 0:
            voltage = 1.0
            for index in range(number, number + 4):
                torque = forces[wheels[index].motor] if awake else 0.0
                share = abs(torque) / max(wheels[index].own_high, _TINY_NM)
                if torque * speeds[wheels[index].motor] >= 0.0:
                    voltage -= lost.sag / 4 * min(share, 1.0)
        speed = speeds[motor] if awake else 0.0
        low = wheel.own_low * max(
            voltage - lost.torque_slope * max(speed / wheel.slowest, 0.0), 0.0
        )
        high = wheel.own_high * max(
            voltage - lost.torque_slope * max(speed / wheel.fastest, 0.0), 0.0
        )
        loss = lost.gear_loss * min(max(speed / _SLOW_RAD_S, -1.0), 1.0)
        commanded = min(max(ctrl[motor], wheel.slowest), wheel.fastest)
        gain = wheel.own_gain
        engaged = True
        if lost.backlash_rad > 0.0:
            engaged = _engages(wheel, lost, speed, commanded)
        if not engaged:
            gain = 0.0
        elif commanded > speed:
            gain *= 1 - loss
        else:
            gain *= 1 + loss
        gains[motor, 0] = gain
        biases[motor, 2] = -gain
        limits[motor, 0] = low * (1 + loss)
        limits[motor, 1] = high * (1 - loss)
        friction[wheel.gear] = wheel.dry_nm if engaged else 0.0


@compiled
def _engages(wheel: Record, lost: Record, speed: float, commanded: float) -> bool:
    """Let a gear go on through its backlash; return whether it is at an end of it."""
    # In the play the gear's friction alone is before the servo.
    turns = math.copysign(max(abs(commanded) - wheel.dry_nm / wheel.own_gain, 0.0), commanded)
    # By how far the motor turns more than the wheel.
    slip_rad = lost.elapsed_s * (turns - speed)
    wheel.played = min(max(wheel.played + slip_rad, 0.0), lost.backlash_rad)
    return bool(wheel.played == 0.0 or wheel.played == lost.backlash_rad)
