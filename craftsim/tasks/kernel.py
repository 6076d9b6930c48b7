"""Compiled scores of many worlds at once: buildings, platforms, the flag; and rows of observations.

All arrays have a leading axis over worlds. What a car carries is in no cell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import compiled
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    BODY,
    FLAG,
    FOOT,
    FSLOPE,
    KIND,
    NO_PATTERNS,
    Cars,
    Cells,
    World,
    derived_landing,
    dir_x,
    dir_y,
    kind_at,
    state_of_car,
    yaw_at,
)
from craftsim.discrete.kinds import Kind

ROW = 13
"""Numbers of a row of an observation, in this order: x, y, z, then these."""
IS_CAR, IS_FSLOPE, IS_BODY, IS_FOOT, IS_BLOCK, IS_FLAG, IS_GOAL, YAW_HIGH, YAW_LOW, IS_LOADED = (
    range(3, ROW)
)
_FLAGS = {BLOCK: IS_BLOCK, FSLOPE: IS_FSLOPE, BODY: IS_BODY, FOOT: IS_FOOT, FLAG: IS_FLAG}
TYPE_FLAGS = tuple(_FLAGS.get(kind, 0) for kind in range(len(Kind)))
"""The place of the type flag of each kind, 0 for kinds without rows."""


@compiled
def score_buildings(
    cells: Cells,
    cars: Cars,
    designs: NDArray[np.int64],
    per_thing: float,
    upper_block: float,
    completion: float,
    out: NDArray[np.float64],
) -> None:
    """Write how far each building is into out (B,).

    ``designs`` (B, T, 5) has rows (kind, x, y, z, yaw), yaw -1 where it does not matter, and rows of kind 0 that say
    nothing. A block on the floor and a folded slope count ``per_thing``, a block higher up ``upper_block``, a slope
    ``per_thing`` once its body and foot are both in place; a finished building counts ``completion`` more.
    """
    for i in range(out.shape[0]):
        w = World(cells[i], cars[i], 0, NO_PATTERNS)
        score = 0.0
        finished = True
        for row in range(designs.shape[1]):
            kind, x, y, z, yaw = designs[i, row]
            if kind == AIR:
                continue
            if kind_at(w, x, y, z) != kind or (yaw >= 0 and yaw_at(w, x, y, z) != yaw):
                finished = False
                if per_thing == 0.0 and upper_block == 0.0:
                    break
            elif kind == BLOCK and z > 1:
                score += upper_block
            elif kind == BODY:
                x = x + dir_x(yaw)
                y = y + dir_y(yaw)
                if kind_at(w, x, y, z) == FOOT and yaw_at(w, x, y, z) == yaw:
                    score += per_thing
            elif kind != FOOT:
                score += per_thing
        if finished:
            score += completion
        out[i] = score


@compiled
def largest_platforms(
    cells: Cells,
    cars: Cars,
    extra_kind: int,
    levels: int,
    visited: NDArray[np.bool_],
    stack: NDArray[np.int64],
    out: NDArray[np.float64],
) -> None:
    """Write the size of the largest group of blocks side by side on one of the levels 1 to ``levels`` into out (B,).

    ``extra_kind`` is another kind that counts as a block; ``visited`` (L, W) and ``stack`` (L * W, 2) are scratch.
    """
    for i in range(out.shape[0]):
        w = World(cells[i], cars[i], 0, NO_PATTERNS)
        largest = 0
        for z in range(1, levels + 1):
            visited[:] = False
            for x in range(w.cells.shape[0]):
                for y in range(w.cells.shape[1]):
                    if w.cells[x, y, z, KIND] not in (BLOCK, extra_kind) or visited[x, y]:
                        continue
                    visited[x, y] = True
                    stack[0, 0] = x
                    stack[0, 1] = y
                    waiting = 1
                    size = 0
                    while waiting > 0:
                        waiting -= 1
                        cell_x = stack[waiting, 0]
                        cell_y = stack[waiting, 1]
                        size += 1
                        for d in range(4):
                            next_x = cell_x + dir_x(d)
                            next_y = cell_y + dir_y(d)
                            kind = kind_at(w, next_x, next_y, z)
                            if kind in (BLOCK, extra_kind) and not visited[next_x, next_y]:
                                visited[next_x, next_y] = True
                                stack[waiting, 0] = next_x
                                stack[waiting, 1] = next_y
                                waiting += 1
                    largest = max(largest, size)
        out[i] = largest


@compiled
def _is_stack(w: World, x: int, y: int) -> bool:
    """Return whether three blocks stand on one another from the floor."""
    low = kind_at(w, x, y, 1) == BLOCK and kind_at(w, x, y, 2) == BLOCK
    return low and kind_at(w, x, y, 3) == BLOCK


@compiled
def count_stacks(cells: Cells, cars: Cars, out: NDArray[np.float64]) -> None:
    """Write how many stacks of three blocks from the floor each world has into out (B,)."""
    for i in range(out.shape[0]):
        w = World(cells[i], cars[i], 0, NO_PATTERNS)
        stacks = 0
        for x in range(w.cells.shape[0]):
            for y in range(w.cells.shape[1]):
                if _is_stack(w, x, y):
                    stacks += 1
        out[i] = stacks


@compiled
def _leads_to_block(w: World, x: int, y: int, z: int, yaw: int) -> bool:
    """Return whether there is a block behind the body of an unfolded slope in a cell."""
    return kind_at(w, x - dir_x(yaw), y - dir_y(yaw), z) == BLOCK


@compiled
def score_structures(
    cells: Cells, cars: Cars, weights: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Write the weighted sum of what is built in each world into out (B,).

    ``weights`` (6,) are of a block behind the body of an unfolded slope; of a block, a folded slope and a body on a
    block; of such a body with a block behind it; and of a stack of three blocks from the floor.
    """
    for i in range(out.shape[0]):
        w = World(cells[i], cars[i], 0, NO_PATTERNS)
        score = 0.0
        for x in range(w.cells.shape[0]):
            for y in range(w.cells.shape[1]):
                if _is_stack(w, x, y):
                    score += weights[5]
                for z in range(w.cells.shape[2]):
                    kind = w.cells[x, y, z, KIND]
                    if kind == BLOCK and derived_landing(w, x, y, z):
                        score += weights[0]
                    if z == 0 or w.cells[x, y, z - 1, KIND] != BLOCK:
                        continue
                    if kind == BLOCK:
                        score += weights[1]
                    elif kind == FSLOPE:
                        score += weights[2]
                    elif kind == BODY:
                        score += weights[3]
                        if _leads_to_block(w, x, y, z, yaw_at(w, x, y, z)):
                            score += weights[4]
        out[i] = score


