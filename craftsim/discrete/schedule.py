"""Schedules of plans: the action dependency graph, with the actions that each waits for, and times at nominal physics.

The rules let cars act one after the other. Real cars act at the same time, so each action waits for exactly those
earlier ones whose footprints conflict with its own, and for its own car; everything else may run in parallel, and the
world ends as it does one after the other (Hoenig et al., Persistent and Robust Execution of MAPF Schedules in
Warehouses, RA-L 2019). The durations of actions are in ``craftsim/data/durations.yaml``, measured by
``scripts/measure_durations.py``.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from importlib.resources import files
from typing import Final, Literal, get_args

import numpy as np
import yaml
from numpy.typing import NDArray

from craftsim.discrete.actions import ACTIONS, footprint
from craftsim.discrete.geometry import DIRECTIONS, INCLINE_RAD
from craftsim.discrete.grid import CarField, Cell, Grid, cell_of
from craftsim.discrete.kernel.claims import CHANGES, LOADS, RELIES, SPACE, Claims
from craftsim.discrete.kernel.state import AIR, F_LOAD, KIND
from craftsim.discrete.kinds import Action, TeamAction
from craftsim.discrete.rules import Rules
from craftsim.errors import InputError, suggestion

Concurrency = Literal["sequential", "concurrent", "until-wrong", "at-once"]
"""Order of the actions of a plan: one by one; as early as the dependencies allow; as early as the dependencies allow
until something is not as predicted, after which nothing begins any more; or, to see what goes wrong, all of a tick
together and tick after tick."""

Constraints = Mapping[tuple[int, int], Collection[tuple[int, int]]]
"""Order constraints of a plan: for an action the earlier ones of other cars that it waits for, each a (tick, car)."""

SITUATIONS: Final = ("flat", "flat_loaded", "slope", "slope_loaded")
"""Columns of the durations: whether a move starts or ends on a slope, and whether the car is loaded before."""

_DURATIONS: Final = "craftsim/data/durations.yaml"


@dataclass(frozen=True)
class ScheduledAction:
    """One action of a schedule."""

    tick: int
    car: int
    action: Action
    before: Grid
    """The predicted world when its turn comes in the order of the plan."""
    after: Grid
    """The predicted world right after it."""
    footprint: Claims = field(default_factory=lambda: np.empty((0, 4), np.int16), compare=False)
    """Its claims while it runs."""
    waits_for: frozenset[int] = frozenset()
    """Indices of the earlier steps that must have ended."""

    @cached_property
    def duration_s(self) -> float:
        """The time that was measured for this action at nominal physics (:func:`nominal_durations`)."""
        column = situation(self.before.cars[self.car], self.after.cars[self.car])
        return float(nominal_durations()[self.action, column])

    @property
    def inclines(self) -> tuple[float, float]:
        """Angles in radians by which the ground raises the car's nose at the start and at the end of the step."""
        start = self.before.cars[self.car]
        end = self.after.cars[self.car]
        return incline_under(self.before, start), incline_under(self.before, end)

    @property
    def tight(self) -> bool:
        """Whether the way of the step leads under something, or takes a load past something.

        A lowered board clears what it passes under by a millimetre, and loads pass each other at two.
        """
        world = self.before
        car = self.car
        cells = [cell_of(world, car), cell_of(self.after, car)]
        cells = [
            cell for cell in cells if cell[2] < world.cells.shape[2]
        ]  # above the top there is nothing
        if int(world.cars[car, F_LOAD]) == AIR:
            return any(int(world.cells[x, y, z, KIND]) != AIR for x, y, z in cells)
        other_cars = world.cars[:, : CarField.YAW].tolist()
        del other_cars[car]
        for x, y, z in cells:
            around = world.kind[max(x - 1, 0) : x + 2, max(y - 1, 0) : y + 2, z]
            if (around != AIR).any():
                return True
            for car_x, car_y, car_z in other_cars:
                if abs(car_x - x) <= 1 and abs(car_y - y) <= 1 and car_z == z:
                    return True
        return False

    @property
    def free_side(self) -> tuple[int, int]:
        """The direction, x and y, across the way of a load on level ground to which nothing stands, where something
        stands to the other side; else (0, 0)."""
        start = cell_of(self.before, self.car)
        end = cell_of(self.after, self.car)
        is_loaded = int(self.before.cars[self.car, F_LOAD]) != AIR
        if start == end or not is_loaded or any(self.inclines):
            return 0, 0
        across_x = start[1] - end[1]
        across_y = end[0] - start[0]
        free_sides = []
        for x, y in ((across_x, across_y), (-across_x, -across_y)):
            cells = ((start[0] + x, start[1] + y, start[2]), (end[0] + x, end[1] + y, end[2]))
            if not any(self._is_taken(cell) for cell in cells):
                free_sides.append((x, y))
        if len(free_sides) == 1:
            return free_sides[0]
        return 0, 0

    def _is_taken(self, cell: Cell) -> bool:
        """Return whether something or another car stands in a cell; none does outside of the map."""
        world = self.before
        if not world.inside(cell):
            return False
        if int(world.kind[cell]) != AIR:
            return True
        cars = range(len(world.cars))
        return any(car != self.car and cell_of(world, car) == cell for car in cars)


