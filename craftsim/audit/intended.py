"""What a forbidden action would have done, had the rules allowed it."""

from __future__ import annotations

from typing import Final

from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, beside
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
from craftsim.discrete.rules import Rules

_LEVEL: Final = (Kind.GROUND, Kind.BLOCK, Kind.FLAG, Kind.FSLOPE)
"""What has a level top at the height of the next floor, whether the rules let anything stand on it or not."""
_ROOMY: Final = (Kind.AIR, Kind.GEAR, Kind.FOOT)
"""What leaves room for a carried thing in its cell, as far as cells can tell."""


class NoPredictionError(Exception):
    """The action would have no effect that the rules have a world for; the reason in a few words."""


def intended(grid: Grid, car: int, action: Action) -> Grid:
    """Return the world that an action leads to by the effects of the physical rules, whether it is legal or not.

    Raises NoPredictionError where there is nothing to do, no room for what would be there, or no such state.
    """
    if nothing := ACTIONS[action].nothing_to_try(grid, car):
        raise NoPredictionError(nothing)
    after = Rules("physical").enforce(grid, car, action)
    if action in MOVE_DIRECTION:
        ax, ay, az = (int(v) for v in after.cars[car, : CarField.Z + 1])
        _check_target(grid, (ax, ay, az), Kind(grid.cars[car, CarField.LOAD]))
    after.derive_marks()
    _check_state(after, car)
    return after


def _check_target(grid: Grid, cell: Cell, load: Kind) -> None:
    """Raise NoPredictionError where a move leads to no place for the car and its load."""
    there = _kind_at(grid, cell)
    if there == Kind.WALL:
        raise NoPredictionError("a wall is there")
    if load != Kind.AIR and there not in _ROOMY:
        raise NoPredictionError("two things would share a cell")
    if (grid.cars[:, : CarField.Z + 1] == cell).all(axis=1).any():
        raise NoPredictionError("a car is there")


def _check_state(grid: Grid, car: int) -> None:
    """Raise NoPredictionError where the rules have no such state of a car."""
    x, y, z, yaw, load, load_yaw, slope = (int(v) for v in grid.cars[car])
    here, below = _kind_at(grid, (x, y, z)), _kind_at(grid, (x, y, z - 1))
    off_slope = (slope == 1) != (here == Kind.FOOT) or (slope == 2) != (below == Kind.BODY)
    if off_slope or (slope == 0 and below not in _LEVEL):
        raise NoPredictionError("there is no ground to stand on")
    if slope and (yaw - int(grid.yaw[x, y, z if slope == 1 else z - 1])) % 2:
        raise NoPredictionError("a car across a slope is no state of the rules")
    if load == Kind.FSLOPE:
        gear = _kind_at(grid, beside((x, y, z), load_yaw))
        if not slope and gear not in _ROOMY:
            raise NoPredictionError("two things would share a cell")


def _kind_at(grid: Grid, cell: Cell) -> Kind:
    """Return what is in a cell, above the map nothing; raise NoPredictionError beside it."""
    (x, y, z), (length, width, height) = cell, grid.kind.shape
    if not (0 <= x < length and 0 <= y < width):
        raise NoPredictionError("the map ends there")
    return Kind(grid.kind[cell]) if z < height else Kind.AIR
