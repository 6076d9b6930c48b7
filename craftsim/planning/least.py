"""How much work a small world needs at least until a building stands: what guides the exact search."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.kernel.codes import DROP, FOLD, LIFT, UNFOLD
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
    FSLOPE,
    KIND,
    World,
    car_field,
    kind_at,
)
from craftsim.discrete.kinds import Action

_UNKNOWN: Final = 1 << 40
_MOVE: Final = int(Action.MOVE_FORWARD)


@compiled
def least_left(
    w: World,
    costs: NDArray[np.int64],
    targets: NDArray[np.int64],
    things: NDArray[np.int64],
    best: NDArray[np.int64],
) -> int:
    """Return work that is left at least: the cheapest way to give each target a thing of its own, and to begin."""
    if targets.shape[0] == 0:
        return 0
    # Kind, place and whether it is carried of each thing; ``up``: a car is above the floor, or a slope leads there.
    n_things, up = 0, False
    length, width, layers = w.cells.shape[:3]
    for x in range(length):
        for y in range(width):
            for z in range(1, layers):
                kind = w.cells[x, y, z, KIND]
                if kind in (BLOCK, FLAG, FSLOPE, BODY):
                    things[n_things, 0], things[n_things, 1], things[n_things, 2] = kind, x, y
                    things[n_things, 3], things[n_things, 4] = z, 0
                    n_things += 1
                    up = up or kind == BODY
    carrying = False
    for car in range(w.cars.shape[0]):
        up = up or car_field(w, car, F_Z) > 1
        if car_field(w, car, F_LOAD) != AIR:
            things[n_things, 0] = car_field(w, car, F_LOAD)
            things[n_things, 1], things[n_things, 2] = car_field(w, car, F_X), car_field(w, car, F_Y)
            things[n_things, 3], things[n_things, 4] = 0, 1
            n_things += 1
            carrying = True
    # What is above the floor needs a ramp to get up by: one that is asked for, or another.
    asked, missing = False, False
    for k in range(targets.shape[0]):
        kind, x, y, z = targets[k, 0], targets[k, 1], targets[k, 2], targets[k, 3]
        asked = asked or kind == BODY
        missing = missing or (z > 1 and kind_at(w, x, y, z) != kind)
    # best[k & 1, taken]: the least work for the first k targets with the things in the set ``taken``.
    n_sets = 1 << n_things
    for taken in range(n_sets):
        best[0, taken] = _UNKNOWN
    best[0, 0] = 0
    for k in range(targets.shape[0]):
        here, there = k & 1, (k + 1) & 1
        for taken in range(n_sets):
            best[there, taken] = _UNKNOWN
        for taken in range(n_sets):
            if best[here, taken] >= _UNKNOWN:
                continue
            for i in range(n_things):
                if taken >> i & 1:
                    continue
                work = best[here, taken] + _least_for(costs, targets, k, things, i)
                best[there, taken | 1 << i] = min(best[there, taken | 1 << i], work)
    least = _UNKNOWN
    for taken in range(n_sets):
        least = min(least, best[targets.shape[0] & 1, taken])
    if least == 0 or least >= _UNKNOWN:
        return least
    if missing and not (up or asked):
        least += costs[UNFOLD, 0]
    if carrying:
        return least
    nearest = _UNKNOWN
    for car in range(w.cars.shape[0]):
        for i in range(n_things):
            way = abs(car_field(w, car, F_X) - things[i, 1]) + abs(car_field(w, car, F_Y) - things[i, 2])
            nearest = min(nearest, way)
    return least + nearest * costs[_MOVE, 0]


@compiled
def _least_for(
    costs: NDArray[np.int64], targets: NDArray[np.int64], k: int, things: NDArray[np.int64], i: int
) -> int:
    """Return what it takes at least to make a thing one target's, whatever its yaw; a flag may stay on its car."""
    kind, wanted = things[i, 0], targets[k, 0]
    slope = kind in (FSLOPE, BODY)
    if kind != wanted and not (slope and wanted in (FSLOPE, BODY)):
        return _UNKNOWN
    way = abs(things[i, 1] - targets[k, 1]) + abs(things[i, 2] - targets[k, 2])
    moved = way > 0 or things[i, 4] == 1 or things[i, 3] != targets[k, 3]
    work = 0
    if moved:
        work += way * costs[_MOVE, 1]
        if things[i, 4] == 0:
            work += costs[LIFT, 0]
        if wanted != FLAG:
            work += costs[DROP, 1]
        if kind == BODY:
            work += costs[FOLD, 0]
        if wanted == BODY:
            work += costs[UNFOLD, 0]
    elif kind == BODY and wanted == FSLOPE:
        work += costs[FOLD, 0]
    elif kind == FSLOPE and wanted == BODY:
        work += costs[UNFOLD, 0]
    return work
