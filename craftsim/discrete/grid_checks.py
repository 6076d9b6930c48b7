"""Can the compiled rules work on a world that comes from outside? They look up what its arrays hold and check nothing.

What play may lead to need not make sense, and is not checked for it: two cars in a cell, half a slope, old marks.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.files.blueprint import MAX_CARS, MAX_CELLS, MAX_SIDE
from craftsim.discrete.grid import KINDS_WITH_YAW, Cell, Grid
from craftsim.discrete.kinds import CARRIED, NAMES, CarField, CellField, Kind
from craftsim.errors import InputError

_LOADS: Final = (Kind.AIR, *CARRIED)
_ARRAYS: Final = {"cells": len(CellField), "cars": len(CarField)}
"""Of a :class:`Grid`, with the length of the last axis."""

Checks = list[tuple[str, NDArray[Any], NDArray[np.bool_], str]]
"""A field, its values, where they are wrong, and what is allowed."""


def check_size(size: Cell, n_cars: int) -> None:
    """Raise InputError for a map that is larger than any blueprint's, or has none of its cells, or too many cars."""
    if not all(1 <= side <= MAX_SIDE for side in size) or size[0] * size[1] * size[2] > MAX_CELLS:
        raise InputError(
            f"the size is {tuple(size)}; allowed: 1 to {MAX_SIDE} each way, and at most {MAX_CELLS} cells"
        )
    if n_cars > MAX_CARS:
        raise InputError(f"{n_cars} cars; allowed: at most {MAX_CARS}")


def check_grid(grid: Grid) -> None:
    """Raise InputError, with cell or car and what is allowed, for arrays that are not those of a world."""
    for name in _ARRAYS:
        array = getattr(grid, name)
        if not isinstance(array, np.ndarray) or array.dtype != np.int16:
            found = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
            raise InputError(f"the array '{name}' holds {found}; allowed: int16")
    shapes = grid.cells.shape, grid.cars.shape
    if [len(shape) for shape in shapes] != [4, 2] or [shape[-1] for shape in shapes] != [*_ARRAYS.values()]:
        raise InputError(
            f"the arrays have the shapes {shapes[0]} and {shapes[1]}; allowed: (L, W, H + 1, {len(CellField)}) for "
            f"the cells, and (n, {len(CarField)}) for the cars"
        )
    check_size(grid.size, grid.n_cars)
    check_values(grid)


def check_values(grid: Grid) -> None:
    """Raise InputError for the first cell or car that holds what no world has; the arrays are those of a grid."""
    if found := _first(_cell_checks(grid)):
        name, value, allowed, place = found
        raise InputError(f"'{name}' of the cell {place} is {value}; allowed: {allowed}")
    if found := _first(_car_checks(grid)):
        name, value, allowed, (car,) = found
        if name == "cell":
            at = tuple(grid.cars[car, : CarField.Z + 1].tolist())
            raise InputError(f"car {car} is at {at}, outside the map of size {grid.size}")
        raise InputError(f"'{name}' of car {car} is {value}; allowed: {allowed}")


def _first(checks: Checks) -> tuple[str, int, str, tuple[int, ...]] | None:
    """Return the first check that fails at the first place where any does: field, value, what is allowed, place."""
    bad = np.logical_or.reduce([wrong for _, _, wrong, _ in checks])
    if not bad.any():
        return None
    place = tuple(int(i) for i in np.unravel_index(int(bad.argmax()), bad.shape))
    name, values, _, allowed = next(check for check in checks if check[2][place])
    return name, int(values[place]), allowed, place


def _cell_checks(grid: Grid) -> Checks:
    kind, yaw, occupant = grid.kind, grid.yaw, grid.occupant
    in_ground_layer = np.arange(kind.shape[2]) == 0
    most_yaw = 3 * np.isin(kind, KINDS_WITH_YAW)
    landing = (grid.landing != 0) & ((kind != Kind.BLOCK) | (grid.landing != 1))
    return [
        ("kind", kind, (kind < Kind.AIR) | (kind >= len(Kind)), f"the kinds 0 to {len(Kind) - 1}"),
        ("kind", kind, in_ground_layer != (kind == Kind.GROUND), "ground in the layer 0, and nowhere else"),
        ("yaw", yaw, (yaw < 0) | (yaw > most_yaw), "the yaws 0 to 3 for what has one, else 0"),
        (
            "top",
            occupant,
            (occupant < -2) | (occupant >= grid.n_cars),
            "the marks -2, -1 and the numbers of its cars",
        ),
        ("back", grid.landing, landing, "a mark as landing on blocks alone"),
    ]


def _car_checks(grid: Grid) -> Checks:
    x, y, z, yaw, load, load_yaw, slope = grid.cars.T
    length, width, height = grid.size
    # A car may stand above the highest cell.
    inside = (x >= 0) & (x < length) & (y >= 0) & (y < width) & (z >= 1) & (z <= height + 1)
    named = f"{', '.join(NAMES[kind] for kind in _LOADS[:-1])} or {NAMES[_LOADS[-1]]}"
    loads = f"{named} ({', '.join(str(int(kind)) for kind in _LOADS)})"
    turned = "0 to 3 with a folded slope, else 0"
    on_slope = (slope == 0) | ((slope == 1) & (z <= height)) | ((slope == 2) & (z > 1))
    return [
        ("cell", x, ~inside, ""),
        ("yaw", yaw, (yaw < 0) | (yaw > 3), "0 to 3"),
        ("load", load, ~np.isin(load, _LOADS), loads),
        ("load_yaw", load_yaw, (load_yaw < 0) | (load_yaw > 3 * (load == Kind.FSLOPE)), turned),
        ("slope", slope, ~on_slope, "0, 1 below the top level, and 2 above the floor"),
    ]
