"""What a world may have in its cells, as variables with bits for values; what cars see of each other is among it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from craftsim.compiled.jit import plain
from craftsim.discrete.grid import KINDS_WITH_YAW, CarField, Cell, Grid, Kind, beside
from craftsim.discrete.kernel import state as kernel_state
from craftsim.discrete.kernel.state import CarState

YAW_NAMES: Final = ("east", "north", "west", "south")
"""Names of the grid yaws."""


def _things() -> tuple[tuple[Kind, int], ...]:
    """Return what a cell may have, with its yaw."""
    things = []
    for kind in Kind:
        for yaw in range(4):
            if yaw == 0 or kind in KINDS_WITH_YAW:
                things.append((kind, yaw))
    return tuple(things)


def _thing_names() -> tuple[str, ...]:
    names = []
    for kind, yaw in THINGS:
        name = kind.name.lower()
        if kind in KINDS_WITH_YAW:
            name += f"-{YAW_NAMES[yaw]}"
        names.append(name)
    return tuple(names)


def _properties() -> dict[str, tuple[str, ...]]:
    """Return the values of each property of a cell."""
    properties: dict[str, tuple[str, ...]] = {"thing": _thing_names()}
    cars = ["no-car"]
    for load in ("unloaded", "loaded", "slope-loaded"):
        for place in ("", "-on-foot", "-above-body"):
            cars.append(f"{load}-car{place}")
    properties["car"] = tuple(cars)
    for name in YAW_NAMES:
        properties[f"gear-{name}"] = (f"no-carried-gear-{name}", f"carried-gear-{name}")
        properties[f"lean-{name}"] = (f"no-leaning-load-{name}", f"leaning-load-{name}")
    properties["mark"] = ("unmarked", "marked-object", "marked-car")
    properties["landing"] = ("no-landing", "landing")
    return properties


THINGS: Final = _things()
PROPERTIES: Final = _properties()
"""The values of each property of a cell, in the order of their bits: the thing in it, the car in it, the gears that
cars carry and the loads that lean into it, by the direction they point in; and its marks, where rules keep these."""
_CAR_LOADS: Final = {Kind.AIR: 0, Kind.BLOCK: 1, Kind.FLAG: 1, Kind.FSLOPE: 2}
SLOPE_CAR: Final = 0b1110000000
ANY_CAR: Final = 0b1111111110
LOADED_CAR: Final = 0b1111110000
MARKS: Final = {kernel_state.NOTHING: 0, kernel_state.OBJECT: 1}


class Variable(NamedTuple):
    """A property of a cell; its values are bits."""

    name: str
    """Of PROPERTIES."""
    cell: Cell


class Stance(NamedTuple):
    """A car, and the direction downhill of the ramp that it is on."""

    car: CarState
    downhill: int
    """-1 off ramps."""

    @property
    def cell(self) -> Cell:
        """The car's cell."""
        return self.car.x, self.car.y, self.car.z

    def visible(self) -> dict[Variable, int]:
        """Return what other cars see of it: bits of variables."""
        number = 1 + 3 * _CAR_LOADS[Kind(self.car.load)] + self.car.slope
        variables = {Variable("car", self.cell): 1 << number}
        if self.car.load == Kind.FSLOPE:
            yaw = self.car.load_yaw
            variables[Variable(f"gear-{YAW_NAMES[yaw]}", beside(self.cell, yaw))] = 2
        if self.car.load != Kind.AIR and self.downhill >= 0:
            name = f"lean-{YAW_NAMES[self.downhill]}"
            variables[Variable(name, beside(self.cell, self.downhill))] = 2
        return variables


@dataclass(frozen=True)
class LegalCase:
    """A case in which an action is legal."""

    conditions: Mapping[Variable, int]
    """The bits of which each variable has one."""
    effects: Mapping[Variable, int]
    """The bit that each variable then has."""
    after: Stance


def variables_of(grid: Grid) -> dict[Variable, int]:
    """Return the bits of a world; what is not named has its first value, and nothing beside the map has any."""
    variables = {}
    for x, y, z in np.ndindex(grid.kind.shape):
        kind, yaw, mark, landing = grid.cells[x, y, z].tolist()
        variables[Variable("thing", (x, y, z))] = things_mask(Kind(kind), (yaw,))
        variables[Variable("mark", (x, y, z))] = 1 << MARKS.get(mark, 2)
        variables[Variable("landing", (x, y, z))] = 1 << landing
    for car in range(grid.n_cars):
        variables |= stance_of(grid, car).visible()
    return variables


def stance_of(grid: Grid, car: int) -> Stance:
    """Return a car of a single world."""
    state = CarState(*grid.cars[car].tolist())
    downhill = _downhill_of(grid.world(), state.x, state.y, state.z, state.slope)
    return Stance(state, downhill)


