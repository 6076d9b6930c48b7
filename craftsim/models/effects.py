"""What changes a model's parameters while its world runs: grip of the reduced drive, rollers' bearings, drivetrains.

MuJoCo has no elements for these. Each is a :class:`StepEffect`, which writes model parameters between physics steps,
worked out from the world's baseline and its state, and never a position, a speed or a force.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.copying import NotCopyable
from craftsim.discrete.kernel.jit import Record, compiled, layout, records
from craftsim.mjcf.building import TOUCHES, surface
from craftsim.models.config import Amount
from craftsim.models.parts import WHEELS
from craftsim.storage.records import record

if TYPE_CHECKING:
    from craftsim.models.world import PhysicsWorld

ROLLERS: Final = TOUCHES["wheels"]["contype"]
"""The bit by which a roller collides: its contype."""
_TINY_NM: Final = 1e-9
_INCLINED: Final = math.cos(0.03)
"""A car that leans by more than 0.03 rad, as of HoldGains.level, is on an incline."""
_SILENT: Final = 0.1
"""Share of a gear's dry friction below which a motor turns no wheel there: a loaded car's weight takes 0.87."""
_STANDS_RAD_S: Final = 0.02
_SLIDES_RAD_S: Final = 0.5
"""Wheel speeds below which a car comes to stand on an incline, 1 mm/s, and above which it slides."""
_FIRM: Final = 20.0
"""How much stiffer the friction of a standing wheel is than that of other contacts, by which a car would creep down the
slope by 0.01 mm/s: as much as rollers do."""
_SLOW_RAD_S: Final = 0.1
"""Below this speed a gear's loss falls to 0, which it is at rest: it would otherwise turn over with the speed."""

Floats = NDArray[np.float64]
Arrays = tuple[Floats, ...]
Ints = NDArray[np.int32]
Records = NDArray[np.void]

WHEEL: Final = layout(
    i8="motor gear tree dof body geom engaged stands",
    f8="slowest fastest low high own_low own_high own_gain dry_nm played nm_per_n load grip held",
    f8x6="own_gear inertia",
)
"""A wheel, its motor and its gear: where they and their car lie in MuJoCo's arrays, and the range of commanded speeds.

``low`` and ``high`` are the torques that the motor can give now; ``own_`` are parameters of the baseline, ``own_gear``
in the frame of the car. ``dry_nm`` is the gear's dry friction, ``played`` the angle gone through its backlash,
forwards, and ``engaged`` whether it is at an end of that. ``nm_per_n`` is the torque that a newton of load lets the
wheel pass on by ``grip``, its friction coefficient, ``load`` in newtons what it carries, ``inertia`` the torque per
acceleration of the car to turn wheel and motor. ``held`` is the share of the car's weight that four such gears hold,
``stands`` whether the wheel stands on an incline.
"""


@record()
class Drivetrain:
    """What wheel motors and gears lack; hashable. Raises InputError for a figure outside [0, 1)."""

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


class StepEffect(NotCopyable):
    """Something that changes parameters of a world's model; a new one is made for each baseline, and in each copy."""

    _instead = "copy its PhysicsWorld"

    state: Floats = np.zeros(0)
    """What it remembers beyond the state of MuJoCo; saved and restored with it."""
    settles: bool = False
    """Whether it acts before the control periods of a reset, too, in which all comes to rest."""
    each_step: bool = True
    """Whether it acts after each physics step; otherwise as a control period begins alone."""

    def start(self, world: PhysicsWorld) -> None:
        """Begin without a past: the model's parameters are the baseline's."""

    def before_period(self, world: PhysicsWorld) -> None:
        """Act as a control period begins."""

    def after_step(self, world: PhysicsWorld) -> None:
        """Act after a physics step, and after a saved state was restored."""


def effects_of(world: PhysicsWorld, drivetrain: Drivetrain) -> tuple[list[StepEffect], TurnedMotors]:
    """Return the effects of a world with its present baseline, in their order, and its motors that are turned."""
    wheels = _wheels(world)
    found: list[StepEffect] = [] if drivetrain == IDEAL else [DrivetrainLosses(world, wheels, drivetrain)]
    if world.machines.drive == "rollers":
        found.append(Bearings(world))
    else:
        found += [Grip(world, wheels), Standing(world, wheels)]
    return found, turned_motors(world, wheels)


