"""On an uneven floor the path of a load past something waits for its car, where that goes astray."""

import math

import numpy as np

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.kernel.jit import records
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.sensing import measurement_of
from craftsim.skills.gains import Gains, careful, load_gains
from craftsim.skills.laws import step_task
from craftsim.skills.skill import SkillSetup, Terrain, begin_move
from craftsim.skills.state import CAR, GRAVITY

GAINS = load_gains()
PERIOD_S = 0.02
TIGHT = Terrain(tight=True)


def _drive(aslant_m: float, gains: Gains, terrain: Terrain, seconds: float) -> tuple[float, np.ndarray]:
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


def _way_m(aslant_m: float, gains: Gains = GAINS, terrain: Terrain = TIGHT, seconds: float = 1.5) -> float:
    return _drive(aslant_m, gains, terrain, seconds)[0]


def test_the_path_waits_the_more_the_further_its_car_is_from_it():
    band = careful(GAINS).drive.astray
    ways = [_way_m(part * band, careful(GAINS)) for part in (0.0, 0.9, 1.5, 2.1)]
    assert ways[0] == ways[1] > ways[2] > ways[3]
    assert ways[3] < 1e-4, "it stands"


def test_it_does_so_for_loads_past_something_and_on_uneven_floors_only():
    band = careful(GAINS).drive.astray
    assert _way_m(3 * band, careful(GAINS), Terrain()) == _way_m(0.0, careful(GAINS), Terrain())
    assert _way_m(3 * band) == _way_m(0.0)


def test_it_does_not_wait_for_ever():
    gains = careful(GAINS)
    waited_s = gains.drive.settle_allowance
    assert _way_m(3 * gains.drive.astray, gains, seconds=waited_s + 2.0) > 0.01
    assert math.isclose(_way_m(3 * gains.drive.astray, gains, seconds=waited_s), 0.0, abs_tol=1e-4)


def test_it_does_not_wait_on_a_slope_where_a_car_that_stands_slides():
    gains = careful(GAINS)
    sloping = Terrain(end_rad=-0.28, tight=True)
    aslant, straight = (_way_m(m, gains, terrain=sloping) for m in (3 * gains.drive.astray, 0.0))
    assert aslant == straight


def test_a_car_beside_its_path_drives_to_and_fro_along_it():
    gains = careful(GAINS)
    on_it, beside = (_drive(m * gains.drive.astray, gains, TIGHT, 0.6)[1] for m in (0.4, 1.0))
    assert (np.diff(on_it) > 0).all()
    assert (np.diff(beside) < 0).any()
