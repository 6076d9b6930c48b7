"""The claims of actions: which cells an action needs while it runs, and whether two actions need the same.

A claim is a row (x, y, z, bits); an action has a list of them. Two actions of different cars may run at the same time
when neither sweeps space that the other sweeps, neither changes an object that the other relies on, and no two loads in
motion pass side by side, where 2.5 mm of air are too little for two moving machines.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from craftsim.compiled.jit import compiled
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
from craftsim.discrete.kernel.state import (
    AIR,
    FSLOPE,
    CarState,
    Patterns,
    World,
    after,
    dir_x,
    dir_y,
    state_of_car,
    yaw_at,
)

SPACE = 1
"""Swept by the car, its load or a flap."""
CHANGES = 2
"""Cell whose object the action takes, puts down or turns."""
RELIES = 4
"""Cell whose object must stay as it is: it is stood on, driven under or out of."""
LOADS = 8
"""Cell through which a load moves, sideways play and all."""
MOST = 48
"""Rows that the claims of one of the 15 actions may take."""
Claims = NDArray[np.int16]
"""(rows, 4)."""


@compiled
def add(out: Claims, count: int, x: int, y: int, z: int, bits: int) -> int:
    """Append a row; return how many there are now."""
    out[count, 0] = x
    out[count, 1] = y
    out[count, 2] = z
    out[count, 3] = bits
    return count + 1


@compiled
def _add_standing(w: World, car: CarState, out: Claims, count: int) -> int:
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
        x = car.x + dir_x(car.load_yaw)
        y = car.y + dir_y(car.load_yaw)
        count = add(out, count, x, y, car.z, SPACE | LOADS)
    if car.slope != 0:
        # A load leans downhill with its car, by 40 to 60 mm at its height: into the next cell.
        downhill = yaw_at(w, car.x, car.y, car.z if car.slope == 1 else car.z - 1)
        for i in range(first, count):
            x = out[i, 0] + dir_x(downhill)
            y = out[i, 1] + dir_y(downhill)
            count = add(out, count, x, y, car.z, SPACE | LOADS)
    return count


@compiled
def _add_swept(out: Claims, count: int, x: int, y: int, z: int) -> int:
    """Append a cell through which a load moves; carried, it is 32 mm into the level above."""
    count = add(out, count, x, y, z, SPACE | LOADS)
    return add(out, count, x, y, z + 1, SPACE)


@compiled
def _add_rest_of_ramp(car: CarState, new: CarState, out: Claims, count: int) -> int:
    """Append what the rules ask of the rest of a ramp, and of its far end, when a car drives onto it from the flat."""
    if car.slope != 0 or new.slope == 0:
        return count
    dx = new.x - car.x
    dy = new.y - car.y
    z = car.z + 1 if new.slope == 1 else car.z - 1
    count = add(out, count, car.x + 2 * dx, car.y + 2 * dy, z, SPACE)
    count = add(out, count, car.x + 3 * dx, car.y + 3 * dy, z, SPACE)
    return add(out, count, car.x + 3 * dx, car.y + 3 * dy, z - 1, RELIES)


@compiled(inline=False)
def claims_of(w: World, car: CarState, action: int, out: Claims) -> int:
    """Write the claims of a legal action of the 15 into out (MOST, 4), the same cell maybe twice; return the rows."""
    new = after(w, car, action)
    moves = FIRST_MOVE <= action <= LAST_MOVE
    count = _add_standing(w, car, out, 0)
    if moves or new.load != car.load or car.load == FSLOPE:
        count = _add_standing(w, new, out, count)
    x = car.x
    y = car.y
    z = car.z
    if moves:
        # A load sweeps the space that it stands in before and after.
        for i in range(count if car.load != AIR else 0):
            if out[i, 3] & SPACE:
                # As the other numbers: a function is compiled for one type of them.
                cx = int(np.int64(out[i, 0]))
                cy = int(np.int64(out[i, 1]))
                cz = int(np.int64(out[i, 2]))
                count = _add_swept(out, count, cx, cy, cz)
        count = _add_rest_of_ramp(car, new, out, count)
    elif action in (ROTATE_LEFT, ROTATE_RIGHT) and car.load != AIR:
        # A load sweeps the neighbour cells, a folded slope the corners, too.
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                if dx == 0 or dy == 0 or car.load == FSLOPE:
                    count = _add_swept(out, count, x + dx, y + dy, z)
    elif action in (LIFT, DROP):
        # The object, a slope's gear too, and room above it.
        count = add(out, count, x, y, z, SPACE | CHANGES | LOADS)
        loaded = new if action == LIFT else car
        if loaded.load == FSLOPE:
            gx = x + dir_x(loaded.load_yaw)
            gy = y + dir_y(loaded.load_yaw)
            count = add(out, count, gx, gy, z, SPACE | CHANGES | LOADS)
        count = add(out, count, x, y, z + 1, SPACE)
    elif action in (FOLD, UNFOLD):
        # The flap is a third of a metre long: it reaches into the second level above, and 12 mm past the foot's cell.
        fx = x + dir_x(car.yaw + 2)
        fy = y + dir_y(car.yaw + 2)
        for up in range(3):
            bits = SPACE | CHANGES if up == 0 else SPACE
            count = add(out, count, x, y, z + up, bits)
            count = add(out, count, fx, fy, z + up, bits)
        count = add(out, count, fx + dir_x(car.yaw + 2), fy + dir_y(car.yaw + 2), z, SPACE)
        count = add(out, count, fx, fy, z - 1, RELIES)
    return count


@compiled
def write_claims(
    cells: NDArray[np.int16],
    cars: NDArray[np.int16],
    corrections: int,
    patterns: Patterns,
    car: int,
    action: int,
    out: Claims,
) -> int:
    """Do the same for a car of a single world, for Python."""
    w = World(cells, cars, corrections, patterns)
    return claims_of(w, state_of_car(w, car), action, out)


@compiled(inline=False)
def conflict(first: Claims, n_first: int, x: int, y: int, z: int, theirs: int) -> bool:
    """Return whether an action with the claims ``first`` must not run beside one that claims ``theirs`` in a cell."""
    for i in range(n_first):
        apart = abs(first[i, 0] - x) + abs(first[i, 1] - y)
        if apart > 1 or first[i, 2] != z:
            continue
        mine = first[i, 3]
        if mine & theirs & LOADS:
            return True
        if apart == 0 and (
            mine & theirs & SPACE
            or (mine & CHANGES and theirs & (CHANGES | RELIES))
            or (mine & RELIES and theirs & CHANGES)
        ):
            return True
    return False
