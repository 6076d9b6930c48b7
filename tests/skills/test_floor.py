"""Cars feel whether their floor is uneven by how much they lean, and only then drive slowly."""

from dataclasses import replace

import numpy as np
import pytest

from craftsim.checking.setup import Seed, Setup, set_up
from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel.jit import records
from craftsim.discrete.kinds import Action
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.config import SimulationConfig
from craftsim.models.floor import Floor
from craftsim.models.randomization import NONE
from craftsim.models.sensing import SensorNoise
from craftsim.skills.estimator import update_floor
from craftsim.skills.gains import load_gains
from craftsim.skills.skill import Terrain
from craftsim.skills.state import CAR, DRIVE, IDLE, constants_of

PERIOD_S = 0.02
GAINS = load_gains()
REDUCED = replace(NOMINAL, drive="reduced")
UNEVEN = replace(NONE, floor=Floor(lippage_m=0.003, tile_m=0.3))


def _felt(pitches, sloping=False, law=IDLE):
    """Return what a car feels of its floor that has read these pitches."""
    cars = records(1, CAR)
    cars["known"] = constants_of(NOMINAL.cars[0], NOMINAL, GAINS, PERIOD_S)
    cars["task"]["law"], cars["task"]["drive"]["sloping"] = law, sloping
    for pitch in pitches:
        cars["now"]["pitch"] = pitch
        update_floor(cars[0])
    return cars[0]["floor"]


def _noise(seconds, std=0.002):
    return np.random.default_rng(0).normal(0.0, std, round(seconds / PERIOD_S))


def test_with_exact_sensors_five_readings_tell():
    assert _felt([1.01 * GAINS.uneven.tilt] * 5)["uneven"]
    assert _felt([1.01 * GAINS.uneven.tilt] * 4)["suspected"]
    assert not _felt([0.99 * GAINS.uneven.tilt] * 5)["uneven"]


def test_noise_on_a_flat_floor_is_never_taken_for_an_uneven_one():
    assert not _felt(_noise(300.0))["uneven"]


def test_noisy_sensors_tell_within_a_second_and_remember():
    leaning = 0.003 + _noise(1.0)
    assert _felt(leaning)["uneven"]
    assert _felt([*leaning, *_noise(10.0)])["uneven"]


def test_slopes_do_not_count():
    assert _felt([0.28] * 100)["n_read"] == 0
    assert _felt([0.01] * 100, sloping=True, law=DRIVE)["n_read"] == 0
    assert _felt([0.01] * 100, sloping=False, law=DRIVE)["uneven"]


def _checked(randomization, gains):
    setup = Setup(
        randomization=randomization,
        gains=load_gains(gains),
        machines=REDUCED,
        simulation=SimulationConfig.of(REDUCED.drive),
    )
    grid = Grid.empty((3, 2, 1), n_cars=2)
    grid.cars[:, :4] = (0, 0, 1, 0), (0, 1, 1, 0)
    return set_up(grid, setup, Seed((1,)))


def _durations(randomization, gains):
    """Return whether the floor is felt to be uneven, and how long a tight move takes, and all of it."""
    executor = _checked(randomization, gains).executor
    begun = executor.physics.time_s
    outcome = executor.run({0: Action.MOVE_RIGHT}, {0: Terrain(tight=True)})[0]
    return executor.floor_is_uneven, outcome.duration_s, executor.physics.time_s - begun


def test_on_a_flat_floor_robust_gains_take_not_a_period_longer_than_fast_ones():
    assert _durations(NONE, "robust") == _durations(NONE, "fast")


def test_on_an_uneven_floor_the_first_tight_move_is_slow_already():
    felt, slow_s, whole_s = _durations(UNEVEN, "robust")
    assert felt
    assert slow_s > 2 * _durations(UNEVEN, "fast")[1]
    assert whole_s - slow_s < GAINS.uneven.tilt_time


@pytest.mark.parametrize("tilt_rad", [0.001, 0.002])
def test_with_noisy_sensors_cars_rest_until_they_know_that_it_is_flat(tilt_rad):
    felt, move_s, whole_s = _durations(replace(NONE, sensors=SensorNoise(tilt_rad=tilt_rad)), "robust")
    assert not felt
    assert whole_s - move_s < 0.5 * GAINS.uneven.tilt_time
