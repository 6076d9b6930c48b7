"""All machines of a world: its cars, blocks and slopes, whether they fit each other, and files of them."""

from __future__ import annotations

import math
from dataclasses import asdict, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field

from craftsim.discrete.readback import LIFT_RANGE_M
from craftsim.errors import InputError
from craftsim.mjcf.drives import Drive
from craftsim.mjcf.parameters import (
    BlockParameters,
    ContactParameters,
    SlopeParameters,
    SmartcarParameters,
    digest_of,
    require,
)
from craftsim.storage.limits import Range
from craftsim.storage.paths import is_file
from craftsim.storage.records import Loc, described, key_words, record, unknown_words
from craftsim.storage.yaml import Document, read_document
from craftsim.workers.modules import find_named, plug_ins

HEAD_ROOM_M: Final = 0.001
"""What must be left between a lowered board and what it drives under."""
ROOM_BESIDE_M: Final = 0.010
"""What must be left between a car and the legs that it drives between."""
_LIFT_MARGIN_M: Final = 0.002
"""A lift must keep this far from the range in which a load counts as carried."""


@record()
class Machines:
    """The parameters of everything in a world: hashable, and written into every report.

    Raises InputError for cars that do not fit under the blocks and slopes, or cannot lift them.

    Example:
        >>> import craftsim
        >>> light, heavy = craftsim.SmartcarParameters(), craftsim.SmartcarParameters(chassis_mass_kg=2.0)
        >>> machines = craftsim.Machines(cars=(light, heavy))
        >>> machines.car(1).chassis_mass_kg
        2.0
    """

    cars: Annotated[tuple[SmartcarParameters, ...], Field(min_length=1)] = (SmartcarParameters(),)
    """One for each car, by id, or a single one for all."""
    block: BlockParameters = BlockParameters()
    slope: SlopeParameters = SlopeParameters()
    contact: ContactParameters = ContactParameters()
    drive: Drive = "wheels"
    """Of all cars. On ``wheels`` a wheel has one tyre, whose friction acts along its rollers; on ``rollers``, several
    times as slow, it bears ten free rollers (docs/explanation/drives.md)."""

    def __post_init__(self) -> None:
        _check_machines(self)

    def car(self, index: int) -> SmartcarParameters:
        """Return the parameters of car number ``index``."""
        return self.cars[index] if len(self.cars) > 1 else self.cars[0]

    def check_number(self, n_cars: int) -> None:
        """Raise InputError unless these are parameters for a world of ``n_cars`` cars."""
        if len(self.cars) not in (1, n_cars) and n_cars:
            raise InputError(
                f"figures of {len(self.cars)} cars are given for a world with {n_cars}; give one, or one for each"
            )

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all parameters, in hexadecimal: equal for equal ones."""
        return digest_of(asdict(self))

    @property
    def lightest_load_kg(self) -> float:
        """Mass of the lightest thing that a board lifts."""
        return min(self.block.mass_kg, self.slope.mass_kg)


def half_between_legs_m(block: BlockParameters) -> float:
    """Return half of what is free between the legs of a block."""
    return block.leg_offset_m - block.leg_side_m / 2


def under_block_m(car: SmartcarParameters, block: BlockParameters) -> float:
    """Return what is left between the boss of a lowered board and a block's frame."""
    return block.underside_m - car.boss_height_m - car.board_rest_m


def under_slope_m(car: SmartcarParameters, slope: SlopeParameters) -> float:
    """Return what is left between a lowered board and a slope's rails, or its boss and the back bar that it passes."""
    bar_m = slope.underside_m + slope.stop_back_rise_m
    return min(slope.underside_m, bar_m - car.boss_height_m) - car.board_rest_m


def _check_machines(machines: Machines) -> None:
    """Raise ValueError, naming the parameter, for a car that does not fit under the loads or cannot lift them."""
    block = machines.block
    slope = machines.slope
    low, high = sorted((block.underside_m, slope.underside_m))
    half_room = half_between_legs_m(block) - ROOM_BESIDE_M
    for car in machines.cars:
        for name, reach, limit in (
            ("chassis_length_m", car.chassis_length_m / 2, f"{2 * half_room:.3f}"),
            ("chassis_width_m", car.chassis_width_m / 2, f"{2 * half_room:.3f}"),
            (
                "wheel_x_m",
                car.wheel_x_m + car.wheel_radius_m,
                f"{half_room - car.wheel_radius_m:.4f}",
            ),
            (
                "wheel_y_m",
                car.wheel_y_m + car.wheel_width_m / 2,
                f"{half_room - car.wheel_width_m / 2:.4f}",
            ),
        ):
            message = (
                f"{name} is {getattr(car, name):g}; at most {limit} passes between a block's legs"
            )
            require(reach <= half_room, message)
        lowered = car.board_rest_m
        travel = car.board_travel_m
        room = under_slope_m(car, slope)
        require(
            room >= HEAD_ROOM_M - 1e-9,
            f"board_top_m and wheel_radius_m put the lowered board {lowered:.4f} over the floor; "
            f"at most {lowered + room - HEAD_ROOM_M:.4f} drives under a slope",
        )
        shortest = high - lowered + LIFT_RANGE_M[0] + _LIFT_MARGIN_M
        longest = low - lowered + LIFT_RANGE_M[1] - _LIFT_MARGIN_M
        require(
            shortest <= travel <= longest,
            f"board_travel_m is {travel:g}; from {shortest:.4f} to {longest:.4f} lifts blocks and slopes clear of the "
            f"ground",
        )


NOMINAL: Final = Machines()
"""The published machines."""


