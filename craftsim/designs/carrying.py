"""Where a car can carry a block or a folded slope, in a building of columns and ramps: a short form of the rules.

A loaded car goes in any direction, turns only where nothing is around it, and drives up a ramp facing it. Behind it a
slope's gear takes a cell of its own, which needs no floor. Each state is [level, x, y, yaw of the car].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.jit import compiled
from craftsim.discrete.kernel.state import dir_x, dir_y


@compiled
def _is_air(heights: NDArray[np.int64], solid: NDArray[np.bool_], x: int, y: int, z: int) -> bool:
    if not (0 <= x < heights.shape[0] and 0 <= y < heights.shape[1]):
        return False
    return bool(heights[x, y] < z and not solid[z, x, y])


@compiled
def _can_turn(
    heights: NDArray[np.int64],
    solid: NDArray[np.bool_],
    x: int,
    y: int,
    z: int,
    yaw: int,
    turn: int,
    slope: bool,
) -> bool:
    for d in range(4):
        if not _is_air(heights, solid, x + dir_x(d), y + dir_y(d), z):
            return False
    corner_x = x + dir_x(yaw + 2) + dir_x(yaw + 2 + turn)
    corner_y = y + dir_y(yaw + 2) + dir_y(yaw + 2 + turn)
    return not slope or _is_air(heights, solid, corner_x, corner_y, z)


@compiled
def _can_stand(
    heights: NDArray[np.int64], solid: NDArray[np.bool_], x: int, y: int, z: int, yaw: int, slope: bool
) -> bool:
    if not _is_air(heights, solid, x, y, z) or heights[x, y] != z - 1 or solid[z - 1, x, y]:
        return False
    return not slope or _is_air(heights, solid, x + dir_x(yaw + 2), y + dir_y(yaw + 2), z)


@compiled
def _spread(
    heights: NDArray[np.int64],
    solid: NDArray[np.bool_],
    ramps: NDArray[np.int64],
    slope: bool,
    reached: NDArray[np.bool_],
    z: int,
    x: int,
    y: int,
    yaw: int,
) -> bool:
    """Set the states that are one action, or one climb, away from one; return whether any was not set before."""
    new = False
    for d in range(4):
        nx, ny = x + dir_x(d), y + dir_y(d)
        if _can_stand(heights, solid, nx, ny, z, yaw, slope) and not reached[z, nx, ny, yaw]:
            reached[z, nx, ny, yaw] = new = True
    for turn in (1, -1):
        turned = (yaw + turn) & 3
        if not reached[z, x, y, turned] and _can_turn(heights, solid, x, y, z, yaw, turn, slope):
            reached[z, x, y, turned] = new = True
    for ramp in range(ramps.shape[0]):
        facing = ramps[ramp, 2] == z and ramps[ramp, 3] == (yaw + 2) & 3
        before = ramps[ramp, 0] == x + 2 * dir_x(yaw) and ramps[ramp, 1] == y + 2 * dir_y(yaw)
        if facing and before:
            nx, ny = x + 3 * dir_x(yaw), y + 3 * dir_y(yaw)
            if _can_stand(heights, solid, nx, ny, z + 1, yaw, slope) and not reached[z + 1, nx, ny, yaw]:
                reached[z + 1, nx, ny, yaw] = new = True
    return new


@compiled
def carry(
    heights: NDArray[np.int64],
    solid: NDArray[np.bool_],
    ramps: NDArray[np.int64],
    slope: bool,
    reached: NDArray[np.bool_],
) -> None:
    """Set all states that a loaded car reaches from those that are set.

    Args:
        heights: (L, W): blocks in each column.
        solid: (levels + 2, L, W): cells that hold something besides those blocks, by level.
        ramps: (n, 4): x, y, level and yaw of the bodies.
        slope: whether the load is a folded slope, else a block.
        reached: (levels + 2, L, W, 4).
    """
    new = True
    while new:
        new = False
        for z in range(1, reached.shape[0]):
            for x in range(reached.shape[1]):
                for y in range(reached.shape[2]):
                    for yaw in range(4):
                        if reached[z, x, y, yaw]:
                            new |= _spread(heights, solid, ramps, slope, reached, z, x, y, yaw)
