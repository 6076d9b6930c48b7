"""How far a real world is from the nominal one: what may differ, drawn from a seed, and read from files."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from craftsim.errors import InputError
from craftsim.mjcf.reduced import WholeCar
from craftsim.models.floor import lay, tiles_body
from craftsim.models.imperfection import AS_DRAWN, FLAT, IDEAL, Drivetrain, Floor, Making, check_shares
from craftsim.models.parts import WHEELS, Car
from craftsim.models.sensing import EXACT, SensorNoise
from craftsim.models.world import Baseline, Site
from craftsim.storage.yaml import Document, Loc, described, read_document, unknown_words

T = TypeVar("T")


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


_FEET: Final = ("foot_fl", "foot_fr", "foot_rl", "foot_rr")
_POCKET: Final = ("frame_front", "frame_back", "frame_left", "frame_right")
_PADS: Final = ("pad_left", "pad_right", "pad_back", "pad_front")

NONE: Final = DomainRandomization(0.0, 0.0, 0.0, 0.0, 0.0)
"""The nominal physics, exact sensors and ideal motors."""


def randomize(site: Site, randomization: DomainRandomization, rng: np.random.Generator) -> None:
    """Draw new physics around that of a Site as it was compiled, and reset it; equal generators give equal physics.

    Motors and gears come to rest as ideal ones: what they lack is set afterwards.

    Raises InputError for a floor that the Site was not composed with.
    """
    model, tiles = site.model, site.tiles
    if (tiles.floor if tiles else None) != (None if randomization.floor.flat else randomization.floor):
        raise InputError("the floor that is drawn must be that of the Site: Site(..., floor=...)")
    site.compiled.write(model)

    def factors(width: float, count: int) -> NDArray[np.float64]:
        return rng.uniform(1 - width, 1 + width, count)

    tree = np.where(model.body_rootid > 0, model.body_rootid, 0)
    mass = factors(randomization.mass, model.nbody)[tree]
    model.body_mass[:] *= mass
    model.body_inertia[:] *= mass[:, None]
    model.geom_friction[:, 0] *= factors(randomization.friction, model.ngeom)[_materials(site)]
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
    down = np.array([math.sin(tilt) * math.cos(towards), math.sin(tilt) * math.sin(towards), -math.cos(tilt)])
    model.opt.gravity[:] = float(np.linalg.norm(model.opt.gravity)) * down
    lift_m = 0.0
    if tiles or not randomization.making.exact:
        # Generators of their own: what is drawn of one does not depend on what else is drawn.
        surface, workshop = rng.spawn(2)
        lift_m = lay(model, tiles, surface) if tiles else 0.0
        _make(site, randomization.making, workshop)
    site.drivetrain = IDEAL
    site.set_baseline(
        Baseline.of(model), tiles is not None or randomization.making.wheel_radius_m > 0, lift_m
    )
    site.reset()


def _materials(site: Site) -> NDArray[np.intp]:
    """Return (n,): for each geom the first one of its material, which one machine and one friction make."""
    model = site.model
    root = model.body_rootid[model.geom_bodyid]
    root = np.where(root == tiles_body(model), 0, root)
    surfaces = np.column_stack([root, site.compiled.geom_friction[:, 0]])
    _, first, material = np.unique(surfaces, axis=0, return_index=True, return_inverse=True)
    found: NDArray[np.intp] = first[material.reshape(-1)]
    return found


def _make(site: Site, making: Making, rng: np.random.Generator) -> None:
    """Draw machines as they are made, each a little off its drawing, in a Site's model.

    What the skills know of a machine stays nominal. Masses, and what is only to be seen, stay as they are.
    """
    model = site.model
    for car in site.cars:
        _make_car(model, car, making, rng)
    for table in (*site.blocks, *site.flags):
        prefix = _prefix(model, table.body)
        feet, pocket = _geoms(model, prefix, _FEET), _geoms(model, prefix, _POCKET)
        model.geom_pos[feet, 2] -= making.foot_m * rng.uniform(-1, 1, len(feet))
        model.geom_pos[pocket] += _off(making, rng)
    for slope in site.slopes:
        model.geom_pos[_geoms(model, _prefix(model, slope.base.body), _PADS)] += _off(making, rng)


def _make_car(model: mujoco.MjModel, car: Car, making: Making, rng: np.random.Generator) -> None:
    prefix = _prefix(model, car.base.body)
    larger = making.wheel_radius_m * rng.uniform(-1, 1, len(WHEELS))
    moved = making.wheel_place_m * rng.uniform(-1, 1, (len(WHEELS), 2))
    (board,) = model.jnt_bodyid[model.dof_jntid[[car.board.dof]]]
    model.body_pos[board, 2] += making.board_m * rng.uniform(-1, 1)
    model.body_pos[board, :2] += making.board_place_m * rng.uniform(-1, 1, 2)
    if len(car.wheel_dofs):
        for wheel, more, by in zip(_wheel_bodies(model, car), larger, moved, strict=True):
            model.body_pos[wheel, :2] += by
            # Rollers stand further out on their hub.
            rollers = np.flatnonzero(model.body_parentid == wheel)
            out = np.linalg.norm(model.body_pos[rollers], axis=1, keepdims=True)
            model.body_pos[rollers] *= 1 + more / out
        return
    wheels = _geoms(model, prefix, WHEELS)
    model.geom_size[wheels, 0] += larger
    model.geom_pos[wheels, :2] += moved
    # A wheel's speed is (vx - y vy - z l omega) / R, l being its distance from the middle, forward plus sideways.
    nominal, radius = WholeCar.of(car.parameters), car.parameters.wheel_radius_m
    middle = np.sign(model.geom_pos[wheels, :2])
    lever = car.parameters.turn_radius_m + (middle * moved).sum(axis=1)
    scale = np.ones((len(WHEELS), 6)) * (radius / (radius + larger))[:, None]
    scale[:, 5] *= lever / car.parameters.turn_radius_m
    motors = [model.actuator(prefix + wheel.replace("wheel", "gear")).id for wheel in WHEELS]
    for wheel_motors in (car.wheel_actuators, motors):
        model.actuator_gear[wheel_motors] = np.array(nominal.gears) * scale


def _wheel_bodies(model: mujoco.MjModel, car: Car) -> Iterator[int]:
    return (int(model.dof_bodyid[dof]) for dof in car.wheel_dofs)


def _off(making: Making, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return (3,) metres: by how much a pocket or pads are off, forward, sideways and up."""
    return np.array([making.pocket_m, making.pocket_m, making.underside_m]) * rng.uniform(-1, 1, 3)


