"""Cars feel whether their floor is uneven by how much they lean, and only then drive slowly, wait and shake."""

from dataclasses import replace

import numpy as np
import pytest

from craftsim.checking.setup import Seed, Setup, set_up
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import Grid
from craftsim.discrete.kernel.jit import records
from craftsim.discrete.kinds import Action
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.config import SimulationConfig
from craftsim.models.floor import Floor
from craftsim.models.randomization import NONE
from craftsim.models.sensing import SensorNoise, measurement_of
from craftsim.skills.estimator import update_floor
from craftsim.skills.gains import careful, load_gains
from craftsim.skills.laws import shake, step_task
from craftsim.skills.skill import SkillSetup, Terrain, begin_move
from craftsim.skills.state import CAR, DRIVE, DRIVE_TASK, GRAVITY, IDLE, constants_of

PERIOD_S = 0.02
GAINS = load_gains()
CAREFUL = careful(GAINS)
REDUCED = replace(NOMINAL, drive="reduced")
UNEVEN = replace(NONE, floor=Floor(lippage_m=0.003, tile_m=0.3))
TIGHT = Terrain(tight=True)


def _felt(pitches, sloping=False, law=IDLE):
    """Return what a car feels of its floor that has read these pitches."""
    cars = records(1, CAR)
    cars["known"] = constants_of(NOMINAL.cars[0], NOMINAL, GAINS, PERIOD_S)
    cars["task"]["law"], cars["task"]["drive"]["sloping"] = law, sloping
    for pitch in pitches:
        cars["now"]["pitch"] = pitch
        update_floor(cars[0])
    return cars[0]["floor"]


def test_readings_tell_an_uneven_floor_and_noise_never_does():
    tilt, noise = GAINS.uneven.tilt, np.random.default_rng(0).normal(0.0, 0.002, 7500)
    assert _felt([1.01 * tilt] * 5)["uneven"]
    assert _felt([1.01 * tilt] * 4)["suspected"]
    assert not _felt([0.99 * tilt] * 5)["uneven"]
    assert not _felt(noise)["uneven"]
    leaning = 0.003 + noise[:50]
    assert _felt(leaning)["uneven"], "within a second"
    assert _felt([*leaning, *noise[50:550]])["uneven"], "it is remembered"


def test_slopes_do_not_count():
    assert _felt([0.28] * 100)["n_read"] == 0
    assert _felt([0.01] * 100, sloping=True, law=DRIVE)["n_read"] == 0
    assert _felt([0.01] * 100, sloping=False, law=DRIVE)["uneven"]


def _durations(randomization, gains):
    """Return whether the floor is felt to be uneven, and how long a tight move takes, and all of it."""
    grid = Grid.empty((3, 2, 1), n_cars=2)
    grid.cars[:, :4] = (0, 0, 1, 0), (0, 1, 1, 0)
    setup = Setup(
        randomization=randomization,
        gains=load_gains(gains),
        machines=REDUCED,
        simulation=SimulationConfig(),
    )
    executor = set_up(grid, setup, Seed((1,))).executor
    begun = executor.physics.time_s
    outcome = executor.run({0: Action.MOVE_RIGHT}, {0: TIGHT})[0]
    return executor.floor_is_uneven, outcome.duration_s, executor.physics.time_s - begun


def test_only_on_an_uneven_floor_robust_gains_are_slow_and_there_from_the_first_move():
    assert _durations(NONE, "robust") == _durations(NONE, "fast")
    felt, slow_s, whole_s = _durations(UNEVEN, "robust")
    assert felt
    assert slow_s > 2 * _durations(UNEVEN, "fast")[1]
    assert whole_s - slow_s < GAINS.uneven.tilt_time


@pytest.mark.parametrize("tilt_rad", [0.001, 0.002])
def test_with_noisy_sensors_cars_rest_until_they_know_that_it_is_flat(tilt_rad):
    felt, move_s, whole_s = _durations(replace(NONE, sensors=SensorNoise(tilt_rad=tilt_rad)), "robust")
    assert not felt
    assert whole_s - move_s < 0.5 * GAINS.uneven.tilt_time