_downhill_of: Final = plain(kernel_state.downhill_of)


def conceivable(grid: Grid) -> dict[Variable, int]:
    """Return the bits that variables may have in any world with the size, the walls and the things of a grid."""
    values = variables_of(grid)
    kinds = {Kind.AIR, *map(Kind, np.unique(grid.kind).tolist())}
    kinds |= set(map(Kind, np.unique(grid.cars[:, CarField.LOAD]).tolist()))
    has_slopes = bool(kinds & {Kind.FSLOPE, Kind.BODY})
    if has_slopes:
        kinds |= set(KINDS_WITH_YAW)
    things = 0
    for kind in kinds - {Kind.GROUND, Kind.WALL}:
        things |= KIND_MASKS[kind]
    cars = (1 << len(PROPERTIES["car"])) - 1
    pointing = 1
    if has_slopes:
        pointing = 3
    fixed = KIND_MASKS[Kind.GROUND] | KIND_MASKS[Kind.WALL]
    length, width, height = grid.size
    for x, y, z in np.ndindex(length, width, height + 2):
        cell = (x, y, z)
        values[Variable("mark", cell)] = 7
        values[Variable("landing", cell)] = 3
        if values.get(Variable("thing", cell), 0) & fixed:
            continue
        if z <= height:
            values[Variable("thing", cell)] = things
        values[Variable("car", cell)] = cars
        for name in YAW_NAMES:
            values[Variable(f"gear-{name}", cell)] = pointing
            values[Variable(f"lean-{name}", cell)] = pointing
    return values


def own_things(stance: Stance) -> int:
    """Return the bits of what may be in a car's cell: nothing but a gear or a foot with a load, and slopes behind it.

    So it is in all starts, and play keeps to it.
    """
    if stance.car.slope == 1:
        return things_mask(Kind.FOOT, (stance.downhill,))
    mask = KIND_MASKS[Kind.AIR] | KIND_MASKS[Kind.GEAR] | KIND_MASKS[Kind.FOOT]
    if stance.car.load != Kind.AIR:
        return mask
    mask |= KIND_MASKS[Kind.BLOCK] | KIND_MASKS[Kind.FLAG]
    behind = ((stance.car.yaw + 2) & 3,)
    return mask | things_mask(Kind.FSLOPE, behind) | things_mask(Kind.BODY, behind)


def things_mask(kind: Kind, yaws: Iterable[int]) -> int:
    """Return the bits of a kind with some yaws."""
    mask = 0
    for yaw in yaws:
        if (kind, yaw) in THINGS:
            mask |= 1 << THINGS.index((kind, yaw))
    return mask


def _masks(part: int) -> dict[int, int]:
    """Return the bits of the things of each kind (part 0) or of each yaw (part 1)."""
    masks: dict[int, int] = {}
    for number, thing in enumerate(THINGS):
        masks[thing[part]] = masks.get(thing[part], 0) | 1 << number
    return masks


KIND_MASKS: Final = _masks(0)
YAW_MASKS: Final = _masks(1)
SLOPE_THINGS: Final = KIND_MASKS[Kind.FSLOPE] | KIND_MASKS[Kind.BODY]
SECOND_PARTS: Final = tuple(
    things_mask(Kind.GEAR, (yaw,)) | things_mask(Kind.FOOT, (yaw,)) for yaw in range(4)
)
STANDING_THINGS: Final = SLOPE_THINGS | KIND_MASKS[Kind.FLAG] | KIND_MASKS[Kind.FOOT]


def merged(cases: Iterable[LegalCase], possible: Mapping[Variable, int]) -> list[LegalCase]:
    """Return fewer cases: those that differ in the conditions of one variable alone are one."""
    current = list(cases)
    n_before = 0
    while len(current) != n_before:
        n_before = len(current)
        variables: set[Variable] = set()
        for case in current:
            variables.update(case.conditions)
        for variable in sorted(variables):
            current = _merged_in(variable, current, possible.get(variable, 1))
    return current


def _merged_in(variable: Variable, cases: Iterable[LegalCase], all_values: int) -> list[LegalCase]:
    groups: dict[Any, LegalCase] = {}
    for case in cases:
        conditions = dict(case.conditions)
        own_bits = conditions.pop(variable, 0) & all_values
        key = (
            own_bits == 0,
            frozenset(conditions.items()),
            frozenset(case.effects.items()),
            case.after,
        )
        if own_bits and key in groups:
            own_bits |= groups[key].conditions.get(variable, all_values)
        if own_bits and own_bits != all_values:
            conditions[variable] = own_bits
        groups[key] = LegalCase(conditions, case.effects, case.after)
    return list(groups.values())
