"""The plan of least work in a small world, or the proof that there is none: A* over whole worlds (Hart et al. 1968).

One car's action is one step, and costs what the table of durations says. The heuristic never overestimates: each thing
that is missing costs at least the lift of some thing, its way in the plane and the drop; somebody must drive to the
first of them, and what is above the floor needs a ramp. A world is kept as bytes without marks.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from heapq import heappop, heappush
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import compiled
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel.codes import DROP, FOLD, LIFT, UNFOLD
from craftsim.discrete.kernel.rules import legal_actions
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    BODY,
    F_LOAD,
    F_SLOPE,
    F_X,
    F_Y,
    F_Z,
    FLAG,
    FSLOPE,
    KIND,
    YAW,
    World,
    apply,
    car_field,
    kind_at,
    state_of_car,
)
from craftsim.discrete.kinds import Action, Correction, PlanTick
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import nominal_durations
from craftsim.planning.assembly import loads_of
from craftsim.planning.planned import BuildingGoal

MOST_WORLDS: Final = 400_000
"""Default limit of the number of worlds."""

_MOST_BYTES: Final = 1 << 28
"""Memory limit of the worlds that are kept; it matters for large ones only."""
_MOST_CELLS: Final = 64
_MOST_THINGS: Final = 3
_MOST_CARS: Final = 2
_MOST_SORTED: Final = 8
"""Largest number of objects that the heuristic assigns to places; it is 0 beyond that."""
_YAW_SHIFT: Final = 4
_KIND_BITS: Final = 15

_UNKNOWN: Final = 1 << 40
_MOVE: Final = int(Action.MOVE_FORWARD)


def is_small(start: Grid, rules: Rules) -> bool:
    """Return whether a world is small enough for :func:`least_work` to find a building's plan as a rule."""
    return (
        Correction.derived_marks in rules.corrections
        and int(np.prod(start.size)) <= _MOST_CELLS
        and loads_of(start).total() <= _MOST_THINGS
        and start.n_cars <= _MOST_CARS
    )