def _drive(aslant_m, gains, terrain, seconds):
    """Return how far the path of a loaded car gets that keeps so far beside it, and what its wheels are told (n,)."""
    setup = SkillSetup(NOMINAL.cars[0], NOMINAL, gains, PERIOD_S).on(terrain)
    car, angles = records(1, CAR), np.zeros((1, 4))
    car["known"] = setup.constants
    car, now = car[0], car[0]["now"]
    now["x"] = now["y"] = CELL_PITCH_M / 2
    now["board_m"], now["board_force_n"] = setup.machine.board_travel_m, 5 * GRAVITY
    begin_move(setup, measurement_of(now), car["task"], 0)
    speeds = []
    for _ in range(round(seconds / PERIOD_S)):
        now["x"], now["y"] = car["task"]["drive"]["path"][0], CELL_PITCH_M / 2 + aslant_m
        step_task(car, angles[0])
        speeds.append(car["command"]["wheels"].mean())
    return car["task"]["drive"]["path"][0] - CELL_PITCH_M / 2, np.array(speeds)


def _way_m(part, gains=CAREFUL, terrain=TIGHT, seconds=1.5):
    """Return how far the path gets of a car that keeps beside it by a part of what counts as astray."""
    return _drive(part * CAREFUL.drive.astray, gains, terrain, seconds)[0]


def test_the_path_of_a_load_past_something_waits_the_more_the_further_its_car_is_from_it():
    ways = [_way_m(part) for part in (0.0, 0.9, 1.5, 2.1)]
    assert ways[0] == ways[1] > ways[2] > ways[3]
    assert ways[3] < 1e-4, "it stands"
    on_it, beside = (_drive(m * CAREFUL.drive.astray, CAREFUL, TIGHT, 0.6)[1] for m in (0.4, 1.0))
    assert (np.diff(on_it) > 0).all()
    assert (np.diff(beside) < 0).any(), "it drives to and fro"


def test_it_waits_neither_for_ever_nor_elsewhere_nor_on_a_slope_where_a_car_that_stands_slides():
    waited_s = CAREFUL.drive.settle_allowance
    assert _way_m(3, seconds=waited_s) == pytest.approx(0.0, abs=1e-4)
    assert _way_m(3, seconds=waited_s + 2.0) > 0.01
    for gains, terrain in (
        *((CAREFUL, Terrain()), (GAINS, TIGHT), (CAREFUL, Terrain(end_rad=-0.28, tight=True))),
    ):
        assert _way_m(3, gains, terrain) == _way_m(0, gains, terrain)


def _shaken(times_s, gains=CAREFUL, error=(0.003, 0.004, 0.0)):
    """Return the velocities (n, 2) by which a car that lacks 5 mm is shaken so long after its profile's end."""
    drive = records(1, DRIVE_TASK)
    drive[0]["profile"]["duration_s"] = 2.0
    known = constants_of(NOMINAL.cars[0], NOMINAL, gains, PERIOD_S)
    return np.array([shake(drive[0], known[0]["drive"], error, 2.0 + t) for t in times_s])


def test_a_car_that_does_not_arrive_shakes_across_what_is_left_for_two_cycles_out_of_four():
    gains, after_s = CAREFUL.drive, CAREFUL.drive.shake_after
    found = _shaken(after_s + np.linspace(1e-6, 1.99 / gains.shake_rate, 400))
    assert abs(found @ (0.003, 0.004)).max() < 1e-12
    assert np.linalg.norm(found, axis=1).max() == pytest.approx(gains.shake_speed, rel=1e-3)
    ways = found @ (-0.8, 0.6)
    assert ways.min() == pytest.approx(-ways.max(), rel=1e-3), "to and fro"
    assert not _shaken(after_s + np.linspace(2.01, 3.99, 20) / gains.shake_rate).any()
    assert _shaken(after_s + np.linspace(4.05, 4.2, 5) / gains.shake_rate).any()


def test_a_car_that_is_there_or_has_only_just_ended_its_path_or_feels_a_flat_floor_does_not_shake():
    after_s, near = CAREFUL.drive.shake_after, 0.9 * CAREFUL.drive.position_tolerance
    for error in ((0.0, 0.0, 0.0), (near, 0.0, 0.0)):
        assert not _shaken(after_s + np.linspace(0.01, 0.3, 20), error=error).any()
    assert not _shaken([0.0, after_s / 2, after_s]).any()
    for preset in ("robust", "fast"):
        gains = load_gains(preset)
        assert not _shaken(np.linspace(0, gains.drive.settle_allowance, 200), gains).any()
