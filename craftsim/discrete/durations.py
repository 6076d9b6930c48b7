"""How long actions take at nominal physics: what a grid world, which has no clock, says of time.

The table is ``craftsim/data/durations.yaml``; ``craftsim bench durations`` measures it.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Final

import numpy as np
import yaml
from numpy.typing import NDArray

from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import suggestion

SITUATIONS: Final = ("flat", "flat_loaded", "slope", "slope_loaded")
"""Columns of the table: whether a move starts or ends on a slope, and whether the car is loaded before its action."""

_FILE: Final = "craftsim/data/durations.yaml"


@cache
def nominal_durations() -> NDArray[np.float64]:
    """Return the shipped table in seconds, shape (15, 4): by action and situation, 0 for what does not happen.

    Raises RuntimeError, with the name of the action, if a row is missing or belongs to no action.
    """
    rows = yaml.safe_load(files("craftsim.data").joinpath("durations.yaml").read_text(encoding="utf-8"))
    table = np.zeros((len(Action), len(SITUATIONS)))
    for action, spec in ACTIONS.items():
        if not spec.performed:
            continue
        if spec.duration not in rows:
            raise RuntimeError(f"{action.name}: no row '{spec.duration}' in {_FILE}; measure it and add one")
        table[action] = [rows[spec.duration].get(name, 0.0) for name in SITUATIONS]
    known = {spec.duration for spec in ACTIONS.values()}
    for row in rows:
        if row not in known:
            raise RuntimeError(f"{_FILE}: row '{row}' belongs to no action{suggestion(row, known)}")
    return table


def situation(before: NDArray[np.integer], after: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the column of the table, shape (...), for cars (..., 7) before and after an action."""
    sloping = (before[..., CarField.SLOPE] > 0) | (after[..., CarField.SLOPE] > 0)
    column: NDArray[np.int64] = 2 * sloping + (before[..., CarField.LOAD] != Kind.AIR)
    return column


def tick_durations(
    before: NDArray[np.integer],
    after: NDArray[np.integer],
    actions: NDArray[np.integer],
    applied: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Return how long a tick takes when all cars act at once, the slowest car's time, shape (...).

    That cars may have to wait for each other is not counted. Arguments are the cars of worlds before and after the tick
    (..., n, 7), their actions (..., n), and whether these were carried out. What the action helper does instead of a
    move follows from what has changed.
    """
    turned = (before[..., CarField.YAW] != after[..., CarField.YAW]) & applied
    moved = (before[..., :3] != after[..., :3]).any(-1) | (
        before[..., CarField.SLOPE] != after[..., CarField.SLOPE]
    )
    done = np.where(moved, Action.MOVE_FORWARD, np.where(turned, Action.ROTATE_LEFT, actions))
    seconds = nominal_durations()[done, situation(before, after)] * applied
    longest: NDArray[np.float64] = seconds.max(-1, initial=0.0)
    return longest
