"""Things and cars placed at random on the floor as a blueprint's that are not listed, but compiled, for batches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import (
    AIR,
    BLOCK,
    F_X,
    F_Y,
    F_YAW,
    FLAG,
    FSLOPE,
    GEAR,
    KIND,
    WALL,
    YAW,
    World,
    car_field,
    derive_marks,
    dir_x,
    dir_y,
    kind_at,
    world_at,
)

YAWS = 4


@compiled
def _fits(w: World, slope: bool, place: int, n_cars: int) -> bool:
    """Return whether a place, (yaw, x, y) counted through, is free of things and of the cars placed so far.

    A slope also takes the cell that its yaw points to for its gear, and no wall is behind it.
    """
    width = w.cells.shape[1]
    cells = w.cells.shape[0] * width
    yaw, x, y = place // cells, place % cells // width, place % width
    if w.cells[x, y, 1, KIND] != AIR:
        return False
    if slope:
        return (
            kind_at(w, x + dir_x(yaw), y + dir_y(yaw), 1) == AIR
            and kind_at(w, x - dir_x(yaw), y - dir_y(yaw), 1) != WALL
        )
    free = True
    for car in range(n_cars):
        free &= car_field(w, car, F_X) != x or car_field(w, car, F_Y) != y
    return free


@compiled
def _choose(w: World, slope: bool, first: int, n_cars: int, chance: float) -> int:
    """Return one of the places from ``first`` on that fit, all as likely; -1 where none does."""
    most = w.cells.shape[0] * w.cells.shape[1] * (YAWS if slope else 1)
    count = 0
    for place in range(first, most):
        count += _fits(w, slope, place, n_cars)
    left = min(int(chance * count), count - 1)
    for place in range(first, most):
        if _fits(w, slope, place, n_cars):
            if left == 0:
                return place
            left -= 1
    return -1


@compiled
def _place(w: World, n_slopes: int, n_blocks: int, flag_x: int, chances: NDArray[np.float64]) -> bool:
    """Place all in one world; return whether there was room."""
    width = w.cells.shape[1]
    cells = w.cells.shape[0] * width
    n_flags = 1 if flag_x >= 0 else 0
    for i in range(n_flags + n_slopes + n_blocks):
        slope = n_flags <= i < n_flags + n_slopes
        place = _choose(w, slope, flag_x * width if i < n_flags else 0, 0, chances[i])
        if place < 0:
            return False
        yaw, x, y = place // cells, place % cells // width, place % width
        w.cells[x, y, 1, KIND] = FLAG if i < n_flags else FSLOPE if slope else BLOCK
        w.cells[x, y, 1, YAW] = yaw
        if slope:
            w.cells[x + dir_x(yaw), y + dir_y(yaw), 1, KIND] = GEAR
            w.cells[x + dir_x(yaw), y + dir_y(yaw), 1, YAW] = yaw
    drawn = n_flags + n_slopes + n_blocks
    for car in range(w.cars.shape[0]):
        place = _choose(w, False, 0, car, chances[drawn + 2 * car])
        if place < 0:
            return False
        w.cars[car, F_X], w.cars[car, F_Y] = place // width, place % width
        w.cars[car, F_YAW] = int(chances[drawn + 2 * car + 1] * YAWS)
    derive_marks(w)
    return True


@compiled
def place_all(
    worlds: World,
    n_slopes: int,
    n_blocks: int,
    flag_x: int,
    chances: NDArray[np.float64],
    found_room: NDArray[np.bool_],
) -> None:
    """Place a flag, folded slopes, blocks and all cars in each of B worlds, in this order, each where it finds room.

    ``flag_x`` is the lowest x of the flag, -1 for none; ``chances`` (B, things + 2 cars), from 0 to below 1, decide.
    """
    for i in range(found_room.shape[0]):
        found_room[i] = _place(world_at(worlds, i), n_slopes, n_blocks, flag_x, chances[i])
