"""How large a world physics takes: what compiles in seconds and a few hundred megabytes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from craftsim.discrete.grid import CarField, Cell, Grid, Kind
from craftsim.discrete.kinds import STANDING
from craftsim.errors import InputError, StartError
from craftsim.storage.limits import PHYSICS_CARS, PHYSICS_CELLS, PHYSICS_GOALS, PHYSICS_PARTS


def check_extent(grid: Grid, goals: Sequence[Cell] = ()) -> None:
    """Raise InputError for a world that is too large for physics, and for goals outside of it.

    Raises StartError for two cars in one cell.
    """
    loads = int((grid.cars[:, CarField.LOAD] != Kind.AIR).sum())
    parts = grid.n_cars + loads + int(np.isin(grid.kind, STANDING).sum())
    length, width, height = grid.size
    for number, most, what in (
        (length * width * height, PHYSICS_CELLS, "cells"),
        (grid.n_cars, PHYSICS_CARS, "cars"),
        (parts, PHYSICS_PARTS, "parts, which are cars, loads, blocks, slopes, flags and walls together"),
        (len(goals), PHYSICS_GOALS, "marked goals"),
    ):
        if number > most:
            raise InputError(
                f"a world of {number} {what}: too large for physics; allowed: at most {most}. The grid alone takes it"
            )
    places = Counter((x, y, z) for x, y, z in grid.cars[:, [CarField.X, CarField.Y, CarField.Z]].tolist())
    for cell, cars in places.items():
        if cars > 1:
            raise StartError(f"this world cannot be: {cars} cars are in one cell, {cell}")
    for goal in goals:
        if not all(0 <= c < n for c, n in zip(goal, (length, width, height + 2), strict=True)):
            raise InputError(f"the goal {goal} is outside of the area of {grid.size} cells")
