"""The rules at work in a world of which a car alone is certain: what else is there is decided when they ask for it.

The rules themselves run, as plain Python, with other functions that look at the world: a question with two possible
answers is answered once with no and once with yes. So all cases come about in which an action is legal, each with what
it asks of the world and what it changes, and no rule is written a second time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Final

import numpy as np

from craftsim.compiled.jit import plain
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, beside
from craftsim.discrete.kernel import codes as code
from craftsim.discrete.kernel import patterns as bits
from craftsim.discrete.kernel import rules as kernel_rules
from craftsim.discrete.kernel import state as kernel_state
from craftsim.discrete.kernel.state import CarState, World
from craftsim.discrete.kinds import CellField
from craftsim.discrete.learned import Variant, variants
from craftsim.discrete.rules import Rules
from craftsim.planning.variables import (
    ANY_CAR,
    KIND_MASKS,
    LOADED_CAR,
    MARKS,
    SECOND_PARTS,
    SLOPE_CAR,
    SLOPE_THINGS,
    STANDING_THINGS,
    THINGS,
    YAW_MASKS,
    YAW_NAMES,
    LegalCase,
    Stance,
    Variable,
    merged,
    own_things,
    things_mask,
)

_A_CAR: Final = 0
"""Number of whatever other car there is."""
_ME: Final = 1
_MOST_ANSWERS: Final = 20_000
"""To what an action of a car in a cell asks for: some hundred times by the rules of the package, any number of times by
many learned patterns of several cells."""
_NOWHERE: Final = Stance(CarState(0, 0, 0, 0, 0, 0, 0), -1)
_reaches_up: Final = plain(kernel_state.reaches_up)
_pattern_bit: Final = plain(bits.thing_bit)
_car_bit: Final = plain(bits.car_bit_of)


class UndecidedWorld:
    """A world of which only is certain what may be where; see :meth:`cases`."""

    def __init__(self, grid: Grid, rules: Rules, possible: Mapping[Variable, int]) -> None:
        """Make a world that has the size and the things of a grid.

        Args:
            grid: a single world.
            rules: what decides.
            possible: the bits that variables may have; what is not named has its first value.
        """
        self._shape = grid.kind.shape
        loads = grid.cars[:, CarField.LOAD]
        self._n_blocks = int((grid.kind == Kind.BLOCK).sum() + (loads == Kind.BLOCK).sum())
        slopes = np.isin(grid.kind, (Kind.FSLOPE, Kind.BODY))
        self._n_slopes = int(slopes.sum() + (loads == Kind.FSLOPE).sum())
        self._n_cars = grid.n_cars
        self._possible = possible
        self._is_marked = not rules.corrections & kernel_state.DERIVED_MARKS
        self._variants: list[Variant] = []
        if rules.learned is not None:
            for rule in rules.learned.rules:
                self._variants += variants(rule)
        self._answers: list[bool] = []
        self._n_answered = 0
        self._known: dict[Variable, int] = {}
        self._written: dict[Variable, int] = {}
        self._overwrites = False
        self._action = 0
        self._excluded = 0
        """Things that are not in the car's cell."""
        self._me = _NOWHERE
        self._new = _NOWHERE.car
        cells: Any = _Cells((*self._shape, len(CellField)), self._write)
        cars: Any = _Cars()
        self._world = World(cells, cars, int(rules.corrections), rules.patterns)
        readers: dict[str, Callable[..., Any]] = {
            "kind_at": self._kind_at,
            "yaw_at": self._yaw_at,
            "car_in": self._car_in,
            "carried_gear_in": self._carried_gear_in,
            "leans_into": self._leans_into,
            "reaches_up": self._reaches_up,
            "gear_across": self._gear_across,
            "put": self._put,
            "_set_occupant": self._set_occupant,
            "state_of_car": lambda w, me: self._me.car,
            "meets_turning_load": self._meets_turning_load,
            "why_learned": self._why_learned,
        }
        if self._is_marked:
            readers["occupant_of"] = self._marked_occupant
            readers["is_landing"] = self._marked_landing
        else:
            readers["occupant_of"] = self._derived_occupant
        self._why = plain(kernel_rules.why, readers)
        self._after = plain(kernel_state.after, readers)
        self._apply = plain(kernel_state.apply, readers | {"after": self._decided_after})
        self._downhill_of = plain(kernel_state.downhill_of, readers)
        self._own_number = plain(bits.own_number, readers)
        self._frame_of = plain(bits.frame_of)
        self._verb_of = plain(bits.verb_of)

    def cases(self, stance: Stance, action: int) -> list[LegalCase] | None:
        """Return the cases in which a car may do an action; None if there are too many.

        Two actions that the published rules allow have no case: a car drives into the cell of another one, on a ramp,
        or a load or a gear takes the place of a thing, which is gone then. So things and cars stay as many as they are,
        and stand on something; what would take more of them has no case, either.
        """
        self._answers = []
        cases = []
        for _ in range(_MOST_ANSWERS):
            case = self._case(stance, action)
            if case is not None:
                cases.append(case)
            while self._answers and self._answers[-1]:
                self._answers.pop()
            if not self._answers:
                return merged(cases, self._possible)
            self._answers[-1] = True
        return None

    def _case(self, stance: Stance, action: int) -> LegalCase | None:
        """Return what an action asks for and changes with the answers as they are; None if it is forbidden."""
        self._me = stance
        self._n_answered = 0
        self._written = {}
        self._overwrites = False
        self._action = action
        self._known = {}
        self._excluded = ~own_things(stance)
        x, y, z = stance.cell
        if stance.car.slope == 2:
            body = things_mask(Kind.BODY, (stance.downhill,))
            self._known[Variable("thing", (x, y, z - 1))] = body
        if self._why(self._world, _ME, stance.car, action) != code.LEGAL:
            return None
        self._apply(self._world, _ME, action)
        car = self._new
        if self._overwrites or self._car_in(self._world, _ME, car.x, car.y, car.z, False) >= 0:
            return None
        downhill = int(self._downhill_of(self._world, car.x, car.y, car.z, car.slope))
        after = Stance(car, downhill)
        effects = self._written | dict.fromkeys(stance.visible(), 1) | after.visible()
        conditions = dict(self._known)
        own_thing = Variable("thing", stance.cell)
        if conditions.get(own_thing, 0).bit_count() > 1:
            # What is excluded in any case need not be asked for.
            conditions[own_thing] |= self._possible[own_thing] & self._excluded
        return LegalCase(conditions, effects, after)

    def _can_be(self, variable: Variable, value: int) -> bool:
        """Return whether the world has all that was answered, and what has to be below it, with a further answer."""
        blocks = set()
        slopes = set()
        cars = {self._me.cell}
        others = set()
        slope_cars = set()
        load = self._me.car.load
        if load == Kind.FSLOPE:
            slope_cars.add(self._me.cell)
        for (name, cell), remaining in (*self._known.items(), (variable, value)):
            if name == "thing":
                if remaining & ~KIND_MASKS[Kind.BLOCK] == 0:
                    blocks.add(cell)
                elif remaining & ~SLOPE_THINGS == 0:
                    slopes.add(cell)
                elif remaining & ~STANDING_THINGS == 0:
                    others.add(cell)
                for yaw in range(4):
                    if remaining & ~SECOND_PARTS[yaw] == 0:
                        slopes.add(beside(cell, yaw + 2))
            elif name == "car" and remaining & 1 == 0:
                cars.add(cell)
                if remaining & ~SLOPE_CAR == 0:
                    slope_cars.add(cell)
            elif remaining == 2 and name.startswith(("gear", "lean")):
                noun, _, direction = name.partition("-")
                source = beside(cell, YAW_NAMES.index(direction) + 2)
                cars.add(source)
                if noun == "gear":
                    slope_cars.add(source)
        supports = blocks | slopes
        for x, y, z in (*blocks, *slopes, *others, *cars):
            for below in range(1, z):
                supports.add((x, y, below))
        n_carried = len(slope_cars) + (load == Kind.BLOCK)
        return (
            len(cars) <= self._n_cars
            and len(blocks) + (load == Kind.BLOCK) <= self._n_blocks
            and len(slopes) + len(slope_cars) <= self._n_slopes
            and len(supports) + n_carried <= self._n_blocks + self._n_slopes
        )

    def _holds(self, name: str, cell: Cell, mask: int) -> bool:
        """Decide whether a variable has one of some bits."""
        variable = Variable(name, cell)
        written = self._written.get(variable)
        if written is not None:
            return written & mask != 0
        remaining = self._known.get(variable)
        if remaining is None:
            remaining = self._possible.get(variable, 1)
            if name == "thing" and cell == self._me.cell:
                remaining &= ~self._excluded
        if remaining & mask == 0:
            return False
        if remaining & ~mask == 0:
            return True
        if not self._can_be(variable, remaining & mask):
            return False
        if self._n_answered == len(self._answers):
            self._answers.append(False)
        answer = self._answers[self._n_answered]
        self._n_answered += 1
        if answer:
            self._known[variable] = remaining & mask
        else:
            self._known[variable] = remaining & ~mask
        return answer

    def _is_inside(self, cell: Cell) -> bool:
        return all(0 <= place < side for place, side in zip(cell, self._shape, strict=True))

    def _write(self, name: str, cell: Cell, value: int) -> None:
        if name == "thing" or self._is_marked:
            self._written[Variable(name, cell)] = 1 << value

    # What the rules' functions of the same names answer.

    def _kind_at(self, w: World, x: int, y: int, z: int) -> Any:
        if not (0 <= x < self._shape[0] and 0 <= y < self._shape[1]):
            return int(Kind.WALL)
        if z >= self._shape[2]:
            return int(Kind.AIR)
        return _UndecidedKind(lambda mask: self._holds("thing", (x, y, z), mask))

    def _yaw_at(self, w: World, x: int, y: int, z: int) -> int:
        for yaw in range(3):
            if self._holds("thing", (x, y, z), YAW_MASKS[yaw]):
                return yaw
        return 3

    def _car_in(self, w: World, me: int, x: int, y: int, z: int, only_loaded: bool) -> int:
        mask = ANY_CAR
        if only_loaded:
            mask = LOADED_CAR
        if (x, y, z) != self._me.cell and self._holds("car", (x, y, z), mask):
            return _A_CAR
        return -1

    def _points_into(self, noun: str, yaw: int, cell: Cell) -> bool:
        """Decide whether a gear or load of another car points into a cell; never that of the remaining one."""
        if beside(cell, yaw + 2) == self._me.cell:
            return False
        return self._holds(f"{noun}-{YAW_NAMES[yaw & 3]}", cell, 2)

    def _carried_gear_in(
        self, w: World, me: int, x: int, y: int, z: int, tolerated_yaw: int
    ) -> bool:
        yaws = [yaw for yaw in range(4) if yaw != tolerated_yaw]
        return any(self._points_into("gear", yaw, (x, y, z)) for yaw in yaws)

    def _leans_into(self, w: World, me: int, x: int, y: int, z: int, tolerated: int) -> bool:
        yaws = [yaw for yaw in range(4) if yaw != tolerated]
        return any(self._points_into("lean", yaw, (x, y, z)) for yaw in yaws)

    def _gear_across(self, w: World, me: int, x: int, y: int, z: int, along: int) -> bool:
        for yaw in ((along + 1) & 3, (along + 3) & 3):
            if self._stands_with_gear(yaw, (x, y, z)) or self._points_into("gear", yaw, (x, y, z)):
                return True
        return False

    def _stands_with_gear(self, yaw: int, cell: Cell) -> bool:
        """Decide whether a folded slope stands beside a cell and points into it."""
        source = beside(cell, yaw + 2)
        mask = things_mask(Kind.FSLOPE, (yaw,))
        return self._is_inside(source) and self._holds("thing", source, mask)

    def _reaches_up(self, w: World, me: int, x: int, y: int, z: int, height_mm: int) -> bool:
        mask = _tall_loads(height_mm)
        below = (x, y, z - 1)
        if below != self._me.cell and self._holds("car", below, mask):
            return True
        return height_mm < 50 and self._leans_into(w, me, *below, -1)

    def _meets_turning_load(
        self, w: World, me: int, car: CarState, corner_x: int, corner_y: int
    ) -> int:
        cell = self._me.cell
        for yaw in range(4):
            neighbour = beside(cell, yaw)
            if self._car_in(w, me, *neighbour, True) >= 0:
                return code.LOAD_HITS_LOAD
            if self._carried_gear_in(w, me, *neighbour, (yaw + 2) & 3):
                return code.LOAD_HITS_GEAR
        is_slope = car.load == Kind.FSLOPE
        if is_slope and self._car_in(w, me, corner_x, corner_y, car.z, True) >= 0:
            return code.LOAD_HITS_LOAD
        return code.LEGAL

    def _marked_occupant(self, w: World, x: int, y: int, z: int, me: int) -> int:
        if not self._is_inside((x, y, z)) or self._holds("mark", (x, y, z), 1):
            return kernel_state.NOTHING
        if self._holds("mark", (x, y, z), 2):
            return kernel_state.OBJECT
        return _A_CAR

    def _derived_occupant(self, w: World, x: int, y: int, z: int, me: int) -> int:
        if not self._is_inside((x, y, z)):
            return kernel_state.NOTHING
        if self._car_in(w, me, x, y, z + 1, False) >= 0:
            return _A_CAR
        if self._kind_at(w, x, y, z + 1) in (Kind.AIR, Kind.GEAR, Kind.WALL):
            return kernel_state.NOTHING
        return kernel_state.OBJECT

    def _marked_landing(self, w: World, x: int, y: int, z: int) -> bool:
        return self._is_inside((x, y, z)) and self._holds("landing", (x, y, z), 2)

    def _decided_after(self, w: World, car: CarState, action: int) -> CarState:
        # What is lifted is decided before it is gone.
        self._new = CarState(*map(int, self._after(w, car, action)))
        return self._new

    def _put(self, w: World, x: int, y: int, z: int, kind: Any, yaw: int) -> None:
        cell = (x, y, z)
        if self._is_inside(cell):
            makes_way = KIND_MASKS[Kind.AIR] | KIND_MASKS[Kind.GEAR]
            if self._action == code.FOLD:
                makes_way |= things_mask(Kind.FOOT, ((self._me.car.yaw + 2) & 3,))
            is_taken = cell == self._me.cell and self._action != code.DROP
            if not is_taken and not self._holds("thing", cell, makes_way):
                self._overwrites = True
            self._write("thing", cell, THINGS.index((Kind(int(kind)), int(yaw))))
            self._write("mark", cell, 0)
            self._write("landing", cell, 0)

    def _set_occupant(self, w: World, x: int, y: int, z: int, mark: int) -> None:
        if self._is_inside((x, y, z)):
            self._write("mark", (x, y, z), MARKS.get(mark, 2))

    def _why_learned(self, w: World, me: int, car: CarState, action: int) -> int:
        verb = self._verb_of(action)
        if verb == bits.NO_VERB:
            return code.LEGAL
        frame = self._frame_of(car, action)
        state = self._own_number(w, car, frame)
        for variant in self._variants:
            is_about = variant.verb == verb and state in variant.states
            if is_about and all(self._shows(frame, *cell) for cell in variant.cells):
                return code.PATTERN_MATCHES
        return code.LEGAL

    def _shows(self, frame: int, forward: int, aside: int, up: int, looked_for: int) -> bool:
        """Decide whether a cell has any of some bits of patterns, as kernel.patterns.cell_bits has them."""
        x, y, z = self._me.cell
        x += forward * _dx(frame) - aside * _dx(frame - 1)
        y += forward * _dx(frame - 1) + aside * _dx(frame)
        cell = (x, y, z + up)
        mask = 0
        for number in range(len(THINGS)):
            if looked_for & _thing_bit(number, frame):
                mask |= 1 << number
        is_above = cell[2] >= self._shape[2] and self._is_inside((x, y, 0))
        if self._is_inside(cell):
            has_thing = self._holds("thing", cell, mask)
        elif is_above:
            has_thing = looked_for & 1 != 0
        else:
            has_thing = looked_for >> bits.OUTSIDE_BIT & 1 != 0
        if has_thing:
            return True
        mask = _shown_cars(looked_for & bits.CAR_BITS)
        if mask and cell != self._me.cell and self._holds("car", cell, mask):
            return True
        for yaw in range(4):
            turned = (yaw - frame) & 3
            if looked_for >> (bits.GEAR_BIT + turned) & 1 and (
                self._stands_with_gear(yaw, cell) or self._points_into("gear", yaw, cell)
            ):
                return True
            if looked_for >> (bits.LEAN_BIT + turned) & 1 and self._points_into("lean", yaw, cell):
                return True
        return False