def _wheels(world: PhysicsWorld) -> Records:
    """Return the wheels of all cars, (4 n,) of WHEEL, in the order of WHEELS."""
    model, baseline, cars = world.model, world.baseline, world.cars
    wheels = records(4 * len(cars), WHEEL)
    motors = np.array([car.wheel_actuators for car in cars], np.intp).ravel()
    for name in ("tree", "dof", "body"):
        wheels[name] = np.repeat([getattr(car.base, name) for car in cars], len(WHEELS))
    wheels["slowest"], wheels["fastest"] = model.actuator_ctrlrange[motors].T
    wheels["own_low"], wheels["own_high"] = baseline.actuator_forcerange[motors].T
    wheels["own_gain"] = baseline.actuator_gainprm[motors, 0]
    if world.machines.drive == "rollers":
        gears = np.array([car.wheel_dofs for car in cars], np.intp).ravel()
        wheels["dry_nm"] = baseline.dof_frictionloss[gears]
    else:
        # The gears of the reduced drive are motors without power; what they pass on is in proportion to their gear.
        names = [model.actuator(motor).name.replace("wheel", "gear") for motor in motors]
        gears = np.array([model.actuator(name).id for name in names], np.intp)
        wheels["own_gear"] = baseline.actuator_gear[motors]
        wheels["dry_nm"] = baseline.actuator_biasprm[gears, 3]
    wheels["motor"], wheels["gear"] = motors, gears
    wheels["low"], wheels["high"], wheels["engaged"] = wheels["own_low"], wheels["own_high"], 1
    return wheels


class Bearings(StepEffect):
    """The dry friction of the rollers' bearings, in force where a roller touches something or is about to.

    MuJoCo solves a row for each joint with dry friction, and of a car's forty rollers four to eight touch at a time.
    One in the air, of 1e-6 kg m^2, has no force to pass on and is stopped by its grease within a tenth of a second: it
    turns on that alone. MuJoCo lists what comes within the rollers' gap of 0.2 mm as a contact without force, so the
    friction is there before it touches. It follows from the contacts of the last step, which are part of the state; of
    cars that sleep, whose contacts MuJoCo leaves out, all rollers have it.
    """

    def __init__(self, world: PhysicsWorld) -> None:
        model = world.model
        geoms = np.flatnonzero(model.geom_contype == ROLLERS)
        dofs = model.body_dofadr[model.geom_bodyid[geoms]].astype(np.intp)
        roller = np.full(model.ngeom, -1, np.int32)
        roller[geoms] = np.arange(len(geoms))
        trees = model.dof_treeid[dofs].astype(np.intp)
        # By geom its roller, counted over all cars, or -1; by roller its joint, its car and its friction in Nm.
        own = roller, dofs, trees, world.baseline.dof_frictionloss[dofs]
        self._follow = partial(_follow_contacts, own, world.data.tree_asleep, model.dof_frictionloss)

    def start(self, world: PhysicsWorld) -> None:
        """Go by the contacts of the start."""
        self.after_step(world)

    def after_step(self, world: PhysicsWorld) -> None:
        """Let the bearings have friction whose rollers touched something in the last step, or were about to."""
        # A copy is laid out the same way however many contacts there are.
        geoms = np.ascontiguousarray(world.data.contact.geom)
        self._follow(geoms)


@compiled
def _follow_contacts(own: tuple[Any, ...], asleep: Ints, friction: Floats, geoms: Ints) -> None:
    roller_of, dofs, trees, dry = own
    for roller in range(len(dofs)):
        friction[dofs[roller]] = dry[roller] if asleep[trees[roller]] >= 0 else 0.0
    for contact in range(len(geoms)):
        for side in range(2):
            roller = roller_of[geoms[contact, side]]
            if roller >= 0:
                friction[dofs[roller]] = dry[roller]


