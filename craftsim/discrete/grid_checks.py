"""Can the compiled rules work on a world that comes from outside? They look up what its arrays hold and check nothing.

What play may lead to need not make sense, and is not checked for it: two cars in a cell, half a slope, old marks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from craftsim.discrete.cells import (
    AIR,
    BLOCK,
    BODY,
    F_LOAD,
    F_LOAD_YAW,
    F_SLOPE,
    F_X,
    F_Y,
    F_YAW,
    F_Z,
    FLAG,
    FOOT,
    FSLOPE,
    GEAR,
    GROUND,
    OBJECT,
    RuleFlags,
    World,
    derive_marks,
)
from craftsim.discrete.files.blueprint import MAX_CARS, MAX_CELLS, MAX_SIDE
from craftsim.discrete.grid import CarField, Cell, Grid
from craftsim.discrete.kernel.jit import compiled
from craftsim.errors import InputError

DTYPES: Final = {"kind": np.int8, "yaw": np.int8, "cars": np.int64, "top": np.int16, "back": np.bool_}
"""Of the arrays of a :class:`Grid`."""

SOUND, KIND, LAYER, YAW, TOP, BACK, CAR_CELL, CAR_YAW, LOAD, LOAD_YAW, SLOPE = range(11)
"""What is wrong with a world, or nothing: first of a cell, then of a car."""

_ALLOWED: Final = {
    KIND: "the kinds 0 to 8",
    LAYER: "ground in the layer 0, and nowhere else",
    YAW: "the yaws 0 to 3 for what has one, else 0",
    TOP: "the marks -2, -1 and the numbers of its cars",
    BACK: "a mark as landing on blocks alone",
    CAR_YAW: "0 to 3",
    LOAD: "nothing, a block, a flag or a folded slope (0, 3, 4, 5)",
    LOAD_YAW: "0 to 3 with a folded slope, else 0",
    SLOPE: "0, 1 below the top level, and 2 above the floor",
}

_NO_FLAGS: Final = RuleFlags()


@compiled
def _cell_fault(w: World, x: int, y: int, z: int) -> int:
    kind, yaw = int(np.int64(w.kind[x, y, z])), int(np.int64(w.yaw[x, y, z]))
    if not AIR <= kind <= FOOT:
        return KIND
    if (z == 0) != (kind == GROUND):
        return LAYER
    most = 3 if kind in (FSLOPE, GEAR, BODY, FOOT) else 0
    if not 0 <= yaw <= most:
        return YAW
    if not OBJECT <= int(np.int64(w.top[x, y, z])) < w.cars.shape[0]:
        return TOP
    return BACK if w.back[x, y, z] and kind != BLOCK else SOUND


@compiled
def _car_fault(w: World, car: int) -> int:
    x, y, z = w.cars[car, F_X], w.cars[car, F_Y], w.cars[car, F_Z]
    # It may stand above the highest cell.
    if not (0 <= x < w.kind.shape[0] and 0 <= y < w.kind.shape[1] and 1 <= z <= w.kind.shape[2]):
        return CAR_CELL
    if not 0 <= w.cars[car, F_YAW] <= 3:
        return CAR_YAW
    load = w.cars[car, F_LOAD]
    if load not in (AIR, BLOCK, FLAG, FSLOPE):
        return LOAD
    most = 3 if load == FSLOPE else 0
    if not 0 <= w.cars[car, F_LOAD_YAW] <= most:
        return LOAD_YAW
    slope = w.cars[car, F_SLOPE]
    if slope == 0 or (slope == 1 and z < w.kind.shape[2]) or (slope == 2 and z > 1):
        return SOUND
    return SLOPE


@compiled
def _first_fault(w: World, place: NDArray[np.int64]) -> int:
    """Return what is wrong first, and write where into place (3,): a cell, or the number of a car."""
    for x in range(w.kind.shape[0]):
        for y in range(w.kind.shape[1]):
            for z in range(w.kind.shape[2]):
                fault = _cell_fault(w, x, y, z)
                if fault != SOUND:
                    place[0], place[1], place[2] = x, y, z
                    return fault
    for car in range(w.cars.shape[0]):
        fault = _car_fault(w, car)
        if fault != SOUND:
            place[0] = car
            return fault
    return SOUND


@compiled
def _marked_first_fault(w: World, place: NDArray[np.int64]) -> int:
    derive_marks(w)
    return _first_fault(w, place)


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
    for name, dtype in DTYPES.items():
        array = getattr(grid, name)
        if not isinstance(array, np.ndarray) or array.dtype != dtype:
            found = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
            raise InputError(f"the array '{name}' holds {found}; allowed: {np.dtype(dtype)}")
    shapes = {getattr(grid, name).shape for name in ("kind", "yaw", "top", "back")}
    if len(shapes) > 1 or grid.kind.ndim != 3 or grid.cars.shape[1:] != (len(CarField),):
        raise InputError(
            f"the arrays have shapes {sorted(shapes)} and {grid.cars.shape}; allowed: (L, W, H + 1) four times, and "
            f"(n, {len(CarField)}) for the cars"
        )
    check_size(grid.size, grid.n_cars)
    _raise_fault(Grid(*(np.ascontiguousarray(getattr(grid, name)) for name in DTYPES)), _first_fault)


def derive_checked_marks(grid: Grid) -> None:
    """Overwrite both marks as :meth:`Grid.derive_marks` does, and do the same for what stands in all its arrays."""
    _raise_fault(grid, _marked_first_fault)


def _raise_fault(grid: Grid, first_fault: Callable[[World, NDArray[np.int64]], int]) -> None:
    place = np.empty(3, np.int64)
    fault = first_fault(World(grid.kind, grid.yaw, grid.top, grid.back, grid.cars, _NO_FLAGS), place)
    if fault != SOUND:
        raise InputError(_message(grid, fault, place.tolist()))


def _message(grid: Grid, fault: int, place: list[int]) -> str:
    x, y, z = place
    if fault < CAR_CELL:
        name = {KIND: "kind", LAYER: "kind", YAW: "yaw", TOP: "top", BACK: "back"}[fault]
        return (
            f"'{name}' of the cell {(x, y, z)} is {getattr(grid, name)[x, y, z]}; allowed: {_ALLOWED[fault]}"
        )
    row = grid.cars[x].tolist()
    if fault == CAR_CELL:
        return f"car {x} is at {tuple(row[:3])}, outside the map of size {grid.size}"
    field = {CAR_YAW: CarField.YAW, LOAD: CarField.LOAD, LOAD_YAW: CarField.LOAD_YAW, SLOPE: CarField.SLOPE}[
        fault
    ]
    return f"'{field.name.lower()}' of car {x} is {row[field]}; allowed: {_ALLOWED[fault]}"