@dataclass(frozen=True)
class Schedule:
    """The legal actions of a plan with their dependencies, and those that the rules forbid when their turn comes."""

    steps: tuple[ScheduledAction, ...]
    forbidden: tuple[ScheduledAction, ...]
    """Actions that are left out; they change nothing."""
    final: Grid
    """The predicted world at the end."""
    acts: tuple[tuple[int, int], ...] = ()
    """(tick, car) of all actions in the order of the plan."""
    after: Constraints = field(default_factory=dict)
    """Order constraints of the plan."""

    def times(self, durations_s: Sequence[float] | None = None) -> NDArray[np.float64]:
        """Return the start and the end of each step in seconds, shape (n, 2): a longest path through the dependencies.

        A step starts as soon as all that it waits for has ended, and takes its own time, or the one that is given.
        """
        if durations_s is None:
            durations_s = [step.duration_s for step in self.steps]
        times = np.zeros((len(self.steps), 2))
        ends = list[float]()
        for index, (step, duration_s) in enumerate(zip(self.steps, durations_s, strict=True)):
            start = max(map(ends.__getitem__, step.waits_for), default=0.0)
            ends.append(start + duration_s)
            times[index] = start, ends[index]
        return times

    def makespan(self, durations_s: Sequence[float] | None = None) -> float:
        """Return when the last step ends, in seconds; 0 where there is none."""
        return float(self.times(durations_s)[:, 1].max(initial=0.0))

    def critical(self) -> set[tuple[int, int]]:
        """Return the (tick, car) of actions that wait for one another from the start until all is done.

        Each began when the one before it ended: unless one of them changes the makespan stays as it is.
        """
        steps = self.steps
        ends = self.times()[:, 1]
        at = int(ends.argmax())
        critical = {(steps[at].tick, steps[at].car)}
        while steps[at].waits_for:
            at = max(steps[at].waits_for, key=lambda earlier: (ends[earlier], earlier))
            critical.add((steps[at].tick, steps[at].car))
        return critical

    def constraints(self) -> Constraints:
        """Return the fewest order constraints from which all of ``waits_for`` follow.

        That a car waits for itself is not said, nor what follows from other constraints (transitive reduction).
        """
        constraints = {}
        reached: list[
            int
        ] = []  # for each step a bit set: itself, and all that must have ended before it
        latest: dict[int, int] = {}
        for index, step in enumerate(self.steps):
            implied = latest.get(step.car, 0)
            constraining = []
            for earlier in sorted(step.waits_for, reverse=True):
                if not implied >> earlier & 1:
                    constraining.append((self.steps[earlier].tick, self.steps[earlier].car))
                    implied |= reached[earlier]
            if constraining:
                constraints[step.tick, step.car] = tuple(reversed(constraining))
            reached.append(implied | 1 << index)
            latest[step.car] = reached[index]
        return constraints


def make_schedule(
    grid: Grid,
    ticks: Iterable[TeamAction],
    rules: Rules,
    order: Concurrency = "concurrent",
    first: int = 0,
    after: Constraints | None = None,
) -> Schedule:
    """Return the schedule of a plan's ticks from a world.

    Ticks are counted from ``first``. The order constraints ``after`` come on top of what actions wait for anyway; one
    that names what the rules forbid constrains nothing, because that is left out. Raises InputError for an unknown
    order.
    """
    orders = get_args(Concurrency)
    if order not in orders:
        raise InputError(
            f"no order {order!r}{suggestion(str(order), orders)} (orders: {', '.join(orders)})"
        )
    acts = []
    for tick, team_action in enumerate(ticks, first):
        for car, action in team_action:
            acts.append((tick, car, action))
    return _schedule_acts(grid, acts, rules, order, after or {})


