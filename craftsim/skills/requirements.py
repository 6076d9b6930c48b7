"""What tasks need of a machine, and what it gives: closed forms, before any simulation.

A need *fails* where a machine gives less than statics asks for. It is *tight* where it suffices in the nominal world
only: not with the weakest motors, the heaviest machines and the stiffest gears that strong randomization draws, or, for
grip, not with the acceleration of its paths. ``tests/skills/test_requirements.py`` holds predictions against physics.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final, Literal

import mujoco

from craftsim.discrete.geometry import CELL_PITCH_M, INCLINE_RAD
from craftsim.mjcf.machines import (
    HEAD_ROOM_M,
    NOMINAL,
    ROOM_BESIDE_M,
    Machines,
    half_between_legs_m,
    under_block_m,
    under_slope_m,
)
from craftsim.mjcf.parameters import CLEARANCE_M, GRAVITY, SmartcarParameters, over_crest_m
from craftsim.models.composition import compile_spec, machine_spec
from craftsim.models.config import SimulationConfig
from craftsim.models.randomization import DomainRandomization
from craftsim.skills.gains import FOLLOWING, Gains, gains_of_car
from craftsim.skills.limits import MOVE_LIMITS, TURN_LIMITS, BindingLimits, Motion, binding_limits
from craftsim.skills.setup import SkillSetup, Terrain

_DRAWN: Final = DomainRandomization()
"""What strong randomization draws."""
_WEAKEST: Final = 1 - _DRAWN.motor
_HEAVIEST: Final = 1 + _DRAWN.mass
_STIFFEST: Final = 1 + _DRAWN.joint_friction
_LIGHTEST: Final = 0.5
"""Share of its mass down to which a car may be made lighter; less is another machine."""
_DIGITS: Final = 3
"""Of the figures that would do."""


@dataclass(frozen=True)
class Requirement:
    """Something that tasks need of a machine; figures are in ``unit``."""

    key: str
    words: str
    unit: str
    gives: float
    """By the machine."""
    least: float | None
    """Less fails; None where nothing does."""
    sure: float
    """Less is tight."""
    parameter: str
    """That decides it, by section and name."""
    changes: tuple[str, ...] = ()
    """Changes each of which would do, of what does not work."""

    @property
    def verdict(self) -> Literal["works", "tight", "fails"]:
        """Whether it works."""
        if self.least is not None and self.gives < self.least:
            return "fails"
        if self.gives < self.sure:
            return "tight"
        return "works"


def requirements(machines: Machines, number: int, gains: Gains) -> list[Requirement]:
    """Return what tasks need of a car, by its number.

    Raises InputError, naming the motor, for a velocity loop that physics steps cannot take.
    """
    compile_spec(machine_spec("smartcar", Machines((machines.car(number),)), visual=False))
    return [
        *_climbs(machines, number),
        _grip(machines, number, gains),
        _parking(machines, number),
        _crest(machines, number),
        *_lifts(machines, number),
        *_sags(machines, number),
        _hinge(machines),
        _place(machines, gains),
        *_rooms(machines, number),
    ]


def _loads(machines: Machines) -> dict[str, float]:
    """Return the masses that a car carries, by name."""
    return {"block": machines.block.mass_kg, "slope": machines.slope.mass_kg}


def _climbing_nm(car: SmartcarParameters, mass_kg: float) -> float:
    """Return the torque by which each of four wheels takes its share of a mass up an incline."""
    return mass_kg * GRAVITY * math.sin(INCLINE_RAD) * car.wheel_radius_m / 4


def _climbs(machines: Machines, number: int) -> Iterator[Requirement]:
    car = machines.car(number)
    torque_nm = car.wheel_torque_nm
    gear_nm = car.gear_friction_nm
    for load, load_kg in ({"": 0.0} | _loads(machines)).items():
        key = "climb_empty"
        words = "climb a slope, empty"
        if load:
            key = f"climb_with_{load}"
            words = f"climb a slope with a {load}"
        share_nm = _climbing_nm(car, car.mass_kg + load_kg)
        sure_nm = (_STIFFEST * gear_nm + _HEAVIEST * share_nm) / _WEAKEST
        spare_nm = _WEAKEST * torque_nm - _STIFFEST * gear_nm
        changes = [f"smartcar.wheel_torque_nm at least {_up(sure_nm)}"]
        lighter_kg = spare_nm / (_HEAVIEST * _climbing_nm(car, 1.0)) - load_kg
        if lighter_kg > _LIGHTEST * car.mass_kg:
            changes.append(f"smartcar.mass_kg at most {_down(lighter_kg)}")
        smoother_nm = (_WEAKEST * torque_nm - _HEAVIEST * share_nm) / _STIFFEST
        if smoother_nm > 0:
            changes.append(f"smartcar.gear_friction_nm at most {_down(smoother_nm)}")
        lighter_kg += load_kg - car.mass_kg
        if load and lighter_kg > 0:
            changes.append(f"{load}s of at most {_down(lighter_kg)} kg")
        yield Requirement(
            key,
            words,
            "Nm",
            torque_nm,
            gear_nm + share_nm,
            sure_nm,
            "smartcar.wheel_torque_nm",
            tuple(changes),
        )


def _grip(machines: Machines, number: int, gains: Gains) -> Requirement:
    """Return the need of friction: four wheels hold along rollers at 45 degrees; the rougher surface decides."""
    car = machines.car(number)
    friction = max(car.roller_friction, machines.slope.friction)
    limits = motion_limits(machines, number, gains)["up a slope, empty"]
    weight = math.cos(INCLINE_RAD) / math.sqrt(2)
    least = math.sin(INCLINE_RAD) / weight
    sure = (math.sin(INCLINE_RAD) + limits.acceleration / GRAVITY) / weight
    changes = [f"smartcar.roller_friction or slope.friction at least {_up(sure)}"]
    if friction > least:
        slower = GRAVITY * (friction - least) * weight
        changes.append(f"gains.drive.max_slope_acceleration at most {_down(slower)}")
    parameter = "smartcar.roller_friction"
    if machines.slope.friction > car.roller_friction:
        parameter = "slope.friction"
    return Requirement(
        "grip", "grip on a slope", "", friction, least, sure, parameter, tuple(changes)
    )


def _parking(machines: Machines, number: int) -> Requirement:
    car = machines.car(number)
    sure_nm = _climbing_nm(car, car.mass_kg + max(_loads(machines).values()))
    return Requirement(
        "park",
        "stand on a slope with a load, motors off",
        "Nm",
        car.gear_friction_nm,
        None,
        sure_nm,
        "smartcar.gear_friction_nm",
        (f"smartcar.gear_friction_nm at least {_up(sure_nm)}, or its motors hold it",),
    )


def _crest(machines: Machines, number: int) -> Requirement:
    car = machines.car(number)
    share_nm = _climbing_nm(car, car.mass_kg)
    spare_n = 2 * (car.wheel_torque_nm - car.gear_friction_nm - 2 * share_nm) / car.wheel_radius_m
    torque_nm = car.gear_friction_nm + 2 * share_nm
    return Requirement(
        "crest",
        "hold itself by one axle on a crest",
        "N",
        spare_n,
        None,
        0.0,
        "smartcar.wheel_torque_nm",
        (f"smartcar.wheel_torque_nm at least {_up(torque_nm)}, or it may shove what is beyond",),
    )


def _lifts(machines: Machines, number: int) -> Iterator[Requirement]:
    car = machines.car(number)
    for load, load_kg in _loads(machines).items():
        weight_n = (car.board_mass_kg + load_kg) * GRAVITY
        sure_n = (_HEAVIEST * weight_n + _STIFFEST * car.screw_friction_n) / _WEAKEST
        spare_n = _WEAKEST * car.board_force_n - _STIFFEST * car.screw_friction_n
        lighter_kg = spare_n / (_HEAVIEST * GRAVITY) - car.board_mass_kg
        changes = [f"smartcar.board_force_n at least {_up(sure_n)}"]
        if lighter_kg > 0:
            changes.append(f"{load}s of at most {_down(lighter_kg)} kg")
        yield Requirement(
            f"lift_{load}",
            f"lift a {load}",
            "N",
            car.board_force_n,
            weight_n + car.screw_friction_n,
            sure_n,
            "smartcar.board_force_n",
            tuple(changes),
        )


def _sags(machines: Machines, number: int) -> Iterator[Requirement]:
    """Yield the needs of stiffness: by what a raised board sags, its load is off; the judge allows half a gap."""
    car = machines.car(number)
    allowed_m = _half_gap_m(machines)
    for load, load_kg in _loads(machines).items():
        weight_n = (car.board_mass_kg + load_kg) * GRAVITY
        # Dry friction stops the board before its end, too.
        least_n_m = (weight_n + car.screw_friction_n) / allowed_m
        sure_n = _HEAVIEST * weight_n + _STIFFEST * car.screw_friction_n
        sure_n_m = sure_n / (_WEAKEST * allowed_m)
        yield Requirement(
            f"hold_{load}",
            f"hold a {load} level",
            "N/m",
            car.board_stiffness_n_m,
            least_n_m,
            sure_n_m,
            "smartcar.board_stiffness_n_m",
            (f"smartcar.board_stiffness_n_m at least {_up(sure_n_m)}",),
        )


def _half_gap_m(machines: Machines) -> float:
    widest_m = max(machines.block.side_m, machines.slope.side_m)
    return (CELL_PITCH_M - widest_m) / 2


def _hinge(machines: Machines) -> Requirement:
    slope = machines.slope
    model = compile_spec(machine_spec("slope", machines, visual=False))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    lever = data.body("flap").xipos - data.xanchor[model.joint("hinge").id]
    moment_nm = slope.flap_mass_kg * GRAVITY * math.hypot(lever[0], lever[2])
    least_nm = moment_nm + slope.hinge_friction_nm
    sure_nm = (_HEAVIEST * moment_nm + _STIFFEST * slope.hinge_friction_nm) / _WEAKEST
    return Requirement(
        "unfold",
        "fold and unfold a slope",
        "Nm",
        slope.hinge_torque_nm,
        least_nm,
        sure_nm,
        "slope.hinge_torque_nm",
        (f"slope.hinge_torque_nm at least {_up(sure_nm)}",),
    )


def _place(machines: Machines, gains: Gains) -> Requirement:
    """Return the need of half a gap, by which a car may miss its place beside a neighbour (the judge's ``place_m``)."""
    least_m = gains.drive.position_tolerance
    sure_m = least_m + gains.drive.position_certainty
    return Requirement(
        "place",
        "stop beside a neighbour",
        "mm",
        1e3 * _half_gap_m(machines),
        1e3 * least_m,
        1e3 * sure_m,
        "block.side_m",
        (f"block.side_m at most {CELL_PITCH_M - 2 * sure_m:.4f}",),
    )


def _rooms(machines: Machines, number: int) -> Iterator[Requirement]:
    """Yield the gaps between a car and what it drives under and over: files of cars that do not fit are refused."""
    car = machines.car(number)
    half_m = half_between_legs_m(machines.block)
    reaches_m = (
        car.chassis_length_m / 2,
        car.chassis_width_m / 2,
        car.wheel_x_m + car.wheel_radius_m,
        car.wheel_y_m + car.wheel_width_m / 2,
    )
    for key, words, gap_m, least_m, parameter in (
        (
            "under_block",
            "drive under a block",
            under_block_m(car, machines.block),
            HEAD_ROOM_M,
            "board_top_m",
        ),
        (
            "under_slope",
            "drive under a slope",
            under_slope_m(car, machines.slope),
            HEAD_ROOM_M,
            "board_top_m",
        ),
        (
            "between_legs",
            "pass between the legs of a block",
            half_m - max(reaches_m),
            ROOM_BESIDE_M,
            "wheel_y_m",
        ),
        (
            "over_crest",
            "drive over the crest of a slope",
            over_crest_m(car),
            CLEARANCE_M,
            "wheel_radius_m",
        ),
    ):
        # The last digits of a sum are no gap.
        least_mm = 1e3 * least_m - 1e-6
        yield Requirement(
            key, words, "mm", 1e3 * gap_m, least_mm, least_mm, f"smartcar.{parameter}"
        )


def _up(value: float) -> str:
    return _rounded(value, math.ceil)


def _down(value: float) -> str:
    return _rounded(value, math.floor)


def _rounded(value: float, whole: Callable[[float], int]) -> str:
    """Return a positive number with few digits, rounded to one side."""
    unit = 10.0 ** (math.floor(math.log10(value)) - _DIGITS + 1)
    return f"{whole(value / unit) * unit:.{_DIGITS}g}"


def motion_limits(machines: Machines, number: int, gains: Gains) -> dict[str, BindingLimits]:
    """Return the limits of speed and acceleration of a car's motions, by name."""
    car = machines.car(number)
    car_gains = gains_of_car(gains, car, machines)
    flat = SkillSetup(car, machines, car_gains, SimulationConfig().control_period_s)
    up = flat.on(Terrain(end_rad=INCLINE_RAD))
    load_kg = max(_loads(machines).values())
    motions = {
        "on the floor, empty": (Motion(flat, False, 0.0, 0.0), MOVE_LIMITS),
        "on the floor, loaded": (Motion(flat, True, load_kg, 0.0), MOVE_LIMITS),
        "up a slope, empty": (Motion(up, False, 0.0, 0.0), MOVE_LIMITS),
        "up a slope, loaded": (Motion(up, True, load_kg, 0.0), MOVE_LIMITS),
        "turning, empty": (Motion(flat, False, 0.0, 0.0), TURN_LIMITS),
        "turning, loaded": (Motion(flat, True, load_kg, 0.0), TURN_LIMITS),
    }
    limits = {}
    for name, (motion, functions) in motions.items():
        limits[name] = binding_limits(motion, functions)
    return limits


def following_gains(
    machines: Machines, number: int, gains: Gains
) -> dict[str, tuple[float, float]]:
    """Return the gains that follow from a machine, by section and name: as they are given, and as a car has them."""
    car_gains = gains_of_car(gains, machines.car(number), machines)
    values = {}
    for section, name in FOLLOWING:
        before = getattr(getattr(gains, section), name)
        values[f"{section}.{name}"] = (before, getattr(getattr(car_gains, section), name))
    return values


def remarks(machines: Machines = NOMINAL) -> list[str]:
    """Return as lines of text what the first car can do, with the nominal gains."""
    car = machines.car(0)
    raised_m = car.board_rest_m + car.board_travel_m
    lines = [
        f"mass {car.mass_kg:.4g} kg",
        f"top speed of the wheels {car.wheel_speed_rad_s * car.wheel_radius_m:.3g} m/s",
        f"board {1e3 * car.board_rest_m:.4g} to {1e3 * raised_m:.4g} mm above the floor",
        f"gap between neighbours {2e3 * _half_gap_m(machines):.3g} mm",
    ]
    for requirement in requirements(machines, 0, Gains()):
        words = f"{requirement.words}: {requirement.gives:.3g} {requirement.unit}".rstrip()
        if requirement.least is not None:
            words += f", where {requirement.least:.3g} is needed"
        lines.append(words)
    return lines
