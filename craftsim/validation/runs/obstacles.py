"""A world with cars out of action, as a planner for the others sees it: walls where these stand."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from craftsim.checking.judge import Judge
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import CarField, Cell, Grid, Kind, beside
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import PLACE_TOLERANCE_M
from craftsim.discrete.tasks import Task
from craftsim.planning.planned import Ticks

_HALF_M: Final = CELL_PITCH_M / 2 - PLACE_TOLERANCE_M
"""A car is taken to reach so far from its middle: one that stands in its cell to within what can be read fills it."""


@dataclass(frozen=True)
class Without:
    """A world in which cars out of action are walls."""

    grid: Grid
    cars: tuple[int, ...]
    """The numbers, in the real world, of the cars that act."""

    @classmethod
    def of(cls, judge: Judge, task: Task, out: Iterable[int]) -> Without:
        """Return the world as it was read last without the cars that are out of action.

        What stands where one of them is stays if the design has it there: it bears what comes upon it.
        """
        real, gone = judge.grid, sorted(out)
        acting = tuple(car for car in range(real.n_cars) if car not in gone)
        grid = real.copy()
        grid.cars = real.cars[list(acting)]
        walled = {cell for car in gone for cell in _cells(judge, car)}
        if task.design is not None:
            walled -= {target.cell for target, hit in task.design.hits(real) if hit} - _unreadable(judge)
        walled |= {cell for one in list(walled) for cell in _other_part(real, one)}
        for cell in walled:
            grid.kind[cell], grid.yaw[cell] = Kind.WALL, 0
        grid.derive_marks()
        return cls(grid, acting)

    def in_real_numbers(self, ticks: Ticks) -> list[list[tuple[int, Action]]]:
        """Return a plan for this world as one for the real one."""
        return [[(self.cars[car], action) for car, action in joint] for joint in ticks]


def stuck_with(judge: Judge, out: Iterable[int]) -> Iterator[str]:
    """Yield the names of cars out of action, and of what they carry or stand under."""
    for car in out:
        yield f"car {car}"
        cells = _cells(judge, car)
        for index, placed in enumerate(judge.reading.objects):
            if placed.carrier == car or placed.cell in cells:
                yield judge.poses.name(index)


def _unreadable(judge: Judge) -> set[Cell]:
    """Return the cells of what stands in them only nearly, such as a slope that is half open."""
    names = {judge.poses.name(index): placed for index, placed in enumerate(judge.reading.objects)}
    return {
        placed.cell
        for name, placed in names.items()
        if any(text.startswith(f"{name} ") for text in judge.problems)
    }


def _cells(judge: Judge, car: int) -> set[Cell]:
    """Return the cells that a car reaches into."""
    grid = judge.grid
    length, width, height = grid.size
    x, y, _ = judge.poses.car_positions[car]
    z = min(int(grid.cars[car, CarField.Z]), height)
    sides = [np.floor((at + np.array([-_HALF_M, _HALF_M])) / CELL_PITCH_M).astype(int) for at in (x, y)]
    cells = {(int(i), int(j), z) for i, j in product(*sides)}
    return {cell for cell in cells if 0 <= cell[0] < length and 0 <= cell[1] < width}


def _other_part(grid: Grid, cell: Cell) -> list[Cell]:
    """Return the other cell of the slope that is in a cell, if one is."""
    kind, yaw = grid.kind[cell], int(grid.yaw[cell])
    if kind in (Kind.FSLOPE, Kind.BODY):
        return [beside(cell, yaw)]
    return [beside(cell, yaw + 2)] if kind in (Kind.GEAR, Kind.FOOT) else []