class Grip(StepEffect):
    """How hard the wheels of the reduced drive can push: by their grip, from the load that each of them carries.

    Motors push the car as if wheels touched the floor with friction. A mecanum wheel holds the ground along its
    roller's axis, at 45 degrees to its way, by the friction coefficient times its load N at most: no more of its
    motor's torque than mu N R / sqrt(2), less what the gear takes, reaches the ground. Loads are those of the last
    physics step, and limits hold for one control period; where the floor is uneven, or the wheels are not equal, for
    one physics step. Of the four loads those three parts count there that equilibrium gives. The fourth, how a stiff
    car leans on one diagonal or the other, is left out: rollers share it out (docs/explanation/imperfections.md).

    The motors of cars that sleep, the loads of which MuJoCo leaves out, have no such limits, which so depend on the
    state alone.
    """

    def __init__(self, world: PhysicsWorld, wheels: Records) -> None:
        model, baseline = world.model, world.baseline
        names = [model.actuator(int(motor)).name for motor in wheels["motor"]]
        geoms = np.array([model.geom(name).id for name in names], np.int32)
        wheel_of = np.full(model.ngeom, -1, np.int32)
        wheel_of[geoms] = np.arange(len(geoms))
        radii = np.repeat([car.parameters.wheel_radius_m for car in world.cars], len(WHEELS))
        spin = np.repeat([car.parameters.wheel_inertia_kgm2 for car in world.cars], len(WHEELS))
        wheels["geom"], wheels["grip"] = geoms, baseline.geom_friction[geoms, 0]
        wheels["nm_per_n"] = wheels["grip"] * radii / math.sqrt(2)
        weight = model.body_subtreemass[wheels["body"]] * np.linalg.norm(baseline.gravity)
        wheels["held"] = 4 * wheels["dry_nm"] / radii / weight
        wheels["inertia"] = spin[:, None] * wheels["own_gear"]
        self.each_step = world.uneven
        data, uneven = world.data, np.array([world.uneven])
        state = data.actuator_force, data.tree_asleep, data.qacc, data.xmat
        self._limit = partial(_limit, wheel_of, uneven, wheels, state, model.actuator_forcerange)

    def before_period(self, world: PhysicsWorld) -> None:
        """Limit all motors for what their wheels carry now."""
        contact = world.data.contact
        # Copies are laid out the same way however many contacts there are.
        copies = np.ascontiguousarray(contact.geom), np.ascontiguousarray(contact.efc_address)
        self._limit(copies, world.data.efc_force)

    def after_step(self, world: PhysicsWorld) -> None:
        """Do so again where wheels may come off the ground."""
        self.before_period(world)


@compiled
def _weigh(wheel_of: Ints, uneven: bool, wheels: Records, contacts: tuple[Ints, ...], forces: Floats) -> None:
    """Find what each wheel carries; ``wheel_of`` says which wheel a geom is, or -1."""
    geoms, addresses = contacts
    for wheel in range(len(wheels)):
        wheels[wheel].load = 0.0
    for contact in range(len(geoms)):
        if addresses[contact] < 0:
            continue
        for side in range(2):
            wheel = wheel_of[geoms[contact, side]]
            if wheel >= 0:
                wheels[wheel].load += forces[addresses[contact]]
    for first in range(0, len(wheels) if uneven else 0, 4):
        twist = wheels[first].load - wheels[first + 1].load - wheels[first + 2].load + wheels[first + 3].load
        for wheel, sign in ((first, -1), (first + 1, 1), (first + 2, 1), (first + 3, -1)):
            wheels[wheel].load = max(0.0, wheels[wheel].load + sign * (twist / 4))


