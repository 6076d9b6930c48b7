"""Tiny worlds with a goal that play has reached: small enough for a search of all that can be done."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from craftsim.designs.starts import DesignStart
from craftsim.discrete.files.blueprint import Blueprint
from craftsim.discrete.files.design import design_in
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules

SIZE: Final = (4, 4, 2)
_MOST_CARS: Final = 2
_MOST_THINGS: Final = 3
_TICKS: Final = 60
"""Of play, at most."""
_EAGER: Final = {Action.LIFT: 8.0, Action.DROP: 3.0, Action.UNFOLD: 30.0}
"""How often a car does that where it can, for each time that it takes one move; a ramp takes some luck."""


def tiny_world(rng: np.random.Generator) -> DesignStart:
    """Return a start on 4 x 4 x 2 cells, of 1 or 2 cars and up to 3 blocks and slopes, and what random play made of it.

    The play obeys the physical rules, so that the goal can be reached; it is not what the start shows already, and no
    car carries a thing of it.
    """
    rules = Rules("physical")
    while True:
        things = int(rng.integers(1, _MOST_THINGS + 1))
        slopes = int(rng.integers(0, min(things, 2)))
        cars = int(rng.integers(1, _MOST_CARS + 1))
        drawing = Blueprint(Path("tiny"), SIZE, things - slopes, slopes, cars)
        start = drawing.grid(rng)
        start.derive_marks()
        goal = _play(start, rules, rng)
        if goal is not None:
            return DesignStart(start, design_in(goal, "tiny"))


def _play(start: Grid, rules: Rules, rng: np.random.Generator) -> Grid | None:
    """Return a world that random play leads to where things stand otherwise and none is carried, or None."""
    grid, ticks = start, int(rng.integers(5, _TICKS + 1))
    for tick in range(2 * ticks):
        if tick >= ticks and _is_another(start, grid):
            return grid
        legal = rules.mask(grid)
        legal[:, Action.STOP] = False
        weights = legal * [_EAGER.get(action, 1.0) for action in Action]
        if not weights.any():
            return None
        choice = int(rng.choice(weights.size, p=weights.ravel() / weights.sum()))
        grid = rules.apply(grid, choice // legal.shape[1], choice % legal.shape[1])
    return None


def _is_another(start: Grid, grid: Grid) -> bool:
    carried = grid.cars[:, CarField.LOAD] != Kind.AIR
    return not carried.any() and not design_in(grid).satisfied(start)
