"""The claims of actions: which cells an action needs while it runs, and whether two actions need the same.

A claim is a row (x, y, z, bits) of a list. What runs in a world is marked on a board, a map of such bits with a margin,
beside which a further action is checked.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.codes import (
    DROP,
    FIRST_MOVE,
    FOLD,
    LAST_MOVE,
    LIFT,
    ROTATE_LEFT,
    ROTATE_RIGHT,
    UNFOLD,
)
from craftsim.discrete.kernel.effects import after
from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import AIR, FSLOPE, Pose, World, dir_x, dir_y, kind_at, pose_of, yaw_at

SPACE = 1
"""Swept by the car, its load or a flap."""
CHANGES = 2
"""Whose object the action takes, puts down or turns."""
RELIES = 4
"""Whose object must stay as it is: what is stood on, driven under or out of."""
LOADS = 8
"""Through which a load moves, sideways play and all."""
BESIDE = 16
"""On a board: a load moves here or in a neighbour cell on this level."""

MOST = 48
"""Rows that the claims of one of the 15 actions may take."""
MARGIN = 4
"""Cells by which a board reaches over the map on each side, and above it."""

Claims = NDArray[np.int16]
"""(rows, 4)."""
Board = NDArray[np.uint8]


def empty_board(size: tuple[int, int, int]) -> Board:
    """Return the board of a map of size (L, W, H), on which nothing is marked."""
    length, width, height = size
    return np.zeros((length + 2 * MARGIN, width + 2 * MARGIN, height + 1 + MARGIN), np.uint8)


@compiled
def add(out: Claims, count: int, x: int, y: int, z: int, bits: int) -> int:
    """Append a row; return how many there are now."""
    out[count, 0], out[count, 1], out[count, 2], out[count, 3] = x, y, z, bits
    return count + 1


@compiled
def add_standing(w: World, car: Pose, out: Claims, count: int) -> int:
    """Append what a car needs where it stands; return how many rows there are now."""
    count = add(out, count, car.x, car.y, car.z, SPACE | RELIES)
    count = add(out, count, car.x, car.y, car.z - 1, RELIES)
    if car.slope == 1:
        count = add(out, count, car.x, car.y, car.z + 1, SPACE)
    if car.load == AIR:
        return count
    first = count
    count = add(out, count, car.x, car.y, car.z, SPACE | LOADS)
    if car.load == FSLOPE:
        x, y = car.x + dir_x(car.load_yaw), car.y + dir_y(car.load_yaw)
        count = add(out, count, x, y, car.z, SPACE | LOADS)
    if car.slope != 0:
        # A load leans downhill with its car, by 40 to 60 mm at its height: into the next cell.
        downhill = yaw_at(w, car.x, car.y, car.z if car.slope == 1 else car.z - 1)
        for i in range(first, count):
            x, y = out[i, 0] + dir_x(downhill), out[i, 1] + dir_y(downhill)
            count = add(out, count, x, y, car.z, SPACE | LOADS)
    return count


@compiled
def add_swept(out: Claims, count: int, x: int, y: int, z: int) -> int:
    """Append a cell through which a load moves; carried, it is 32 mm into the level above."""
    count = add(out, count, x, y, z, SPACE | LOADS)
    return add(out, count, x, y, z + 1, SPACE)


@compiled
def pose_after(w: World, car: Pose, action: int) -> Pose:
    """Return a car's state after any legal action."""
    if ROTATE_LEFT <= action <= LAST_MOVE:
        return after(w, car, action)
    load, load_yaw = car.load, car.load_yaw
    if action == LIFT:
        load = kind_at(w, car.x, car.y, car.z)
        load_yaw = yaw_at(w, car.x, car.y, car.z) if load == FSLOPE else 0
    elif action == DROP:
        load, load_yaw = AIR, 0
    return Pose(car.x, car.y, car.z, car.yaw, load, load_yaw, car.slope)


