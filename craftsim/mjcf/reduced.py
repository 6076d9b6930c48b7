"""The reduced drive: a car as one body that four motors push as ideally rolling mecanum wheels would."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from craftsim.mjcf.building import Point
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.mjcf.solids import second_moments

BRISTLES: Final = (200.0, 0.5)
"""Stiffness (Nm/rad) and damping (Nms/rad) of the dry friction of the reduced drive's gears: a loaded car on the slope
gives way by 0.1 mm before it holds, without swinging."""
STRIBECK_RAD_S: Final = 0.1
"""Without effect while friction at rest is that of motion."""


@dataclass(frozen=True)
class WholeCar:
    """Chassis and wheels of the reduced drive in one, and how its motors push it."""

    mass_kg: float
    centre_m: float
    """Height of the centre of mass above the floor."""
    inertia_kgm2: Point
    """About that centre."""
    spin_kgm2: float
    """Of a wheel and its motor about the axle."""
    armature: tuple[float, ...]
    """What the wheels' spin adds to the car's inertia: to its mass along x, y and z, and about its own x, y and z."""
    gears: tuple[tuple[float, ...], ...]
    """By wheel, in the order of WHEELS: what a twist of the car at its origin, on the floor, turns the wheel by."""
    lugre: tuple[float, ...]
    """Stiffness, damping, Coulomb and static friction and Stribeck speed of a gear, as MuJoCo's DC motor takes them."""

    @classmethod
    def of(cls, car: SmartcarParameters) -> WholeCar:
        """Return a car without its board."""
        mass = car.chassis_mass_kg + 4 * car.wheel_mass_kg
        centre = car.wheel_radius_m + car.chassis_mass_kg * car.chassis_com_m / mass
        radius, lever = car.wheel_radius_m, car.turn_radius_m
        spin = car.wheel_spin_inertia_kgm2 + car.wheel_armature_kgm2
        added = 4 * spin / radius**2
        armature = (added, added, 0.0, 0.0, 0.0, added * lever**2)
        signs = ((-1, -1), (1, 1), (1, -1), (-1, 1))
        gears = tuple((1 / radius, y / radius, 0.0, 0.0, 0.0, z * lever / radius) for y, z in signs)
        dry = car.gear_friction_nm
        lugre = (*BRISTLES, dry, dry, STRIBECK_RAD_S)
        return cls(mass, centre, _inertia(car, centre), spin, armature, gears, lugre)


def _inertia(car: SmartcarParameters, centre_m: float) -> Point:
    """Return the inertia of chassis and wheels about their common centre."""
    x, y, z = chassis_inertia(car)
    wheel, radius = car.wheel_mass_kg, car.wheel_radius_m
    tumble = wheel * (3 * radius**2 + car.wheel_width_m**2) / 12
    up = (
        car.chassis_mass_kg * (radius + car.chassis_com_m - centre_m) ** 2
        + 4 * wheel * (radius - centre_m) ** 2
    )
    along, across = 4 * wheel * car.wheel_x_m**2, 4 * wheel * car.wheel_y_m**2
    return (
        x + up + 4 * tumble + across,
        y + up + 4 * car.wheel_spin_inertia_kgm2 + along,
        z + 4 * tumble + along + across,
    )


def chassis_inertia(car: SmartcarParameters) -> Point:
    """Return the inertia of the chassis about its centre: that of its solid hull."""
    half, cut = car.chassis_length_m / 2, car.chassis_chamfer_m
    bottom, top = car.chassis_bottom_m, car.chassis_top_m
    outline = [
        (-half, bottom + cut),
        (cut - half, bottom),
        (half - cut, bottom),
        (half, bottom + cut),
        (half, top),
        (-half, top),
    ]
    xx, zz = second_moments(outline)
    yy = car.chassis_width_m**2 / 12
    m = car.chassis_mass_kg
    return m * (yy + zz), m * (xx + zz), m * (xx + yy)