@compiled
def _limit(
    wheel_of: Ints,
    uneven: NDArray[np.bool_],
    wheels: Records,
    state: tuple[Floats, Ints, Floats, Floats],
    forcerange: Floats,
    contacts: tuple[Ints, Ints],
    forces: Floats,
) -> None:
    _weigh(wheel_of, uneven[0], wheels, contacts, forces)
    motor_forces, asleep, qacc, xmat = state
    for number in range(len(wheels)):
        wheel = wheels[number]
        motor, most, low, high = wheel.motor, wheel.load * wheel.nm_per_n, wheel.low, wheel.high
        if asleep[wheel.tree] >= 0:
            forcerange[motor] = low, high
            continue
        friction, spin = motor_forces[wheel.gear], 0.0
        for axis in range(2):
            for world in range(3):
                spin += wheel.inertia[axis] * xmat[wheel.body, 3 * world + axis] * qacc[wheel.dof + world]
        spin += wheel.inertia[5] * qacc[wheel.dof + 5]
        forcerange[motor, 0] = min(max(-most - friction + min(spin, 0.0), low), high)
        forcerange[motor, 1] = min(max(most - friction + max(spin, 0.0), low), high)


class Standing(StepEffect):
    """Wheels of the reduced drive that stand on an incline: their gears lock them, and they hold it by friction.

    What motors and gears push is not passed on to what is below. Where that lasts it does harm: a slope that bears a
    standing car would be pushed away with a quarter of the car's weight, creep by a millimetre in eight minutes, and
    bend a stack below it. So while a car stands on an incline with silent motors and gears that hold it, its wheels
    have friction: as much as their grip along the rollers gives. Cars that sleep go on as they are.
    """

    settles, each_step = True, False

    def __init__(self, world: PhysicsWorld, wheels: Records) -> None:
        model, data, contact = world.model, world.data, world.machines.contact
        # MuJoCo's direct format of solref, in which the contact is as deep and creeps less.
        soft, firm = surface(contact, 0.0), surface(contact, 0.0, _FIRM)
        spring = contact.time_constant_s * contact.damping_ratio
        stiff = -1 / spring**2 / _FIRM, -2 / contact.time_constant_s
        self._solref = np.array([soft["solref"], stiff])
        self._solimp = np.array([soft["solimp"], firm["solimp"]])
        self._model, self._wheels = model, wheels
        self._stand = partial(_stand, wheels, (data.ctrl, data.qvel, data.xmat, data.tree_asleep))

    @property
    def state(self) -> Floats:
        """(n,): which wheels stand."""
        return self._wheels["stands"].astype(float)

    @state.setter
    def state(self, saved: Floats) -> None:
        self._wheels["stands"] = saved
        self._touch()

    def _touch(self) -> None:
        """Let wheels that stand have friction, and the others none."""
        model, wheels = self._model, self._wheels
        geoms, stands = wheels["geom"], wheels["stands"]
        model.geom_condim[geoms] = np.where(stands, 3, 1)
        model.geom_friction[geoms, 0] = np.where(stands, wheels["grip"] / math.sqrt(2), wheels["grip"])
        model.geom_solref[geoms], model.geom_solimp[geoms] = self._solref[stands], self._solimp[stands]

    def start(self, world: PhysicsWorld) -> None:
        """Begin with wheels that turn."""
        self.state = np.zeros(len(self._wheels))

    def before_period(self, world: PhysicsWorld) -> None:
        """Find the wheels that stand now."""
        if self._stand():
            self._touch()


@compiled
def _stand(wheels: Records, moving: tuple[Floats, Floats, Floats, Ints]) -> bool:
    """Find the cars that stand on an incline; return whether these are others than before."""
    ctrl, qvel, xmat, asleep = moving
    changed = False
    for first in range(0, len(wheels), 4):
        tree, body, dof = wheels[first].tree, wheels[first].body, wheels[first].dof
        if asleep[tree] >= 0:
            continue
        most = _SLIDES_RAD_S if wheels[first].stands else _STANDS_RAD_S
        upright = xmat[body, 8]
        stands = upright < _INCLINED
        for number in range(first, first + 4):
            wheel = wheels[number]
            turns = wheel.own_gear[5] * qvel[dof + 5]
            for axis in range(2):
                for world in range(3):
                    turns += wheel.own_gear[axis] * xmat[body, 3 * world + axis] * qvel[dof + world]
            silent = abs(wheel.own_gain * ctrl[wheel.motor]) <= _SILENT * wheel.dry_nm
            held = 1.0 - upright * upright < wheel.held * wheel.held
            stands = stands and held and silent and abs(turns) <= most
        for number in range(first, first + 4):
            changed = changed or wheels[number].stands != stands
            wheels[number].stands = stands
    return changed


