"""Hand-made worlds for tests of single rules."""

from collections.abc import Callable

import numpy as np
import pytest

from craftsim.discrete.grid import CarField, Grid, Kind, Piece

Scene = Callable[..., Grid]


def make_scene(objects=(), cars=(), size=(7, 7, 3), marks="derived") -> Grid:
    """Return a world: objects are (kind, cell[, yaw]), slopes with their second part; cars are dicts of CarField."""
    grid = Grid.empty(size, len(cars))
    for kind, cell, *yaw in objects:
        grid.put(Piece(kind, cell, *yaw))
    for row, car in zip(grid.cars, cars, strict=True):
        for name, value in car.items():
            row[CarField[name.upper()]] = value
    grid.derive_marks()
    return grid


def car_at(x, y, z=1, yaw=0, load=Kind.AIR, load_yaw=0, slope=0):
    """Return a car for make_scene; a carried slope points away behind it."""
    if load == Kind.FSLOPE:
        load_yaw = (yaw + 2) % 4
    return {"x": x, "y": y, "z": z, "yaw": yaw, "load": load, "load_yaw": load_yaw, "slope": slope}


def recorded_world(example) -> Grid:
    """Return the world of an example in tests/data: things are (x, y, z, kind, yaw), marks those that drifted."""
    grid = Grid.empty(example["size"], len(example["cars"]))
    for x, y, z, kind, yaw in example["things"]:
        grid.kind[x, y, z], grid.yaw[x, y, z] = kind, yaw
    grid.cars[:] = example["cars"]
    grid.derive_marks()
    for x, y, z, occupant, landing in example.get("marks", ()):
        grid.occupant[x, y, z], grid.landing[x, y, z] = occupant, landing
    return grid


@pytest.fixture
def scene():
    """The maker of hand-made worlds."""
    return make_scene


@pytest.fixture
def car():
    """The maker of cars for them."""
    return car_at


@pytest.fixture
def rng():
    """A generator with a fixed seed."""
    return np.random.default_rng(7)