def _prefix(model: mujoco.MjModel, body: int) -> str:
    return str(model.body(body).name.rpartition("/")[0] + "/")


def _geoms(model: mujoco.MjModel, prefix: str, names: tuple[str, ...]) -> list[int]:
    return [model.geom(prefix + name).id for name in names]


def load_noise(path: Path | str, nominal: SensorNoise = EXACT) -> SensorNoise:
    """Return the sensor noise of a YAML file; what it leaves out is that of ``nominal``.

    Raises InputError, naming the file and figure, for an unknown figure and one out of range.

    Example:
        >>> from craftsim.models.randomization import load_noise
        >>> _ = (folder / "late.yaml").write_text("{min_delay_s: 0.06, max_delay_s: 0.08}")
        >>> load_noise(folder / "late.yaml").max_delay_s
        0.08
    """
    document = read_document(Path(path))
    with _naming(document):
        return _changed(document, nominal, "noise")


def load_randomization(
    path: Path | str, presets: Mapping[str, DomainRandomization], limits: list[str]
) -> tuple[str, DomainRandomization, dict[str, float]]:
    """Return what a YAML file draws: the preset that it starts from, the whole, and the limits of errors that it sets.

    The file has any of the figures of DomainRandomization, its parts ``floor``, ``drivetrain``, ``making`` and
    ``sensors`` as sections, a section ``limits``, and under ``base`` the preset for what it leaves out, ``none``
    unless given.

    Args:
        path: of the file.
        presets: by name.
        limits: the names that the section may hold.

    Raises InputError, naming the file, line and figure, for what it should not say.
    """
    document = read_document(Path(path))
    names = [f.name for f in fields(DomainRandomization)]
    given = document.mapping(["base", *names, "limits"])
    base = given.get("base", "none")
    if base not in presets:
        document.fail(("base",), unknown_words(str(base), presets, "value of 'base'"))
    whole, figures = presets[base], dict[str, Any]()
    with _naming(document):
        for name in names:
            if name in given and isinstance(part := getattr(whole, name), float):
                figures[name] = _number(document, given[name], name, (name,))
            elif name in given:
                figures[name] = _changed(document, part, name, name)
        whole = replace(whole, **figures)
    bounds = _numbers(document, "limits", limits, "limits") if "limits" in given else {}
    return base, whole, bounds


@contextmanager
def _naming(document: Document) -> Iterator[None]:
    """Name the file in what is wrong with figures that were read from it."""
    try:
        yield
    except InputError as error:
        if str(error).startswith(str(document.path)):
            raise
        raise InputError(f"{document.path}: {error}") from error


def _changed(document: Document, whole: T, name: str, *loc: str) -> T:
    """Return a dataclass of numbers with those that a section gives."""
    return replace(whole, **_numbers(document, name, [f.name for f in fields(whole)], *loc))  # type: ignore[type-var,arg-type]


def _numbers(document: Document, section: str, known: list[str], *loc: str) -> dict[str, float]:
    """Return the numbers of a section; raise InputError for what is no known key or no number."""
    given = document.mapping(known, *loc)
    return {key: _number(document, value, f"{section}.{key}", (*loc, key)) for key, value in given.items()}


def _number(document: Document, value: object, name: str, loc: Loc) -> float:
    if not isinstance(value, int | float):
        document.fail(loc, f"{name} must be a number, not {described(value)}")
    if not math.isfinite(value):
        document.fail(loc, f"{name} must be a finite number, not {value}")
    return float(value)
