"""Measure how long each action takes at nominal physics, on a tour of one car that comes by every situation.

Prints what craftsim/data/durations.yaml holds for the grid environments.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Final

import numpy as np
import yaml

from craftsim.checking.setup import Setup, set_up
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.schedule import SITUATIONS, situation

_LEFT, _RIGHT, _BACK, _FORWARD = (
    Action.MOVE_LEFT,
    Action.MOVE_RIGHT,
    Action.MOVE_BACK,
    Action.MOVE_FORWARD,
)
_ABOUT: Final = (Action.ROTATE_LEFT, Action.ROTATE_LEFT)
_OVER_THE_RAMP: Final = (*3 * (_RIGHT,), *_ABOUT, *3 * (_LEFT,))

TOUR: Final[tuple[Action, ...]] = (
    Action.STOP,
    *(_LEFT, Action.UNFOLD, Action.FOLD, Action.UNFOLD),
    *(_RIGHT, _RIGHT, *_ABOUT, *_ABOUT, _RIGHT, _RIGHT),
    *(Action.LIFT, *_ABOUT, *_ABOUT, _FORWARD, *6 * (_LEFT,), _BACK),
    *_OVER_THE_RAMP,
    *(_BACK, Action.DROP, _LEFT, _FORWARD, *_ABOUT, _RIGHT),
    *_OVER_THE_RAMP,
)
"""Unfolds and folds a slope, fetches a block, takes it up the ramp and down again, and goes there once more without."""


def tour_start() -> Grid:
    """Return the world in which the tour starts: a folded slope before a block, and another block behind it."""
    grid = Grid.empty((9, 3, 3), 1)
    grid.cars[0, :4] = 4, 1, 1, 0
    grid.kind[4, 1, 1] = grid.kind[7, 1, 1] = Kind.BLOCK
    grid.kind[3, 1, 1], grid.kind[2, 1, 1] = Kind.FSLOPE, Kind.GEAR
    grid.yaw[3, 1, 1] = grid.yaw[2, 1, 1] = 2
    grid.derive_marks()
    return grid


def measure_durations() -> dict[str, dict[str, float]]:
    """Return the mean seconds of each verb in each situation that it has, rounded to hundredths.

    Raises RuntimeError if an action of the tour fails: then there is nothing to measure.
    """
    judge = set_up(tour_start(), Setup())
    seconds: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for number, action in enumerate(TOUR):
        before = judge.grid.cars
        attempt = judge.perform(0, action)
        if not attempt.agrees:
            raise RuntimeError(f"action {number} of the tour, {action.name}, failed: {attempt}")
        name = SITUATIONS[int(situation(before, judge.grid.cars)[0])]
        seconds[ACTIONS[action].duration][name].append(attempt.duration_s)
    return {
        name: {where: round(float(np.mean(taken)), 2) for where, taken in rows.items()}
        for name, rows in seconds.items()
    }


if __name__ == "__main__":
    print(yaml.safe_dump(measure_durations(), sort_keys=False), end="")
