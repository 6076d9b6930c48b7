"""The least work that reaches a goal, by a plain search through all worlds: slow, and nothing that can go wrong."""

from __future__ import annotations

from collections.abc import Callable
from heapq import heappop, heappush
from itertools import count

import numpy as np

from craftsim.discrete.grid import Grid
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import nominal_durations, situation


def least_work_by_force(
    start: Grid, reached: Callable[[Grid], bool], rules: Rules, most: int = 1 << 40
) -> int | None:
    """Return the least sum of the durations of single actions in ms, or None; RuntimeError beyond ``most`` worlds."""
    costs = np.rint(nominal_durations() * 1000).astype(int)
    queue = [(0, 0, start)]
    known = {_key(start): 0}
    number = count(1)
    while queue:
        work, _, grid = heappop(queue)
        if work > known[_key(grid)]:
            continue
        if reached(grid):
            return work
        for car, action in np.argwhere(rules.mask(grid)).tolist():
            if action == Action.STOP:
                continue
            after = rules.apply(grid, car, action)
            then = work + int(costs[action, situation(grid.cars[car], after.cars[car])])
            key = _key(after)
            if then < known.get(key, then + 1):
                known[key] = then
                heappush(queue, (then, next(number), after))
                if len(known) > most:
                    raise RuntimeError(f"more than {most} worlds")
    return None


def _key(grid: Grid) -> bytes:
    return grid.kind.tobytes() + grid.yaw.tobytes() + grid.cars.tobytes()
