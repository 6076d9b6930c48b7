"""How far a real world is from the nominal one: what may differ, drawn from a seed."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable
from typing import Final

import mujoco
import numpy as np

from craftsim.compiled.arrays import Floats
from craftsim.errors import InputError
from craftsim.models.baseline import Baseline
from craftsim.models.config import Amount
from craftsim.models.effects import IDEAL, Drivetrain
from craftsim.models.floor import FLAT, Floor, lay, tiles_body
from craftsim.models.parts import GROUND, Car
from craftsim.models.sensing import EXACT, SensorNoise
from craftsim.models.wheel_contacts import ACROSS, tyres_of
from craftsim.models.world import PhysicsWorld
from craftsim.storage.records import record


@record()
class Making:
    """Tolerances of making: half-widths below 1 of uniform distributions, drawn for each machine; hashable."""

    wheel_radius_m: Amount = 0.0
    """Of each wheel by itself."""
    wheel_place_m: Amount = 0.0
    """Of each axle's distance from the car's middle, forward and sideways: wheelbase and track."""
    board_m: Amount = 0.0
    """Of the height of a lowered board and its boss."""
    board_place_m: Amount = 0.0
    """Of the place of board and boss on the car, forward and sideways."""
    foot_m: Amount = 0.0
    """Of the height of each foot of a block or a flag."""
    underside_m: Amount = 0.0
    """Of the height of a block's pocket and of a slope's pads above the floor."""
    pocket_m: Amount = 0.0
    """Of the place of a block's pocket and of a slope's pads, forward and sideways."""


AS_DRAWN: Final = Making()
"""Every machine is as it is drawn."""


@record()
class DomainRandomization:
    """How far a world is from the ideal one, as distributions from which a seed draws; hashable.

    The one record of what a world in physics lacks. Names of presets and files become it where they are read
    (:func:`craftsim.checking.setup.setup_of`); an ``Imperfection`` of an audit names one of its fields. Apart from it
    are the noise that cars assume, a SensorNoise of its own, as it may differ from that of the world; and the limits
    of a judge, which are widened for it.

    Those of the physics are half-widths of uniform distributions, all of them fractions of the nominal figure but the
    tilt. Raises InputError for a figure outside [0, 1).

    Example:
        >>> import craftsim
        >>> craftsim.DomainRandomization(friction=0.1, tilt_rad=0.0).mass
        0.2
    """

    friction: Amount = 0.30
    """Of every contact surface, drawn for each machine and each of its materials."""
    mass: Amount = 0.20
    """Masses and inertias, drawn for each machine."""
    motor: Amount = 0.15
    """Torque and force limits and servo gains, drawn for each motor."""
    joint_friction: Amount = 0.50
    """Dry friction and damping of gears, rollers, boards and hinges, drawn for each joint."""
    tilt_rad: Amount = math.radians(0.5)
    """Largest tilt of the floor, in a direction that is drawn uniformly."""
    floor: Floor = FLAT
    drivetrain: Drivetrain = IDEAL
    making: Making = AS_DRAWN
    sensors: SensorNoise = EXACT
    """Of the cars' sensors and motors: what the world does, whatever the cars assume of it."""

    @property
    def nominal(self) -> bool:
        """Whether the physics is the nominal one, so that nothing of it is drawn; sensors and motors aside."""
        physics = self.friction or self.mass or self.motor or self.joint_friction or self.tilt_rad
        return not physics and self.floor.flat and self.making == AS_DRAWN


_FEET: Final = ("foot_fl", "foot_fr", "foot_rl", "foot_rr")
_POCKET: Final = ("frame_front", "frame_back", "frame_left", "frame_right")
_PADS: Final = ("pad_left", "pad_right", "pad_back", "pad_front")

NONE: Final = DomainRandomization(0.0, 0.0, 0.0, 0.0, 0.0)
"""The nominal physics, exact sensors and ideal motors."""


Draw = Callable[[str, str], np.random.Generator]
"""Gives the generator of one figure of one machine, by the names of both."""


def by_name(rng: np.random.Generator) -> Draw:
    """Return generators for figures of machines, such as ``("car0", "mass")``.

    The seed that ``rng`` draws and the two names decide alone what one gives: nothing that is added to a world, or
    taken out of it, changes what is drawn of the rest, and both drives have the same masses and friction.
    """
    seed = rng.integers(0, 2**32, 4).tolist()

    def draw(machine: str, figure: str) -> np.random.Generator:
        name = hashlib.sha256(f"{machine}: {figure}".encode()).digest()
        return np.random.default_rng([*seed, int.from_bytes(name[:16], "big")])

    return draw


def randomize(
    physics: PhysicsWorld, randomization: DomainRandomization, rng: np.random.Generator
) -> None:
    """Draw new physics around that of a world as it was compiled, and reset it; equal generators give equal physics.

    Motors and gears come to rest as ideal ones: what they lack is set afterwards.

    Raises InputError for a floor that the PhysicsWorld was not composed with.
    """
    model = physics.model
    floor = randomization.floor
    if floor != physics.floor and not (floor.flat and physics.floor.flat):
        raise InputError(
            "the floor that is drawn must be that of the PhysicsWorld: PhysicsWorld(..., floor=...)"
        )
    draw = by_name(rng)
    physics.compiled.write(model)
    _vary_bodies(model, randomization, draw)
    _vary_motors_and_joints(model, randomization, draw)
    tilt = draw(GROUND, "tilt")
    angle = randomization.tilt_rad * math.sqrt(tilt.uniform())
    towards = tilt.uniform(0, math.tau)
    down = (
        math.sin(angle) * math.cos(towards),
        math.sin(angle) * math.sin(towards),
        -math.cos(angle),
    )
    model.opt.gravity[:] = float(np.linalg.norm(model.opt.gravity)) * np.array(down)
    lift_m = 0.0
    if not floor.flat:
        lift_m = lay(model, floor, physics.size, draw(GROUND, "floor"))
    if randomization.making != AS_DRAWN:
        _make(physics, randomization.making, draw)
    uneven = not floor.flat or randomization.making.wheel_radius_m > 0
    physics.drivetrain = IDEAL
    physics.set_baseline(Baseline.of(model), uneven, lift_m)
    physics.reset()