TurnedMotors = tuple[Floats, Ints, Records, Floats]
"""MjData.qpos; where in it the pose of each wheel's car lies; the wheels; and MjModel.actuator_gear."""


def turned_motors(world: PhysicsWorld, wheels: Records) -> TurnedMotors:
    """Let motors and gears of the reduced drive, which push their car in its own frame, act on its free joint.

    In MJCF they act on a site of the car, for which MuJoCo works out Jacobians in each step. A motor of the free joint
    pushes along the axes of the world; turned with the car before each step, it does the same. On rollers are none.
    """
    model = world.model
    if world.machines.drive == "rollers":
        wheels = wheels[:0]
    joints = model.body_jntadr[wheels["body"]]
    for motors in (wheels["motor"], wheels["gear"]):
        model.actuator_trntype[motors] = mujoco.mjtTrn.mjTRN_JOINT
        model.actuator_trnid[motors] = np.column_stack([joints, np.full(len(joints), -1)])
    return world.data.qpos, model.jnt_qposadr[joints], wheels, model.actuator_gear


@compiled
def turn_motors(motors: TurnedMotors) -> None:
    """Turn the motors as the cars stand. A gear in its backlash passes nothing on, nor do those of standing wheels."""
    qpos, places, wheels, gears = motors
    for number in range(len(wheels)):
        wheel, at = wheels[number], places[number]
        w, x, y, z = qpos[at + 3], qpos[at + 4], qpos[at + 5], qpos[at + 6]
        along, across = wheel.own_gear[0], wheel.own_gear[1]
        motor, gear = wheel.motor, wheel.gear
        gears[motor, 0] = (1 - 2 * (y * y + z * z)) * along + 2 * (x * y - w * z) * across
        gears[motor, 1] = 2 * (x * y + w * z) * along + (1 - 2 * (x * x + z * z)) * across
        gears[motor, 2] = 2 * (x * z - w * y) * along + 2 * (y * z + w * x) * across
        gears[motor, 5] = wheel.own_gear[5]
        for k in range(6):
            gears[motor, k] *= 0.0 if wheel.stands else 1.0
            gears[gear, k] = gears[motor, k] if wheel.engaged else 0.0


_LOSSES: Final = layout(f8="torque_slope gear_loss backlash_rad sag elapsed_s", i8="reduced")
"""Figures of a Drivetrain, the time since they were last taken into account, and whether it is a reduced drive's."""


class DrivetrainLosses(StepEffect):
    """What wheel motors, gears and batteries lack.

    - The most torque of a motor that drives falls in proportion to its speed, by ``torque_slope`` at its top speed; a
      motor that brakes has all of its torque. A battery's ``sag`` lowers that line by the torque that the four motors
      of its car drive with.
    - Of a motor's torque its gear takes ``gear_loss`` while the motor drives, and adds as much while it brakes.
    - In its backlash a gear passes nothing on, friction neither. Its motor then turns as commanded, less what the
      gear's friction makes of that, and takes up the play.

    Torques and speeds are those as the last physics step began; grip takes up what a motor has left once in a control
    period. Left out is that the rotor turns by itself: teeth meet without an impact, and a play ends with a physics
    step. MuJoCo's DC motor has a torque-speed line of its own, but takes a voltage; the wheels' servos take a speed.
    """

    def __init__(self, world: PhysicsWorld, wheels: Records, drivetrain: Drivetrain) -> None:
        model, data, reduced = world.model, world.data, world.machines.drive == "reduced"
        losses = records(1, _LOSSES)
        for name in ("torque_slope", "gear_loss", "backlash_rad", "sag"):
            losses[name] = getattr(drivetrain, name)
        losses["reduced"] = reduced
        self._losses, self._wheels, self._last_s = losses, wheels, 0.0
        state = data.ctrl, data.actuator_force, data.actuator_velocity
        limits, friction = model.actuator_forcerange, model.dof_frictionloss
        changed = limits, model.actuator_gainprm, model.actuator_biasprm, friction
        self._lose = partial(_lose, state, changed, data.tree_asleep, losses, wheels)

    @property
    def state(self) -> Floats:
        """(n + 1,): by wheel where its gear is in its backlash, and when that was."""
        return np.append(self._wheels["played"], self._last_s)

    @state.setter
    def state(self, saved: Floats) -> None:
        self._wheels["played"], self._last_s = saved[:-1], float(saved[-1])

    def start(self, world: PhysicsWorld) -> None:
        """Begin with all gears in the middle of their backlash."""
        self._wheels["played"], self._last_s = self._losses["backlash_rad"] / 2, world.data.time
        self.after_step(world)

    def after_step(self, world: PhysicsWorld) -> None:
        """Let motors and gears be as the state leaves them; plays go on for the time since the last call."""
        self._losses["elapsed_s"], self._last_s = world.data.time - self._last_s, world.data.time
        self._lose()