def _schedule_acts(
    grid: Grid,
    acts: Sequence[tuple[int, int, Action]],
    rules: Rules,
    order: Concurrency,
    after: Constraints,
) -> Schedule:
    """Return the schedule of (tick, car, action) in acting order."""
    steps: list[ScheduledAction] = []
    place: dict[tuple[int, int], int] = {}
    claimed = defaultdict[object, list[int]](list)
    """Steps by the bits and cells of their footprints, and by their cars."""
    forbidden = []
    for tick, car, action in acts:
        following, applied = rules.tick(grid, [(car, action)])
        if not applied[0]:
            forbidden.append(ScheduledAction(tick, car, action, grid, grid))
            continue
        needs = footprint(grid, following, car, action)
        ordered = {place[act] for act in after.get((tick, car), ()) if act in place}
        match order:
            case "sequential":
                if steps:
                    waits: Iterable[int] = range(len(steps) - 1, len(steps))
                else:
                    waits = ()
            case "at-once":
                waits = (i for i, step in enumerate(steps) if step.tick < tick)
            case "concurrent" | "until-wrong":
                waits = set[int]()
                for key in _needed_keys(car, needs):
                    waits.update(claimed.get(key, ()))
        place[tick, car] = len(steps)
        for key in _claimed_keys(car, needs):
            claimed[key].append(len(steps))
        steps.append(
            ScheduledAction(tick, car, action, grid, following, needs, frozenset(waits) | ordered)
        )
        grid = following
    all_acts = tuple((tick, car) for tick, car, _ in acts)
    return Schedule(tuple(steps), tuple(forbidden), grid, all_acts, after)


_CONFLICTS: Final = {SPACE: SPACE, CHANGES: CHANGES | RELIES, RELIES: CHANGES, LOADS: LOADS}
"""For each claim of a cell the claims of another action that conflict with it."""


def _claimed_keys(car: int, needs: Claims) -> Iterator[object]:
    """Yield the keys of an action's claims; of a load also in the next cells of the level."""
    yield car
    for x, y, z, bits in needs.tolist():
        for bit in (SPACE, CHANGES, RELIES, LOADS):
            if bits & bit:
                yield bit, x, y, z
        if bits & LOADS:
            for dx, dy in DIRECTIONS.tolist():
                yield LOADS, x + dx, y + dy, z


def _needed_keys(car: int, needs: Claims) -> Iterator[object]:
    """Yield the keys of the claims that an action must wait for."""
    yield car
    for x, y, z, bits in needs.tolist():
        for bit, against in _CONFLICTS.items():
            if bits & against:
                yield bit, x, y, z


def incline_under(grid: Grid, car: NDArray[np.integer]) -> float:
    """Return the angle in radians by which the ground raises a car's nose: positive uphill, 0 on the flat.

    ``car`` (7,) is a row of ``grid.cars`` or of another grid with the same slopes.
    """
    x, y, z, yaw, _, _, slope = car.tolist()
    if slope == 0:
        return 0.0
    if slope == 2:
        z -= 1
    downhill = int(grid.yaw[x, y, z])
    if yaw == downhill:
        return -INCLINE_RAD
    return INCLINE_RAD


def nominal_durations() -> NDArray[np.float64]:
    """Return the table in seconds, shape (15, 4): by action and situation, 0 for what does not happen.

    Registered actions follow the 15. Raises RuntimeError, with the name of the action, if a row of the shipped file is
    missing or belongs to no action.
    """
    return _durations(len(ACTIONS))


@cache
def _durations(n_actions: int) -> NDArray[np.float64]:
    rows = yaml.safe_load(
        files("craftsim.data").joinpath("durations.yaml").read_text(encoding="utf-8")
    )
    table = np.zeros((n_actions, len(SITUATIONS)))
    for action, spec in ACTIONS.items():
        if not spec.duration:
            table[action] = spec.duration_s
            continue
        if spec.duration not in rows:
            raise RuntimeError(
                f"{action.name}: no row '{spec.duration}' in {_DURATIONS}; measure it and add one"
            )
        table[action] = [rows[spec.duration].get(name, 0.0) for name in SITUATIONS]
    used_rows = {spec.duration for spec in ACTIONS.values() if spec.duration}
    for row in rows:
        if row not in used_rows:
            raise RuntimeError(
                f"{_DURATIONS}: row '{row}' belongs to no action{suggestion(row, used_rows)}"
            )
    return table


def situation(before: NDArray[np.integer], after: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the column of the table, shape (...), for cars (..., 7) before and after an action."""
    sloping = (before[..., CarField.SLOPE] > 0) | (after[..., CarField.SLOPE] > 0)
    column: NDArray[np.int64] = 2 * sloping + (before[..., F_LOAD] != AIR)
    return column


def car_durations(
    before: NDArray[np.integer],
    after: NDArray[np.integer],
    actions: NDArray[np.integer],
    applied: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return how long each car's action takes, shape (..., n).

    Arguments are the cars of worlds before and after a tick (..., n, 7), their actions (..., n), and whether these were
    carried out. What the action helper does instead of a move follows from what has changed.
    """
    turned = (before[..., CarField.YAW] != after[..., CarField.YAW]) & applied
    moved = (before[..., :3] != after[..., :3]).any(-1) | (
        before[..., CarField.SLOPE] != after[..., CarField.SLOPE]
    )
    done = np.where(moved, Action.MOVE_FORWARD, np.where(turned, Action.ROTATE_LEFT, actions))
    if len(ACTIONS) > len(Action):
        done = np.where(actions >= len(Action), actions, done)
    seconds: NDArray[np.float64] = nominal_durations()[done, situation(before, after)] * applied
    return seconds