def _factors(width: float, names: Iterable[tuple[str, str]], draw: Draw) -> Floats:
    """Return (n,): a factor about 1 for each figure of a machine."""
    low = 1 - width
    high = 1 + width
    return np.array([draw(*name).uniform(low, high) if width else 1.0 for name in names])


def _vary_bodies(model: mujoco.MjModel, randomization: DomainRandomization, draw: Draw) -> None:
    roots = np.where(model.body_rootid == tiles_body(model), 0, model.body_rootid)
    present = np.unique(roots)
    names = [
        _machine_and_part(model.body(root).name)[0] if root else GROUND for root in present.tolist()
    ]
    machines = dict(zip(present.tolist(), names, strict=True))
    mass = _factors(randomization.mass, ((name, "mass") for name in names), draw)
    by_body = mass[np.searchsorted(present, roots)]
    model.body_mass[:] *= by_body
    model.body_inertia[:] *= by_body[:, None]
    # What has one coefficient is one material.
    surfaces = np.column_stack([roots[model.geom_bodyid], model.geom_friction[:, 0]])
    materials, material = np.unique(surfaces, axis=0, return_inverse=True)
    rubbing = (
        (machines[int(root)], f"friction where it is {value:g}")
        for root, value in materials.tolist()
    )
    model.geom_friction[:, 0] *= _factors(randomization.friction, rubbing, draw)[
        material.reshape(-1)
    ]


def _vary_motors_and_joints(
    model: mujoco.MjModel, randomization: DomainRandomization, draw: Draw
) -> None:
    names = [_machine_and_part(model.actuator(i).name) for i in range(model.nu)]
    motor = _factors(
        randomization.motor, ((machine, f"motor {element}") for machine, element in names), draw
    )
    model.actuator_forcerange[:] *= motor[:, None]
    model.actuator_gainprm[:, 0] *= motor
    model.actuator_biasprm[:, 1:] *= motor[:, None]
    joints = [_machine_and_part(model.joint(i).name) for i in range(model.njnt)]
    rubbing = ((machine, f"joint {element}") for machine, element in joints)
    friction = _factors(randomization.joint_friction, rubbing, draw)
    model.dof_frictionloss[:] *= friction[model.dof_jntid]
    model.dof_damping[:] *= friction[model.dof_jntid]
    # The bearings of rollers that are no bodies of their own.
    for tyre in tyres_of(model):
        machine, element = _machine_and_part(model.geom(tyre).name)
        (factor,) = _factors(randomization.joint_friction, [(machine, f"bearings {element}")], draw)
        model.geom_user[tyre, ACROSS] *= factor


def _make(physics: PhysicsWorld, making: Making, draw: Draw) -> None:
    """Draw machines a little off their drawings in a world's model: shapes that touch, no masses."""
    model = physics.model

    def drawn(machine: str, figure: str, *shape: int) -> Floats:
        width: float = getattr(making, figure)
        return np.array(width * draw(machine, figure).uniform(-1, 1, shape))

    def off(machine: str) -> Floats:
        """Return (3,) metres: by how much a pocket or pads are off, forward, sideways and up."""
        return np.append(drawn(machine, "pocket_m", 2), drawn(machine, "underside_m"))

    for car in physics.cars:
        machine, _ = _machine_and_part(car.base.name)
        _resize_wheels(
            model, car, drawn(machine, "wheel_radius_m", 4), drawn(machine, "wheel_place_m", 4, 2)
        )
        (board,) = model.jnt_bodyid[model.dof_jntid[[car.board.dof]]]
        model.body_pos[board] += np.append(
            drawn(machine, "board_place_m", 2), drawn(machine, "board_m")
        )
    for table in physics.tables:
        machine, _ = _machine_and_part(table.name)
        model.geom_pos[_geoms(model, machine, _FEET), 2] -= drawn(machine, "foot_m", len(_FEET))
        model.geom_pos[_geoms(model, machine, _POCKET)] += off(machine)
    for slope in physics.slopes:
        machine, _ = _machine_and_part(slope.base.name)
        model.geom_pos[_geoms(model, machine, _PADS)] += off(machine)


def _resize_wheels(model: mujoco.MjModel, car: Car, larger: Floats, moved: Floats) -> None:
    tyres = tyres_of(model)
    for dof, larger_m, by in zip(car.wheel_dofs, larger, moved, strict=True):
        wheel = model.dof_bodyid[dof]
        model.body_pos[wheel, :2] += by
        tyre = tyres[model.geom_bodyid[tyres] == wheel]
        model.geom_size[tyre, 0] += larger_m
        # Rollers stand further out on their hub.
        rollers = np.flatnonzero(model.body_parentid == wheel)
        out = np.linalg.norm(model.body_pos[rollers], axis=1, keepdims=True)
        model.body_pos[rollers] *= 1 + larger_m / out


def _machine_and_part(name: str) -> tuple[str, str]:
    """Return the two words of a name in a model, such as ``car0`` and ``wheel_fl``."""
    machine, _, element = name.partition("/")
    return machine, element


def _geoms(model: mujoco.MjModel, machine: str, parts: tuple[str, ...]) -> list[int]:
    return [model.geom(f"{machine}/{element}").id for element in parts]
