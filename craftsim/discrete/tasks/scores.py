"""Potentials of worlds, compiled: the numbers whose change is the reward. Carried things are in no cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    BODY,
    F_LOAD,
    F_X,
    F_Y,
    F_Z,
    FLAG,
    FOOT,
    GEAR,
    KIND,
    YAW,
    World,
    car_field,
    dir_x,
    dir_y,
    kind_at,
    standable,
)

NO_FLAG = -1


@compiled
def is_block(kind: int, gears_too: bool) -> bool:
    """Return whether a kind counts as a block."""
    return kind == BLOCK or (gears_too and kind == GEAR)


@compiled
def hit(w: World, kind: int, x: int, y: int, z: int, yaw: int) -> bool:
    """Return whether a cell holds a kind, with a yaw if that is not -1."""
    return kind_at(w, x, y, z) == kind and (yaw < 0 or w.cells[x, y, z, YAW] == yaw)


@compiled
def finished(w: World, targets: NDArray[np.int64]) -> bool:
    """Return whether every target cell, rows as in :func:`paper_score`, holds its kind with its yaw."""
    for i in range(targets.shape[0]):
        kind, x, y, z, yaw = targets[i]
        if kind != AIR and not hit(w, kind, x, y, z, yaw):
            return False
    return True


@compiled
def paper_score(w: World, targets: NDArray[np.int64], upper_block: float, completion: float) -> float:
    """Return the potential of a building by the paper's table 1.

    ``targets`` has rows (kind, x, y, z, yaw), yaw -1 where it does not matter, and rows of kind 0 that say nothing. A
    block on the floor and a folded slope count 1, a block higher up ``upper_block``, a slope 1 once its body and foot
    are both in place; a finished building counts ``completion`` more.
    """
    score = 0.0
    for i in range(targets.shape[0]):
        kind, x, y, z, yaw = targets[i]
        if kind in (AIR, FOOT) or not hit(w, kind, x, y, z, yaw):
            continue
        if kind == BLOCK and z > 1:
            score += upper_block
        elif kind != BODY or hit(w, FOOT, x + dir_x(yaw), y + dir_y(yaw), z, yaw):
            score += 1.0
    return score + completion if finished(w, targets) else score


@compiled
def code_score(w: World, targets: NDArray[np.int64], completion: float) -> float:
    """Return the potential of a building as CraftEnv's code computes it (docs/rules.md#goal-score)."""
    score = 0.0
    hits = wanted = 0
    for i in range(targets.shape[0]):
        kind, x, y, z, _ = targets[i]
        if kind == AIR:
            continue
        wanted += 1
        if kind == BLOCK and z == 2:
            score += 1.0
        if z >= w.cells.shape[2] - 1:
            continue
        there = kind_at(w, x, y, z)
        if there == kind or (kind == BLOCK and is_block(there, True)):
            hits += 1
    return score + hits + (completion if hits == wanted else 0.0)


@compiled
def largest_platform(
    w: World, gears_too: bool, levels: int, seen: NDArray[np.bool_], stack: NDArray[np.int64]
) -> int:
    """Return the size of the largest group of blocks side by side on one of the levels 1 to ``levels``.

    ``seen`` (L, W) and ``stack`` (L * W, 2) are scratch.
    """
    length, width = w.cells.shape[0], w.cells.shape[1]
    largest = 0
    for z in range(1, levels + 1):
        seen[:] = False
        for x0 in range(length):
            for y0 in range(width):
                if seen[x0, y0] or not is_block(w.cells[x0, y0, z, KIND], gears_too):
                    continue
                seen[x0, y0] = True
                stack[0, 0], stack[0, 1] = x0, y0
                waiting, size = 1, 0
                while waiting > 0:
                    waiting -= 1
                    x, y = stack[waiting, 0], stack[waiting, 1]
                    size += 1
                    for d in range(4):
                        nx, ny = x + dir_x(d), y + dir_y(d)
                        if is_block(kind_at(w, nx, ny, z), gears_too) and not seen[nx, ny]:
                            seen[nx, ny] = True
                            stack[waiting, 0], stack[waiting, 1] = nx, ny
                            waiting += 1
                largest = max(largest, size)
    return largest


@compiled
def flag_distance(w: World, goal: tuple[int, int, int]) -> int:
    """Return the Manhattan distance of the flag, carried or not, to the goal; NO_FLAG if there is no flag."""
    for car in range(w.cars.shape[0]):
        if car_field(w, car, F_LOAD) == FLAG:
            return (
                abs(car_field(w, car, F_X) - goal[0])
                + abs(car_field(w, car, F_Y) - goal[1])
                + abs(car_field(w, car, F_Z) - goal[2])
            )
    for x in range(w.cells.shape[0]):
        for y in range(w.cells.shape[1]):
            for z in range(1, w.cells.shape[2]):
                if w.cells[x, y, z, KIND] == FLAG:
                    return abs(x - goal[0]) + abs(y - goal[1]) + abs(z - goal[2])
    return NO_FLAG


@compiled
def storeys(w: World) -> int:
    """Return the sum over all blocks of the number of levels they stand above the floor."""
    total = 0
    for x in range(w.cells.shape[0]):
        for y in range(w.cells.shape[1]):
            for z in range(2, w.cells.shape[2]):
                if w.cells[x, y, z, KIND] == BLOCK:
                    total += z - 1
    return total


@compiled
def ramps(w: World) -> int:
    """Return the number of unfolded slopes that lead somewhere: a foot below, and a block behind the body."""
    total = 0
    for x in range(w.cells.shape[0]):
        for y in range(w.cells.shape[1]):
            for z in range(1, w.cells.shape[2]):
                if w.cells[x, y, z, KIND] != BODY:
                    continue
                yaw = w.cells[x, y, z, YAW]
                fx, fy = x + dir_x(yaw), y + dir_y(yaw)
                if hit(w, FOOT, fx, fy, z, yaw) and standable(kind_at(w, x - dir_x(yaw), y - dir_y(yaw), z)):
                    total += 1
    return total