def least_work(
    start: Grid,
    goal: BuildingGoal,
    rules: Rules,
    most_worlds: int = MOST_WORLDS,
    until_s: float = math.inf,
) -> tuple[tuple[PlanTick, ...] | None, int, bool]:
    """Search for a plan whose actions take the least time in sum.

    Returns its ticks, each of one action, None where none was found; the number of worlds that were met; and whether
    the search finished, so that there is no plan where none was found. With a building as the goal the search is
    guided. It ends when it has met so many worlds, or fewer where worlds are large, and at a monotonic time.

    Raises ValueError for rules whose marks do not follow from what is there, as those of ``physical`` do.
    """
    if Correction.derived_marks not in rules.corrections:
        raise ValueError(
            "worlds are distinguished by what is there, but by these rules their marks count, too"
        )
    search = _Worlds(start, goal, rules)
    first = search.pack(start)
    most_worlds = min(most_worlds, _MOST_BYTES // len(first))
    origins: dict[bytes, tuple[int, bytes, int]] = {first: (0, first, -1)}
    queue = [(0, 0, first)]
    while queue:
        estimate, past, world = heappop(queue)
        if -past != origins[world][0]:
            continue
        if (goal.building is None or estimate == -past) and goal.reached(search.grid(world)):
            ticks: list[PlanTick] = []
            while origins[world][2] >= 0:
                _, world, step = origins[world]
                car, action = divmod(step, len(Action))
                ticks.append(((car, Action(action)),))
            return tuple(reversed(ticks)), len(origins), True
        for following, cost, remaining, step in search.after(world):
            work = cost - past
            previous = origins.get(following)
            if previous is None or work < previous[0]:
                origins[following] = work, world, step
                heappush(queue, (work + remaining, -work, following))
        if len(origins) > most_worlds or time.monotonic() > until_s:
            return None, len(origins), False
    return None, len(origins), True


class _Worlds:
    """Worlds as bytes: first the cells above the ground, kind and yaw in one, then the cars."""

    def __init__(self, start: Grid, goal: BuildingGoal, rules: Rules) -> None:
        self._grid = start.copy()
        self._world = self._grid.world(rules.corrections, rules.patterns)
        self._n_cells = start.kind[:, :, 1:].size
        actions = [
            action for action in Action if ACTIONS[action].performed and action != Action.STOP
        ]
        self._actions = np.array(actions, np.int64)
        self._costs = np.rint(nominal_durations() * 1000).astype(np.int64)
        targets = []
        if loads_of(start).total() <= _MOST_SORTED:
            targets = sorted(goal.building or ())
        rows = [(target.kind, *target.cell) for target in targets]
        self._targets = np.array(rows, np.int64).reshape(-1, 4)
        self._best = np.zeros((2, 1 << _MOST_SORTED), np.int64)
        self._things = np.zeros((_MOST_SORTED + start.n_cars, 5), np.int64)
        n_steps = start.n_cars * len(actions)
        self._rows = np.zeros((n_steps + 1, self._n_cells + start.cars.size), np.uint8)
        self._steps = np.zeros((n_steps, 3), np.int64)

    def pack(self, grid: Grid) -> bytes:
        """Return a world as bytes."""
        cells = grid.kind[:, :, 1:].astype(np.uint8) | (
            grid.yaw[:, :, 1:].astype(np.uint8) << _YAW_SHIFT
        )
        return cells.tobytes() + grid.cars.astype(np.uint8).tobytes()

    def grid(self, world: bytes) -> Grid:
        """Return a world from its bytes."""
        self._expand(world, self._actions[:0])
        grid = self._grid.copy()
        grid.derive_marks()
        return grid

    def after(self, world: bytes) -> Iterator[tuple[bytes, int, int, int]]:
        """Yield what can be made of a world: it as bytes, the cost, the least work that is left, and the step."""
        count = self._expand(world, self._actions)
        for row, (cost, remaining, step) in zip(
            self._rows, self._steps[:count].tolist(), strict=False
        ):
            yield row.tobytes(), cost, remaining, step

    def _expand(self, world: bytes, actions: NDArray[np.int64]) -> int:
        self._rows[-1] = np.frombuffer(world, np.uint8)
        return _expand(
            self._world,
            actions,
            self._costs,
            self._targets,
            self._things,
            self._best,
            self._rows,
            self._steps,
        )


@compiled
def _expand(
    w: World,
    actions: NDArray[np.int64],
    costs: NDArray[np.int64],
    targets: NDArray[np.int64],
    pieces: NDArray[np.int64],
    best: NDArray[np.int64],
    rows: NDArray[np.uint8],
    steps: NDArray[np.int64],
) -> int:
    """Write the worlds after the one in the last row, and for each the cost, the least work left and the step.

    That in the last row is in ``w`` afterwards, with whatever marks there were.
    """
    count = 0
    n_cars = w.cars.shape[0]
    n_actions = actions.shape[0]
    length, width, layers = w.cells.shape[:3]
    before = rows[rows.shape[0] - 1]
    for step in range(-1, n_cars * n_actions):
        if step >= 0:
            car = step // n_actions
            action = actions[step % n_actions]
            state = state_of_car(w, car)
            if not legal_actions(w, car, state, action, action) & (1 << action):
                continue
            apply(w, car, action)
            sloping = state.slope > 0 or car_field(w, car, F_SLOPE) > 0
            column = 0
            if sloping:
                column += 2
            if state.load != AIR:
                column += 1
            steps[count, 0] = costs[action, column]
            steps[count, 1] = _least_work_left(w, costs, targets, pieces, best)
            steps[count, 2] = car * costs.shape[0] + action
            following = rows[count]
            at = 0
            for x in range(length):
                for y in range(width):
                    for z in range(1, layers):
                        following[at] = w.cells[x, y, z, KIND] | (
                            w.cells[x, y, z, YAW] << _YAW_SHIFT
                        )
                        at += 1
            for copied in range(n_cars):
                for field in range(w.cars.shape[1]):
                    following[at] = w.cars[copied, field]
                    at += 1
            count += 1
        # Here the world before comes (back) into ``w``.
        at = 0
        for x in range(length):
            for y in range(width):
                for z in range(1, layers):
                    w.cells[x, y, z, KIND] = before[at] & _KIND_BITS
                    w.cells[x, y, z, YAW] = before[at] >> _YAW_SHIFT
                    at += 1
        for copied in range(n_cars):
            for field in range(w.cars.shape[1]):
                w.cars[copied, field] = before[at]
                at += 1
    return count


@compiled
def _least_work_left(
    w: World,
    costs: NDArray[np.int64],
    targets: NDArray[np.int64],
    pieces: NDArray[np.int64],
    best: NDArray[np.int64],
) -> int:
    """Return work that is left at least: the cheapest way to give each target a thing of its own, and to begin."""
    if targets.shape[0] == 0:
        return 0
    # Kind, place and whether it is carried of each thing; ``up``: a car is above the floor, or a slope leads there.
    n_pieces = 0
    up = False
    length, width, layers = w.cells.shape[:3]
    for x in range(length):
        for y in range(width):
            for z in range(1, layers):
                kind = w.cells[x, y, z, KIND]
                if kind in (BLOCK, FLAG, FSLOPE, BODY):
                    pieces[n_pieces, 0] = kind
                    pieces[n_pieces, 1] = x
                    pieces[n_pieces, 2] = y
                    pieces[n_pieces, 3] = z
                    pieces[n_pieces, 4] = 0
                    n_pieces += 1
                    up = up or kind == BODY
    carrying = False
    for car in range(w.cars.shape[0]):
        up = up or car_field(w, car, F_Z) > 1
        if car_field(w, car, F_LOAD) != AIR:
            pieces[n_pieces, 0] = car_field(w, car, F_LOAD)
            pieces[n_pieces, 1] = car_field(w, car, F_X)
            pieces[n_pieces, 2] = car_field(w, car, F_Y)
            pieces[n_pieces, 3] = 0
            pieces[n_pieces, 4] = 1
            n_pieces += 1
            carrying = True
    # What is above the floor needs a ramp to get up by: one that is asked for, or another.
    wants_ramp = False
    missing = False
    for k in range(targets.shape[0]):
        kind = targets[k, 0]
        x = targets[k, 1]
        y = targets[k, 2]
        z = targets[k, 3]
        wants_ramp = wants_ramp or kind == BODY
        missing = missing or (z > 1 and kind_at(w, x, y, z) != kind)
    # best[k & 1, used]: the least work for the first k targets with the things in the set ``used``.
    n_sets = 1 << n_pieces
    for used in range(n_sets):
        best[0, used] = _UNKNOWN
    best[0, 0] = 0
    for k in range(targets.shape[0]):
        row = k & 1
        next_row = (k + 1) & 1
        for used in range(n_sets):
            best[next_row, used] = _UNKNOWN
        for used in range(n_sets):
            if best[row, used] >= _UNKNOWN:
                continue
            for i in range(n_pieces):
                if used >> i & 1:
                    continue
                work = best[row, used] + _least_work_for(costs, targets, k, pieces, i)
                best[next_row, used | 1 << i] = min(best[next_row, used | 1 << i], work)
    lowest = _UNKNOWN
    for used in range(n_sets):
        lowest = min(lowest, best[targets.shape[0] & 1, used])
    if lowest == 0 or lowest >= _UNKNOWN:
        return lowest
    if missing and not (up or wants_ramp):
        lowest += costs[UNFOLD, 0]
    if carrying:
        return lowest
    nearest = _UNKNOWN
    for car in range(w.cars.shape[0]):
        for i in range(n_pieces):
            distance = abs(car_field(w, car, F_X) - pieces[i, 1]) + abs(
                car_field(w, car, F_Y) - pieces[i, 2]
            )
            nearest = min(nearest, distance)
    return lowest + nearest * costs[_MOVE, 0]


@compiled
def _least_work_for(
    costs: NDArray[np.int64], targets: NDArray[np.int64], k: int, pieces: NDArray[np.int64], i: int
) -> int:
    """Return what it takes at least to make a thing one target's, whatever its yaw; a flag may stay on its car."""
    kind = pieces[i, 0]
    target = targets[k, 0]
    slope = kind in (FSLOPE, BODY)
    if kind != target and not (slope and target in (FSLOPE, BODY)):
        return _UNKNOWN
    distance = abs(pieces[i, 1] - targets[k, 1]) + abs(pieces[i, 2] - targets[k, 2])
    moved = distance > 0 or pieces[i, 4] == 1 or pieces[i, 3] != targets[k, 3]
    work = 0
    if moved:
        work += distance * costs[_MOVE, 1]
        if pieces[i, 4] == 0:
            work += costs[LIFT, 0]
        if target != FLAG:
            work += costs[DROP, 1]
        if kind == BODY:
            work += costs[FOLD, 0]
        if target == BODY:
            work += costs[UNFOLD, 0]
    elif kind == BODY and target == FSLOPE:
        work += costs[FOLD, 0]
    elif kind == FSLOPE and target == BODY:
        work += costs[UNFOLD, 0]
    return work
