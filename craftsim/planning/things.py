"""Worlds made of the things that stand in them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from craftsim.discrete.grid import Cell, Grid, Kind, Piece


def without_things(grid: Grid) -> Grid:
    """Return the world with nothing but ground and walls."""
    bare = Grid.empty(grid.size)
    bare.kind[grid.kind == Kind.WALL] = Kind.WALL
    return bare


def put(grid: Grid, things: Iterable[Piece]) -> None:
    """Put things into a world, in place."""
    for thing in things:
        grid.put(thing)


def take(grid: Grid, things: Iterable[Piece]) -> None:
    """Take things out of a world, in place."""
    for thing in things:
        grid.take(thing.cell)


def with_car(grid: Grid, cell: Cell, yaw: int, load: Kind = Kind.AIR) -> Grid:
    """Return the world with a single car; a slope that it carries has its low side behind it."""
    car = [*cell, yaw, load, (yaw + 2) % 4 if load == Kind.FSLOPE else 0, 0]
    return Grid(grid.cells, np.array([car], np.int16))