def _dx(yaw: int) -> int:
    return (1, 0, -1, 0)[yaw & 3]


@cache
def _thing_bit(number: int, frame: int) -> int:
    """Return the bit of a thing in patterns."""
    kind, yaw = THINGS[number]
    grid = Grid.empty((1, 1, 1))
    grid.cells[0, 0, 1, : CellField.OCCUPANT] = (kind, yaw)
    return int(_pattern_bit(grid.world(), 0, 0, 1, frame))


@cache
def _cars() -> dict[int, World]:
    """Return a world with a car for each bit of cars but that of none."""
    worlds = {}
    for load, number in ((Kind.AIR, 0), (Kind.BLOCK, 1), (Kind.FSLOPE, 2)):
        for slope in range(3):
            grid = Grid.empty((1, 1, 1), 1)
            grid.cars[0, CarField.LOAD] = load
            grid.cars[0, CarField.SLOPE] = slope
            worlds[1 << (1 + 3 * number + slope)] = grid.world()
    return worlds


@cache
def _tall_loads(height_mm: int) -> int:
    """Return the bits of cars whose loads reach so far into the next level."""
    mask = 0
    for bit, world in _cars().items():
        if _reaches_up(world, 1, 0, 0, 2, height_mm):
            mask |= bit
    return mask


@cache
def _shown_cars(looked_for: int) -> int:
    """Return the bits of cars for some bits of patterns."""
    mask = 0
    for bit, world in _cars().items():
        if looked_for & int(_car_bit(world, 0)):
            mask |= bit
    return mask


class _UndecidedKind:
    """The kind in a cell, decided as far as rules compare it."""

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, holds: Callable[[int], bool]) -> None:
        self._holds = holds

    def __eq__(self, kind: object) -> bool:
        assert isinstance(kind, int)
        return self._holds(KIND_MASKS[kind])

    def __int__(self) -> int:
        for kind in Kind:
            if self == kind:
                return int(kind)
        raise AssertionError("a cell has a kind")


class _Cells:
    """Stands for the cells of a world, where rules write the mark of a landing themselves."""

    def __init__(self, shape: tuple[int, ...], write: Callable[[str, Cell, int], None]) -> None:
        self.shape = shape
        self._write = write

    def __setitem__(self, place: tuple[int, int, int, int], value: Any) -> None:
        assert place[3] == CellField.LANDING
        self._write("landing", place[:3], int(value))


class _Cars:
    """Stands for the cars of a world; the row that rules write is not read again."""

    def __getitem__(self, me: int) -> list[int]:
        return [0] * len(CarField)
