"""Driving a car of the simulation by a list of commands, and logging what it measures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from craftsim.checking.setup import Seed, Setup, set_up
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.logs.log import Floats, Log
from craftsim.logs.recorder import log_of
from craftsim.models.measuring import READING
from craftsim.skills.fleet import PhysicsFleet
from craftsim.skills.state import COMMAND
from craftsim.tuning.excitation import Area


def free_area(area: Area, loaded: bool = False) -> Grid:
    """Return a world of one car in the middle of a free area; ``loaded``: under a block behind it."""
    size = [2 * (math.ceil(side / 2 / CELL_PITCH_M) + 2) + 1 for side in (area.length_m, area.width_m)]
    grid = Grid.empty((size[0], size[1], 2), n_cars=1)
    x, y = size[0] // 2 - area.cells_behind * loaded, size[1] // 2
    grid.cars[0, CarField.X], grid.cars[0, CarField.Y] = x, y
    if loaded:
        grid.kind[x, y, 1] = Kind.BLOCK
    grid.derive_marks()
    return grid


def drive(grid: Grid, setup: Setup, seed: Seed, commands: Floats) -> Log:
    """Return the log of the first car of a world that is driven by commands, (n, 6) as of a log.

    Nothing sleeps in it: a car that MuJoCo has to wake takes a moment that no real one takes.
    """
    setup = replace(setup, simulation=replace(setup.simulation, sleep=False))
    executor = set_up(grid, setup, seed, watch_contacts=False).executor
    physics, fleet = executor.physics, executor.fleet
    assert isinstance(fleet, PhysicsFleet)
    sensors, motors = fleet.sensors, fleet.motors
    readings, told = np.zeros(len(commands), READING), np.zeros(len(commands), COMMAND)
    time = np.zeros(len(commands))
    for row, command in enumerate(commands):
        readings[row], time[row] = sensors.read()[0], physics.time_s
        wheels, board = tuple(command[:4].tolist()), float(command[4])
        told[row] = (wheels, board, 0.0)
        motors.drive(0, wheels)
        physics.move_board(0, board)
        physics.advance()
        sensors.observe()
    log = log_of(time, readings, told)
    return replace(log, time_s=log.time_s - log.time_s[0])
