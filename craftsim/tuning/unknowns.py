"""The unknowns that may be identified from a log: parameters of machines, sensors and motors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final, Literal, TypeVar

from craftsim.mjcf.parameters import Machines

Record = TypeVar("Record")
Values = Mapping[str, float]
"""By key."""
Section = Literal["smartcar", "block", "noise", "mounting"]


@dataclass(frozen=True)
class Unknown:
    """An unknown parameter."""

    section: Section
    """Of a machine's file, or ``noise`` of the file of noise; ``mounting`` is in neither."""
    name: str
    words: str
    usual: float
    """How far it is commonly from what is assumed, one standard deviation: as a share of a machine's parameter, else in
    its own unit. It scales the search, and a log tells what it narrows to well below that."""
    weighed: int = 0
    """Of several that cannot be told apart, the one with the most is held: it is the easiest to measure otherwise."""
    scales: bool = False
    """Whether it is a force or an inertia by which the car's own motion is decided: all of these in proportion larger
    make no difference to it."""
    limits: tuple[float, float] = (0.0, 0.0)
    """Between which it is sought; a machine's parameter is sought within a factor of its start."""
    assumed: float = 0.0
    """Where its search starts, not at its limits, where it would be one-sided; a machine's parameter starts at its
    assumed value."""

    @property
    def key(self) -> str:
        """Section and name."""
        return f"{self.section}.{self.name}"

    @property
    def of_machine(self) -> bool:
        """Whether it is a parameter of a machine; then it is above 0 and searched as a share of its start."""
        return self.section in ("smartcar", "block")

    def start(self, machines: Machines) -> float:
        """Return what is assumed of it: where the search starts."""
        match self.section:
            case "smartcar":
                return float(getattr(machines.car(0), self.name))
            case "block":
                return float(getattr(machines.block, self.name))
        return self.assumed

    def value(self, start: float, number: float) -> float:
        """Return what it is where it is so many common errors from its start, as the search counts."""
        return start * math.exp(self.usual * number) if self.of_machine else start + self.usual * number

    def bounds(self, start: float) -> tuple[float, float]:
        """Return the least and the largest such number."""
        if self.of_machine:
            return -math.log(_FACTOR) / self.usual, math.log(_FACTOR) / self.usual
        low, high = self.limits
        return (low - start) / self.usual, (high - start) / self.usual

    @property
    def step(self) -> float:
        """Such a number for a difference quotient."""
        return 0.01 / self.usual if self.of_machine else 0.05


UNKNOWNS: Final = (
    Unknown("smartcar", "wheel_radius_m", "radius of the wheels", 0.02),
    Unknown("smartcar", "wheel_y_m", "half the track", 0.05),
    Unknown("smartcar", "wheel_gain_nms_rad", "gain of the wheel motors", 0.3, 2, True),
    Unknown("smartcar", "wheel_torque_nm", "torque limit of the wheel motors", 0.3, 0, True),
    Unknown("smartcar", "gear_friction_nm", "dry friction of the gears", 0.3, 0, True),
    Unknown("smartcar", "wheel_armature_kgm2", "inertia of the wheel motors", 0.3, 1, True),
    Unknown("smartcar", "wheel_mass_kg", "mass of the car, most of it in its wheels", 0.2, 3, True),
    Unknown("smartcar", "roller_friction", "friction between wheels and floor", 0.3, 1),
    Unknown("smartcar", "board_mass_kg", "mass of the board", 0.2),
    Unknown("smartcar", "screw_friction_n", "dry friction of the board's screw", 0.3),
    Unknown("smartcar", "board_damping_ns_m", "grease on the board's screw", 0.3, 1),
    Unknown("block", "deck_mass_kg", "mass of the block's deck", 0.2),
    Unknown("noise", "delay_s", "delay of the localisation", 0.03, limits=(0.0, 0.4), assumed=0.02),
    Unknown("noise", "motor_lag_s", "lag of the wheel motors", 0.01, limits=(0.0, 0.3), assumed=0.005),
    Unknown("noise", "encoder_lag_s", "lag of the wheel encoders", 0.01, 1, limits=(0.0, 0.3), assumed=0.005),
    Unknown("mounting", "heading_bias_rad", "bias of the heading", 0.01, limits=(-0.2, 0.2)),
    Unknown("mounting", "marker_x_m", "marker ahead of the wheels' centre", 0.005, limits=(-0.1, 0.1)),
    Unknown("mounting", "marker_y_m", "marker left of the wheels' centre", 0.005, limits=(-0.1, 0.1)),
)
_OF_LOAD: Final = ("block.deck_mass_kg",)
_OF_ROLLERS: Final = ("smartcar.roller_friction",)
"""Wheels of the reduced drive do not slip by themselves: it can follow a log of slipping wheels with a wrong figure."""

_FACTOR: Final = 3.0
"""A figure of a machine is sought within this factor of its start."""


def unknowns_of(machines: Machines, loaded: bool) -> list[Unknown]:
    """Return what a log may tell of such machines; ``loaded``: a block was lifted."""
    left_out = (() if loaded else _OF_LOAD) + (() if machines.drive == "rollers" else _OF_ROLLERS)
    return [one for one in UNKNOWNS if one.key not in left_out]


def machines_of(machines: Machines, values: Values) -> Machines:
    """Return machines of one car, the first, with some of their parameters replaced.

    They are not checked, for they need not fit under blocks and slopes: none is near.
    """

    def of(section: str) -> dict[str, float]:
        return {
            key.partition(".")[2]: value for key, value in values.items() if key.startswith(section + ".")
        }

    car = _unchecked(machines.car(0), of("smartcar"))
    return _unchecked(machines, {"cars": (car,), "block": _unchecked(machines.block, of("block"))})


def _unchecked(record: Record, changes: Mapping[str, Any]) -> Record:
    """Return a copy of a frozen record with other values, without its own check of them."""
    made = object.__new__(type(record))
    for field in fields(record):  # type: ignore[arg-type]
        object.__setattr__(made, field.name, changes.get(field.name, getattr(record, field.name)))
    return made
