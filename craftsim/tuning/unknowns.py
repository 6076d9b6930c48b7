"""What may be identified from a log: figures of the machines, and what sensors and motors do to them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Final, Literal, TypeVar

import numpy as np

from craftsim.logs.log import Floats
from craftsim.mjcf.parameters import Machines

Record = TypeVar("Record")
Section = Literal["smartcar", "block", "noise", "mounting"]


@dataclass(frozen=True)
class Unknown:
    """Something that a log may tell."""

    section: Section
    """Of a machine's file, or ``noise`` of the file of noise; ``mounting`` is in neither."""
    name: str
    words: str
    usual: float
    """How far it is commonly from what is assumed, one standard deviation: as a share of a machine's figure, else in
    its own unit. It scales the search, and a log tells what it narrows to well below that."""
    weighed: int = 0
    """Of several that cannot be told apart, the one with the most is held: it is the easiest to measure otherwise."""

    scales: bool = False
    """Whether it is a force or an inertia by which the car's own motion is decided: all of these in proportion larger
    make no difference to it."""

    @property
    def key(self) -> str:
        """Section and name."""
        return f"{self.section}.{self.name}"

    @property
    def of_machine(self) -> bool:
        """Whether it is a figure of a machine; then it is above 0 and searched as a share of its start."""
        return self.section in ("smartcar", "block")


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
    Unknown("noise", "delay_s", "delay of the localisation", 0.03),
    Unknown("noise", "motor_lag_s", "lag of the wheel motors", 0.01),
    Unknown("noise", "encoder_lag_s", "lag of the wheel encoders", 0.01, 1),
    Unknown("mounting", "heading_bias_rad", "bias of the heading", 0.01),
    Unknown("mounting", "marker_x_m", "marker ahead of the wheels' centre", 0.005),
    Unknown("mounting", "marker_y_m", "marker left of the wheels' centre", 0.005),
)
_OF_LOAD: Final = ("block.deck_mass_kg",)
_OF_ROLLERS: Final = ("smartcar.roller_friction",)
"""Wheels of the reduced drive do not slip by themselves: it can follow a log of slipping wheels with a wrong figure."""

_LIMITS: Final[dict[str, tuple[float, float]]] = {
    "delay_s": (0.0, 0.4),
    "motor_lag_s": (0.0, 0.3),
    "encoder_lag_s": (0.0, 0.3),
    "heading_bias_rad": (-0.2, 0.2),
    "marker_x_m": (-0.1, 0.1),
    "marker_y_m": (-0.1, 0.1),
}
_FACTOR: Final = 3.0
"""A figure of a machine is sought within this factor of its start."""
_START: Final[dict[str, float]] = {"delay_s": 0.02, "motor_lag_s": 0.005, "encoder_lag_s": 0.005}
"""Not at their limits, where a search is one-sided."""


def unknowns_of(machines: Machines, loaded: bool) -> list[Unknown]:
    """Return what a log may tell of such machines; ``loaded``: a block was lifted."""
    left_out = (() if loaded else _OF_LOAD) + (() if machines.drive == "rollers" else _OF_ROLLERS)
    return [one for one in UNKNOWNS if one.key not in left_out]


Values = Mapping[str, float]
"""By key."""


class FitSpace:
    """The vector that is sought: each unknown less its start, in terms of how far it commonly is from that."""

    def __init__(self, machines: Machines, unknowns: Sequence[Unknown]) -> None:
        """Start from these machines, of one car."""
        self.machines, self.unknowns = machines, tuple(unknowns)
        self._starts = [self._start(one) for one in self.unknowns]
        self.bounds = self._bounds()
        """Lower and upper, each (n,)."""

    def values(self, vector: Floats) -> dict[str, float]:
        """Return what a vector stands for, by key."""
        found = {}
        for one, start, number in zip(self.unknowns, self._starts, vector.tolist(), strict=True):
            found[one.key] = (
                start * math.exp(one.usual * number) if one.of_machine else start + one.usual * number
            )
        return found

    def step(self, number: int, vector: Floats) -> float:
        """Return by how much to change a number of a vector for a difference quotient: inwards, where at its bound."""
        one = self.unknowns[number]
        step = 0.01 / one.usual if one.of_machine else 0.05
        return -step if vector[number] + step > self.bounds[1][number] else step

    def made(self, values: Values) -> Machines:
        """Return the machines of some values, whether or not they fit under blocks and slopes: none is near."""
        return machines_of(self.machines, values)

    def _start(self, one: Unknown) -> float:
        match one.section:
            case "smartcar":
                return float(getattr(self.machines.car(0), one.name))
            case "block":
                return float(getattr(self.machines.block, one.name))
        return _START.get(one.name, 0.0)

    def _bounds(self) -> tuple[Floats, Floats]:
        bounds = np.empty((2, len(self.unknowns)))
        for k, (one, start) in enumerate(zip(self.unknowns, self._starts, strict=True)):
            if one.of_machine:
                bounds[:, k] = -math.log(_FACTOR) / one.usual, math.log(_FACTOR) / one.usual
            else:
                low, high = _LIMITS[one.name]
                bounds[:, k] = (low - start) / one.usual, (high - start) / one.usual
        return bounds[0], bounds[1]


def machines_of(machines: Machines, values: Values) -> Machines:
    """Return machines of one car, the first, with some of their figures replaced and not checked."""

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