@compiled
def _lose(state: Arrays, changed: Arrays, asleep: Ints, losses: Records, wheels: Records) -> None:
    ctrl, forces, speeds = state
    limits, gains, biases, friction = changed
    lost = losses[0]
    voltage = 1.0
    for number in range(len(wheels)):
        wheel = wheels[number]
        motor, awake = wheel.motor, asleep[wheel.tree] < 0
        if number % 4 == 0:
            voltage = 1.0
            for other in range(number, number + 4):
                torque = forces[wheels[other].motor] if awake else 0.0
                drives = torque * speeds[wheels[other].motor] >= 0.0
                share = abs(torque) / max(wheels[other].own_high, _TINY_NM)
                voltage -= lost.sag / 4 * min(share, 1.0) if drives else 0.0
        speed = speeds[motor] if awake else 0.0
        low = wheel.own_low * max(voltage - lost.torque_slope * max(speed / wheel.slowest, 0.0), 0.0)
        high = wheel.own_high * max(voltage - lost.torque_slope * max(speed / wheel.fastest, 0.0), 0.0)
        taken = lost.gear_loss * min(max(speed / _SLOW_RAD_S, -1.0), 1.0)
        commanded = min(max(ctrl[motor], wheel.slowest), wheel.fastest)
        gain, engaged = wheel.own_gain, True
        if lost.backlash_rad > 0.0:
            passed = forces[motor] + forces[wheel.gear] if lost.reduced else 0.0
            engaged = _engages(wheel, lost, speed, commanded, passed)
        gain *= (1 - taken if commanded > speed else 1 + taken) if engaged else 0.0
        gains[motor, 0], biases[motor, 2] = gain, -gain
        wheel.low, wheel.high = low * (1 + taken), high * (1 - taken)
        wheel.engaged = engaged
        if not lost.reduced:
            limits[motor, 0], limits[motor, 1] = wheel.low, wheel.high
            friction[wheel.gear] = wheel.dry_nm if engaged else 0.0


@compiled
def _engages(wheel: Record, lost: Record, speed: float, commanded: float, passed: float) -> bool:
    """Let a gear go on through its backlash; return whether it is at an end of it."""
    # In the play the gear's friction alone is before the servo.
    turns = math.copysign(max(abs(commanded) - wheel.dry_nm / wheel.own_gain, 0.0), commanded)
    # By how far the motor turns more than the wheel.
    way = lost.elapsed_s * (turns - speed)
    # One that stands, and whose friction is still strained by what the wheel has passed to it, does not let go.
    strained_ahead = wheel.played == lost.backlash_rad and way < 0.0 and passed > 0.0 and turns >= 0.0
    strained_back = wheel.played == 0.0 and way > 0.0 and passed < 0.0 and turns <= 0.0
    if not (strained_ahead or strained_back):
        wheel.played = min(max(wheel.played + way, 0.0), lost.backlash_rad)
    return bool(wheel.played == 0.0 or wheel.played == lost.backlash_rad)
