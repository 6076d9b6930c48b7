"""Random buildings that cars can build, with starts for them, by a difficulty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from craftsim.designs.growth import MAX_LEVELS, PHYSICAL, Growth, Ramp
from craftsim.designs.starts import DesignStart, Stock, spread
from craftsim.discrete.files.design import Design
from craftsim.discrete.grid import Cell, Grid, Kind, beside
from craftsim.discrete.move_graph import UNREACHABLE, MoveGraph
from craftsim.errors import InputError
from craftsim.storage.limits import SHARE

_TRIES: Final = 12
"""At one size."""
_GROWTHS: Final = 10
"""Beginnings of a building until one comes to no dead end."""
_SIDE: Final = 8
"""Of the largest area."""
_COMPACT: Final = {1: 0.2, 2: 0.5, 3: 0.9}
"""How often a block goes where most blocks are, by the levels of the building: an upper ramp needs a platform."""
_KEPT: Final = 0.5
"""How often a ramp belongs to the design; the others serve for building alone."""


@dataclass(frozen=True)
class Size:
    """What a difficulty asks for."""

    area: Cell
    blocks: int
    levels: int
    ramps: int
    cars: int


@dataclass(frozen=True, eq=False)
class DrawnStart(DesignStart):
    """A random design with its start, and one order in which it can be built."""

    steps: tuple[Cell | Ramp, ...]
    """Blocks and ramps, those too that serve for building alone, in an order in which each can be put there."""
    ramps: int
    """How many of the ramps belong to the design."""


def size_of(difficulty: float, rng: np.random.Generator) -> Size:
    """Draw what a difficulty from 0 to 1 asks for: up to 8 x 8 x 3 cells, 16 blocks, 4 ramps and 6 cars."""
    SHARE.check("the difficulty", difficulty)

    def about(low: int, high: int, spread: float) -> int:
        middle = low + difficulty * (high - low)
        return int(np.clip(round(rng.uniform(middle - spread, middle + spread)), low, high))

    blocks = about(4, 16, 2.0)
    levels = about(1, 3, 0.6)
    if levels == 3 and blocks < _BLOCKS_OF_THREE_LEVELS:
        levels = 2
    ramps = int(np.clip(about(0, 4, 1.0), levels - 1, 4))
    while _cells(blocks, ramps) > _SHARE * _SIDE**2 and (ramps >= levels or blocks > _BLOCKS_OF_THREE_LEVELS):
        fewer_ramps = ramps >= levels and (blocks <= _BLOCKS_OF_THREE_LEVELS or rng.random() < 0.4)
        ramps, blocks = (ramps - 1, blocks) if fewer_ramps else (ramps, blocks - 1)
    sides = [
        (x, y)
        for x in range(6, _SIDE + 1)
        for y in range(6, _SIDE + 1)
        if _cells(blocks, ramps) <= _SHARE * x * y
    ]
    length, width = min(sides or [(_SIDE, _SIDE)], key=lambda side: (side[0] * side[1], rng.random()))
    return Size((length, width, MAX_LEVELS), blocks, levels, ramps, about(2, 6, 1.0))


def _cells(blocks: int, ramps: int) -> float:
    """Return about how many cells of the floor a building, and its things before, take."""
    return 1.8 * blocks + 5 * ramps


_SHARE: Final = 0.62
"""Of the floor that these take at most."""
_BLOCKS_OF_THREE_LEVELS: Final = 9
"""A landing, and what a ramp to it and a way around that take."""


def random_start(rng: np.random.Generator, difficulty: float = 0.5, n_cars: int | None = None) -> DrawnStart:
    """Draw a design that can be built, and a start to build it from.

    Each block and ramp is put where a car could bring it, in the order of ``steps``, and each upper level is reached by
    a ramp, of the design or a spare one. The things of the start lie beside the columns that the steps take.

    Args:
        rng: draws all.
        difficulty: 0 to 1, which sets area, blocks, levels, ramps and cars (:func:`size_of`).
        n_cars: number of cars, if it is to be another.

    Raises InputError for another difficulty, and for cars that have no room.
    """
    size = size_of(difficulty, rng)
    cars = size.cars if n_cars is None else n_cars
    if cars > _SIDE**2:
        raise InputError(f"{cars} cars have no room in a random design; allowed: fewer than {_SIDE**2}")
    while True:
        for _ in range(_TRIES):
            found = start_of(size, cars, rng)
            if found is not None:
                return found
        size = _easier(size, cars, rng)


def start_of(size: Size, n_cars: int, rng: np.random.Generator) -> DrawnStart | None:
    """Return a start of a size, or None where the building, or its things beside it, found no room."""
    growth = next(filter(None, (_grow(size, rng) for _ in range(_GROWTHS))), None)
    if growth is None:
        return None
    kept = [ramp for ramp in growth.ramps if rng.random() < _KEPT]
    blocks = [step for step in growth.steps if not isinstance(step, Ramp)]
    design = Design.of("random", blocks, kept)
    stock = Stock.of(design, n_cars, spare_slopes=len(growth.ramps) - len(kept))
    taken = {column for ramp in growth.ramps for column in ramp.columns[:2]}
    clear = {ramp.column(2) for ramp in growth.ramps if ramp.body[2] == 1}
    clear |= {(x, y) for x, y, z in growth.lanes if z == 1} | growth.approaches(rng)
    fits = (lambda grid: _slopes_get_there(growth.steps, grid)) if growth.ramps else None
    try:
        grid = spread(design, size.area, stock, rng, taken, clear, fits=fits)
    except InputError:
        return None
    return DrawnStart(grid, design, tuple(growth.steps), len(kept))


def _slopes_get_there(steps: Sequence[Cell | Ramp], grid: Grid) -> bool:
    """Return whether each slope of a start can be carried to each ramp, in the order of steps, past all else."""
    growth = Growth(np.zeros(grid.size[:2], np.int64), np.ones(grid.size[:2], np.bool_))
    floor, yaws = grid.kind[:, :, 1], grid.yaw[:, :, 1]
    slopes = [(x, y, int(yaws[x, y])) for x, y in np.argwhere(floor == Kind.FSLOPE).tolist()]
    for step in steps:
        if isinstance(step, Ramp):
            world = growth.world(floor != Kind.AIR)
            if not all(_gets_there(slope, step, world) for slope in slopes):
                return False
            growth.ramps.append(step)
        else:
            growth.heights[step[:2]] += 1
    return True


def _gets_there(slope: tuple[int, int, int], ramp: Ramp, world: Grid) -> bool:
    """Return whether a slope of the floor, an obstacle in a world, can be carried to where a ramp is to be."""
    x, y, yaw = slope
    rest = world.copy()
    rest.kind[x, y, 1] = rest.kind[beside((x, y, 1), yaw)] = Kind.AIR
    graph = MoveGraph(rest, PHYSICAL, Kind.FSLOPE)
    distances = graph.distances_from([graph.node((x, y, 1), (yaw + 2) % 4)])
    return bool(distances[graph.node(ramp.body, (ramp.yaw + 2) % 4)] < UNREACHABLE)


def _easier(size: Size, n_cars: int, rng: np.random.Generator) -> Size:
    """Return a size that has more room: a larger area, or where there is none, fewer ramps, or fewer blocks."""
    length, width, height = size.area
    if min(length, width) < _SIDE:
        length, width = (length + 1, width) if length < width else (length, width + 1)
        return replace(size, area=(length, width, height))
    if size.ramps >= size.levels and (size.blocks <= _BLOCKS_OF_THREE_LEVELS or rng.random() < 0.5):
        return replace(size, ramps=size.ramps - 1)
    if size.levels == 3 and size.blocks == _BLOCKS_OF_THREE_LEVELS:
        return replace(size, levels=2, ramps=1)
    if size.blocks > 1:
        return replace(size, blocks=size.blocks - 1)
    raise InputError(f"{n_cars} cars have no room in a random design of {size.area}; try fewer")


def _grow(size: Size, rng: np.random.Generator) -> Growth | None:
    """Return a building of a size, or None where it has come to a dead end."""
    growth = Growth.on(*size.area[:2], rng)
    spare = size.ramps - (size.levels - 1)
    for level, blocks in enumerate(_split(size, rng), start=1):
        if level > 1 and not growth.add_ramp(level - 1, rng, for_slopes=level < size.levels):
            return None
        # A second way up, where there is a slope for it.
        if level > 1 and spare and rng.random() < 0.5:
            spare -= growth.add_ramp(level - 1, rng)
        for _ in range(blocks):
            if not growth.add_block(level, rng, _COMPACT[size.levels]) and not (
                level == size.levels and growth.cap_landing(level, rng)
            ):
                return None
    for _ in range(spare):
        if not growth.add_ramp(1, rng):
            return None
    return growth


def _split(size: Size, rng: np.random.Generator) -> list[int]:
    """Return how many blocks each level has, more on the lower one."""
    upper = [1] * (size.levels - 1)
    most = size.blocks // 3 if size.levels == 2 else 1 + (size.blocks - _BLOCKS_OF_THREE_LEVELS) // 3
    if upper:
        upper[0] = int(rng.integers(1, max(1, most) + 1))
    if size.levels == 3:
        upper[0] += 1
    return [size.blocks - sum(upper), *upper]