@record(kw_only=True)
class _File:
    smartcar: SmartcarParameters = SmartcarParameters()
    block: BlockParameters = BlockParameters()
    slope: SlopeParameters = SlopeParameters()
    contact: ContactParameters = ContactParameters()
    cars: Annotated[tuple[SmartcarParameters, ...], Field(min_length=1)] | None = None
    gains: Any = None


PARTS: Final = {"chassis_mass_kg": 1, "wheel_mass_kg": 4, "board_mass_kg": 1}
"""The masses that make up a car's, and how often it has each."""
TOTAL: Final = "mass_kg"
"""The key of a file for the mass of a whole car."""
_SAME: Final = 1e-9
"""Masses are equal if they differ by this share: what sums add to their last digits is no other mass."""

MACHINE_SECTIONS: Final = tuple(
    section.name for section in fields(_File) if section.name != "gains"
)
"""The keys of a file that hold machines' parameters."""


def machine_file(name: Path | str) -> Path:
    """Return the YAML file of machines that a path stands for, or the name that an installed package gives a file.

    Such a name is an entry point of the group ``craftsim.machines``: the path of a file of the package, which is
    imported for it. Raises InputError for one that is no path.
    """
    text = str(name)
    if Path(text).suffix or is_file(text):
        return Path(text)
    installed = plug_ins("machines")
    if text not in installed:
        return Path(text)
    value = find_named(installed[text], f"machines '{text}'", "module:PATH")
    if not isinstance(value, str | Path):
        raise InputError(
            f"machines '{text}': {installed[text]} is a {type(value).__name__}; it must be the path of a YAML file"
        )
    return Path(value)


def load_machines(path: Path | str) -> Machines:
    """Return the machines of a YAML file: the nominal parameters, overridden by those that the file gives.

    It has the sections ``smartcar``, ``block``, ``slope`` and ``contact``, each with any of the parameters of its
    record, and a list ``cars`` of parameters by which single cars differ from ``smartcar``, one entry for each car. A
    section ``gains`` is left to :func:`craftsim.skills.gains.load_gains`. A car may also have ``mass_kg``, its whole
    mass: of chassis, wheels and board those that are named beside it keep their mass, and the others share what is left
    in proportion to what they would have without it.

    Raises InputError, naming the file, line and parameter, for an unknown parameter, one that cannot be changed, one
    out of range, and parameters that do not fit together.

    Example:
        >>> import craftsim
        >>> _ = (folder / "heavy.yaml").write_text("smartcar: {chassis_mass_kg: 2.0}")
        >>> craftsim.load_machines(folder / "heavy.yaml").car(0).chassis_mass_kg
        2.0
    """
    document = read_document(Path(path))
    smartcar = document.plain.get("smartcar", {})
    cars = document.plain.get("cars")
    if isinstance(smartcar, dict):
        smartcar = _with_parts(document, ("smartcar",), smartcar, {})
        plain = document.plain | {"smartcar": smartcar}
        if isinstance(cars, list):
            plain["cars"] = []
            for number, car in enumerate(cars):
                if isinstance(car, dict):
                    car = smartcar | _with_parts(document, ("cars", number), car, smartcar)
                plain["cars"].append(car)
        document = replace(document, plain=plain)
    file = document.to(_File)
    try:
        return Machines(file.cars or (file.smartcar,), file.block, file.slope, file.contact)
    except InputError as error:
        document.fail((), str(error))


def _with_parts(
    document: Document, loc: Loc, car: dict[str, Any], base: dict[str, Any]
) -> dict[str, Any]:
    """Return the parameters of a car, the masses of its parts in place of the whole; ``base`` has those of all cars."""
    known_names = (TOTAL, *(parameter.name for parameter in fields(NOMINAL.cars[0])))
    for name in car:
        # The record would refuse it, too, but does not know of the mass of all parts.
        if isinstance(name, str) and name not in known_names:
            document.fail((*loc, name), unknown_words(name, known_names))
    if TOTAL not in car:
        return car
    total_loc = (*loc, TOTAL)
    total = car[TOTAL]
    allowed = Range(0.0, above=True)
    if not isinstance(total, int | float):
        document.fail(
            total_loc,
            f"{key_words(total_loc)}: must be a number {allowed.words}, not {described(total)}",
        )
    if total not in allowed:
        document.fail(total_loc, f"{key_words(total_loc)}: {allowed.out(total)}")
    usual = asdict(NOMINAL.cars[0]) | base
    named_kg = 0.0
    shared_kg = 0.0
    for name, number in PARTS.items():
        mass = car.get(name, usual[name])
        if not isinstance(mass, int | float):
            # The record refuses it.
            return car
        if name in car:
            named_kg += number * mass
        else:
            shared_kg += number * mass
    names = ", ".join(name for name in PARTS if name in car)
    if not shared_kg:
        if not math.isclose(named_kg, total, rel_tol=_SAME):
            document.fail(
                total_loc,
                f"{key_words(total_loc)}: is {total:g}, but {names} make {named_kg:g}; leave out those that shall "
                f"follow from it",
            )
        factor = 1.0
    else:
        factor = (total - named_kg) / shared_kg
    if factor <= 0:
        document.fail(
            total_loc,
            f"{key_words(total_loc)}: is {total:g}, of which {names} take {named_kg:g}: nothing is left for the other "
            f"parts",
        )
    if math.isclose(factor, 1.0, rel_tol=_SAME):
        factor = 1.0
    parts = {}
    for name in PARTS:
        if name not in car:
            parts[name] = factor * usual[name]
    # Rollers are a part of the wheels.
    if "wheel_mass_kg" in parts and "roller_mass_kg" not in car:
        parts["roller_mass_kg"] = factor * usual["roller_mass_kg"]
    of_file = {name: value for name, value in car.items() if name != TOTAL}
    return of_file | parts
