"""Comparing the Grid read from poses with the predicted one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.readback import Reading

HEADINGS: Final = ("+x", "+y", "-x", "-y")
"""The four grid yaws as map directions."""


class Finding(StrEnum):
    """What the comparison of prediction and reading found."""

    AGREES = "agrees"
    NOT_EXECUTED = "not executed"
    WRONG_PLACE = "wrong place"
    SIDE_EFFECT = "side effect"
    UNREADABLE = "unreadable"
    UNSAFE = "unsafe"
    """Something tipped, fell, or hit harder than it may."""
    UNSETTLED = "unsettled"
    """Something still moves although no motor is commanded."""
    NUMERICS = "numerics"
    """The solver did not converge, or found forces that nothing could have produced: this proves nothing."""
    DIVERGED = "diverged"
    """The simulation broke down."""


@dataclass(frozen=True)
class Verdict:
    """Whether an action did what the rules predicted, and in words what differs where it did not."""

    finding: Finding
    differences: tuple[str, ...] = ()

    @property
    def agrees(self) -> bool:
        """Whether the reading equals the prediction."""
        return self.finding is Finding.AGREES


def compare(before: Grid, predicted: Grid, reading: Reading) -> Verdict:
    """Return the verdict on one action: the Grid before it, the one the rules predict, and what was read after it."""
    if reading.problems:
        return Verdict(Finding.UNREADABLE, reading.problems)
    read = reading.grid
    if read.same_visible(predicted):
        return Verdict(Finding.AGREES)
    differences = tuple(describe_differences(predicted, read))
    if read.same_visible(before):
        return Verdict(Finding.NOT_EXECUTED, differences)
    if _untouched_changed(before, predicted, read):
        return Verdict(Finding.SIDE_EFFECT, differences)
    return Verdict(Finding.WRONG_PLACE, differences)


def own_differences(before: Grid, predicted: Grid, read: Grid, car: int) -> list[str]:
    """Return a line for each thing that a car's action was to change and that reads otherwise than predicted."""
    lines = []
    wrong = (predicted.kind != read.kind) | (predicted.yaw != read.yaw)
    if wrong.any():
        wrong &= (before.kind != predicted.kind) | (before.yaw != predicted.yaw)
        lines = [_describe_cell(predicted, read, cell) for cell in np.argwhere(wrong).tolist()]
    if (predicted.cars[car] != read.cars[car]).any():
        lines.append(_describe_cars(predicted, read, car))
    return lines


def _untouched_changed(before: Grid, predicted: Grid, read: Grid) -> bool:
    """Return whether something that the prediction leaves alone is not as it was."""
    still_cells = (before.kind == predicted.kind) & (before.yaw == predicted.yaw)
    changed_cells = (before.kind != read.kind) | (before.yaw != read.yaw)
    still_cars = (before.cars == predicted.cars).all(axis=1)
    changed_cars = (before.cars != read.cars).any(axis=1)
    return bool((still_cells & changed_cells).any() or (still_cars & changed_cars).any())


def describe_differences(predicted: Grid, read: Grid) -> list[str]:
    """Return one line for each cell and each car in which two Grids of one size differ."""
    cells = np.argwhere((predicted.kind != read.kind) | (predicted.yaw != read.yaw)).tolist()
    cars = np.flatnonzero((predicted.cars != read.cars).any(axis=1)).tolist()
    return [
        *(_describe_cell(predicted, read, cell) for cell in cells),
        *(_describe_cars(predicted, read, car) for car in cars),
    ]


def _describe_cell(predicted: Grid, read: Grid, cell: list[int]) -> str:
    x, y, z = cell
    want, got = (f"{Kind(g.kind[x, y, z]).name.lower()} yaw {g.yaw[x, y, z]}" for g in (predicted, read))
    return f"cell ({x}, {y}, {z}): predicted {want}, read {got}"


def _describe_cars(predicted: Grid, read: Grid, car: int) -> str:
    return f"car {car}: predicted {describe_car(predicted, car)}, read {describe_car(read, car)}"


def describe_car(grid: Grid, car: int) -> str:
    """Return a car's cell, heading, load and place on a slope in brief, such as ``2,3,1 +y block``."""
    x, y, z, yaw, load, load_yaw, slope = grid.cars[car].tolist()
    words = [f"{x},{y},{z} {HEADINGS[yaw]}"]
    if load != Kind.AIR:
        words.append(Kind(load).name.lower() + (HEADINGS[load_yaw] if load == Kind.FSLOPE else ""))
    if slope:
        words.append("low" if slope == 1 else "high")
    return " ".join(words)