@compiled(inline=False)
def claims_of(w: World, car: Pose, action: int, out: Claims) -> int:
    """Write the claims of a legal action of the 15 into out (MOST, 4), the same cell maybe twice; return the rows."""
    new = pose_after(w, car, action)
    count = add_standing(w, new, out, add_standing(w, car, out, 0))
    x, y, z = car.x, car.y, car.z
    if FIRST_MOVE <= action <= LAST_MOVE:
        # A load sweeps the space that it stands in before and after.
        for i in range(count if car.load != AIR else 0):
            if out[i, 3] & SPACE:
                count = add_swept(out, count, out[i, 0], out[i, 1], out[i, 2])
    elif action in (ROTATE_LEFT, ROTATE_RIGHT) and car.load != AIR:
        # A load sweeps the neighbour cells, a folded slope the corners, too.
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                if dx == 0 or dy == 0 or car.load == FSLOPE:
                    count = add_swept(out, count, x + dx, y + dy, z)
    elif action in (LIFT, DROP):
        # The object, a slope's gear too, and room above it.
        count = add(out, count, x, y, z, SPACE | CHANGES | LOADS)
        held = new if action == LIFT else car
        if held.load == FSLOPE:
            gx, gy = x + dir_x(held.load_yaw), y + dir_y(held.load_yaw)
            count = add(out, count, gx, gy, z, SPACE | CHANGES | LOADS)
        count = add(out, count, x, y, z + 1, SPACE)
    elif action in (FOLD, UNFOLD):
        # The flap is a third of a metre long: it reaches into the second level above, and 12 mm past the foot's cell.
        fx, fy = x + dir_x(car.yaw + 2), y + dir_y(car.yaw + 2)
        for up in range(3):
            bits = SPACE | CHANGES if up == 0 else SPACE
            count = add(out, count, x, y, z + up, bits)
            count = add(out, count, fx, fy, z + up, bits)
        count = add(out, count, fx + dir_x(car.yaw + 2), fy + dir_y(car.yaw + 2), z, SPACE)
        count = add(out, count, fx, fy, z - 1, RELIES)
    return count


@compiled
def write_claims(
    cells: NDArray[np.int16], cars: NDArray[np.int16], corrections: int, car: int, action: int, out: Claims
) -> int:
    """Do the same for a car of a single world, for Python."""
    w = World(cells, cars, corrections)
    return claims_of(w, pose_of(w, car), action, out)


@compiled
def on_board(board: Board, x: int, y: int, z: int) -> bool:
    """Return whether a place (x, y, z) of a board is there."""
    return 0 <= x < board.shape[0] and 0 <= y < board.shape[1] and 0 <= z < board.shape[2]


@compiled(inline=False)
def mark(board: Board, claims: Claims, count: int, is_set: bool) -> None:
    """Mark claims on a board, or clear all that is marked there."""
    for i in range(count):
        x, y, z, bits = claims[i, 0] + MARGIN, claims[i, 1] + MARGIN, claims[i, 2], claims[i, 3]
        if on_board(board, x, y, z):
            board[x, y, z] = board[x, y, z] | bits if is_set else 0
        if bits & LOADS:
            for d in range(5):
                bx, by = (x, y) if d == 4 else (x + dir_x(d), y + dir_y(d))
                if on_board(board, bx, by, z):
                    board[bx, by, z] = board[bx, by, z] | BESIDE if is_set else 0


@compiled(inline=False)
def clashes(board: Board, claims: Claims, count: int) -> bool:
    """Return whether an action with these claims must not run together with one that is marked on a board."""
    for i in range(count):
        x, y, z, bits = claims[i, 0] + MARGIN, claims[i, 1] + MARGIN, claims[i, 2], claims[i, 3]
        if not on_board(board, x, y, z):
            continue
        there = board[x, y, z]
        if (
            bits & there & SPACE
            or (bits & CHANGES and there & (CHANGES | RELIES))
            or (bits & RELIES and there & CHANGES)
            or (bits & LOADS and there & BESIDE)
        ):
            return True
    return False