@compiled
def score_complexities(cells: Cells, cars: Cars, out: NDArray[np.float64]) -> None:
    """Write the levels of all blocks above the floor, and the ramps to blocks, into out (B,), added up.

    Such a ramp is a body with its foot below and a block behind it.
    """
    for i in range(out.shape[0]):
        w = World(cells[i], cars[i], 0, NO_PATTERNS)
        score = 0
        for x in range(w.cells.shape[0]):
            for y in range(w.cells.shape[1]):
                for z in range(w.cells.shape[2]):
                    kind = w.cells[x, y, z, KIND]
                    if kind == BLOCK:
                        score += z - 1
                    elif kind == BODY:
                        yaw = yaw_at(w, x, y, z)
                        foot_x = x + dir_x(yaw)
                        foot_y = y + dir_y(yaw)
                        has_foot = (
                            kind_at(w, foot_x, foot_y, z) == FOOT
                            and yaw_at(w, foot_x, foot_y, z) == yaw
                        )
                        if has_foot and _leads_to_block(w, x, y, z, yaw):
                            score += 1
        out[i] = score


@compiled
def flag_distances(
    cells: Cells, cars: Cars, goal: tuple[int, int, int], out: NDArray[np.float64]
) -> None:
    """Write the Manhattan distance of the flag, carried or not, to the goal in each world into out (B,).

    A lost flag is farther than any cell.
    """
    for i in range(out.shape[0]):
        w = World(cells[i], cars[i], 0, NO_PATTERNS)
        distance = w.cells.shape[0] + w.cells.shape[1] + w.cells.shape[2]
        for x in range(w.cells.shape[0]):
            for y in range(w.cells.shape[1]):
                for z in range(1, w.cells.shape[2]):
                    if w.cells[x, y, z, KIND] == FLAG:
                        distance = min(
                            distance, abs(x - goal[0]) + abs(y - goal[1]) + abs(z - goal[2])
                        )
        for car in range(w.cars.shape[0]):
            at = state_of_car(w, car)
            if at.load == FLAG:
                distance = min(
                    distance, abs(at.x - goal[0]) + abs(at.y - goal[1]) + abs(at.z - goal[2])
                )
        out[i] = distance


@compiled
def _write_row(row: NDArray[np.int32], x: int, y: int, z: int, flag: int, yaw: int) -> None:
    """Write an entity's position, type flag and yaw into its 13 numbers."""
    row[0] = x
    row[1] = y
    row[2] = z
    row[flag] = 1
    row[YAW_HIGH] = yaw >> 1
    row[YAW_LOW] = yaw & 1


@compiled
def write_rows(
    cells: Cells,
    cars: Cars,
    first_rows: NDArray[np.int64],
    counts: NDArray[np.int64],
    slots: NDArray[np.int64],
    goal: tuple[int, int, int],
    n_goals: int,
    out: NDArray[np.int32],
) -> bool:
    """Write the rows of cars and things into out (B, n_rows, 13); return whether all found one.

    ``first_rows`` and ``counts`` (13,) have by type flag the first row and how many there are; a flag may find none.
    ``slots`` (2, 13) is scratch. The last rows, ``n_goals`` of them, show the goal.
    """
    fit = True
    for i in range(out.shape[0]):
        w = World(cells[i], cars[i], 0, NO_PATTERNS)
        rows = out[i]
        rows[:] = 0
        for row in range(out.shape[1] - n_goals, out.shape[1]):
            _write_row(rows[row], goal[0], goal[1], goal[2], IS_GOAL, 0)
        following = slots[0]
        free = slots[1]
        for flag in range(len(counts)):
            following[flag] = first_rows[flag]
            free[flag] = counts[flag]
        for car in range(w.cars.shape[0]):
            at = state_of_car(w, car)
            _write_row(rows[car], at.x, at.y, at.z, IS_CAR, at.yaw)
            flag = TYPE_FLAGS[at.load]
            if flag == 0:
                continue
            rows[car, IS_LOADED] = 1
            if free[flag] > 0:
                _write_row(rows[following[flag]], at.x, at.y, at.z, flag, at.load_yaw)
                following[flag] += 1
                free[flag] -= 1
            elif flag != IS_FLAG:
                fit = False
        for x in range(w.cells.shape[0]):
            for y in range(w.cells.shape[1]):
                for z in range(1, w.cells.shape[2]):
                    kind = int(np.int64(w.cells[x, y, z, KIND]))
                    if kind == AIR:
                        continue
                    flag = TYPE_FLAGS[kind]
                    if flag == 0:
                        continue
                    if free[flag] > 0:
                        _write_row(rows[following[flag]], x, y, z, flag, yaw_at(w, x, y, z))
                        following[flag] += 1
                        free[flag] -= 1
                    elif flag != IS_FLAG:
                        fit = False
    return fit
