"""Noisy sensors are as noisy and as late as declared, and equal seeds give equal readings."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from craftsim.discrete.grid import Grid, Kind
from craftsim.errors import InputError
from craftsim.models.noise import EXACT, NOISY, SensorNoise
from craftsim.models.randomization_files import load_noise
from craftsim.models.sensing import Sensors, measure, write_reading
from craftsim.models.site import Site

PERIOD_S = 0.02
N = 1500


@pytest.fixture(scope="module")
def site() -> Site:
    grid = Grid.empty((2, 1, 1), 2)
    grid.cars[1, 0] = 1
    return Site(grid)


class Moving:
    """Makes exact readings of the first car functions of the number of the period."""

    def __init__(self, site, monkeypatch):
        self.period = 0
        still = measure(site, 0)

        def moving(_, __, out):
            t = self.period * PERIOD_S
            heading = math.remainder(3.0 + 0.5 * t, math.tau)
            wheels = (0.0 if t == 0 else 5.0,) * 4
            write_reading(still._replace(time_s=t, x=1.0 * t, heading=heading, wheel_speeds=wheels), out)

        monkeypatch.setattr("craftsim.models.sensing.read_cars", moving)


def _readings(site, noise, seed, n=N, car=0) -> np.ndarray:
    sensors = Sensors(site, noise, np.random.default_rng(seed))
    rows = []
    for _ in range(n):
        sensors.observe()
        now = sensors.measure(car)
        rows.append((now.x, now.y, now.z, now.heading))
    return np.array(rows)


def test_the_deviations_of_a_parked_cars_readings_are_as_declared_and_centred_on_the_truth(site):
    true = measure(site, 0)
    errors = _readings(site, NOISY, 3) - (true.x, true.y, true.z, true.heading)
    declared = np.array([NOISY.position_m] * 3 + [NOISY.heading_rad])
    # Of N white readings the deviation is known to 1 / sqrt(2 N) = 2 %, the mean to 1 / sqrt(N) = 3 % of it.
    np.testing.assert_allclose(errors.std(axis=0), declared, rtol=4 / math.sqrt(2 * N))
    assert (abs(errors.mean(axis=0)) < 4 * declared / math.sqrt(N)).all()
    # White: neither one reading after the other nor one coordinate and another go together.
    scaled = errors / declared
    assert (abs((scaled[1:] * scaled[:-1]).mean(axis=0)) < 4 / math.sqrt(N)).all()
    assert (abs(np.corrcoef(scaled.T) - np.eye(4)) < 4 / math.sqrt(N)).all()


JOINTS = ("pitch", "roll", "board_m", "board_force_n", "hinge_rad")
"""Readings of a docked car, in the order of their deviations."""


@pytest.fixture(scope="module")
def docked() -> Site:
    grid = Grid.empty((2, 1, 2), 1)
    grid.cars[0, :4] = 0, 0, 1, 0
    grid.kind[0, 0, 1], grid.yaw[0, 0, 1] = Kind.FSLOPE, 0
    grid.derive_marks()
    return Site(grid)


def test_tilt_board_and_hinge_are_as_noisy_as_declared_and_centred_on_the_truth(docked):
    sensors, true = Sensors(docked, NOISY, np.random.default_rng(3)), measure(docked, 0)
    rows = []
    for _ in range(N):
        sensors.observe()
        now = sensors.measure(0)
        rows.append([math.nan if now.slope is None else getattr(now, name) for name in JOINTS])
    errors = np.array(rows) - [getattr(true, name) for name in JOINTS]
    errors = errors[np.isfinite(errors[:, 0])]
    declared = np.array([NOISY.tilt_rad] * 2 + [NOISY.board_m, NOISY.board_force_n, NOISY.hinge_rad])
    np.testing.assert_allclose(errors.std(axis=0), declared, rtol=4 / math.sqrt(2 * N))
    assert (abs(errors.mean(axis=0)) < 4 * declared / math.sqrt(N)).all()
    assert (abs(np.corrcoef(errors.T) - np.eye(5)) < 4 / math.sqrt(N)).all()


def test_a_plug_is_without_contact_in_the_declared_share_of_readings(docked):
    sensors = Sensors(docked, SensorNoise(undocked_share=0.2), np.random.default_rng(0))
    felt = []
    for _ in range(N):
        sensors.observe()
        now = sensors.measure(0)
        assert (now.slope is None) == (now.hinge_rad is None)
        felt.append(now.slope is not None)
    assert np.mean(felt) == pytest.approx(0.8, abs=4 * math.sqrt(0.2 * 0.8 / N))


@pytest.mark.parametrize("name", [f.name for f in fields(SensorNoise) if "delay" not in f.name])
def test_no_noise_but_a_motors_lag_is_silent(name):
    assert SensorNoise(**{name: 0.01}).silent is (name == "motor_lag_s")


def test_two_cars_have_noise_of_their_own(site):
    sensors = Sensors(site, NOISY, np.random.default_rng(0))
    offsets = [sensors.measure(car).y - measure(site, car).y for car in (0, 1)]
    assert offsets[0] != offsets[1]


def test_equal_seeds_give_equal_readings_and_others_do_not(site):
    first, again, other = (_readings(site, NOISY, seed, 20) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()


def test_silent_sensors_are_exact_and_need_no_generator(site):
    assert EXACT.silent
    assert SensorNoise(motor_lag_s=0.02).silent
    sensors = Sensors(site)
    sensors.observe()
    now, true = sensors.measure(1), measure(site, 1)
    for name in ("x", "y", "z", "heading", "pitch", "roll", "board_m", "board_force_n"):
        assert getattr(now, name) == getattr(true, name)
    np.testing.assert_array_equal(now.wheel_speeds, true.wheel_speeds)
    assert now.position_std_m == now.heading_std_rad == 0.0


def test_noisy_sensors_without_a_generator_are_refused(site):
    with pytest.raises(ValueError, match="random generator"):
        Sensors(site, NOISY)


def test_asking_twice_in_one_period_gives_one_answer(site):
    sensors = Sensors(site, NOISY, np.random.default_rng(0))
    assert sensors.measure(0) == sensors.measure(0)


@pytest.mark.parametrize("delay_s", [0.0, 0.02, 0.03, 0.037])
def test_a_localisation_is_as_old_as_declared(site, monkeypatch, delay_s):
    moving = Moving(site, monkeypatch)
    # Almost no noise, so that the delay shows alone; none at all and no delay would be silent.
    noise = SensorNoise(position_m=1e-12, min_delay_s=delay_s, max_delay_s=delay_s)
    sensors = Sensors(site, noise, np.random.default_rng(0))
    for moving.period in range(1, 60):
        sensors.observe()
    now = sensors.measure(0)
    # At 1 m/s and 0.5 rad/s, past the jump of the heading at pi.
    t = moving.period * PERIOD_S - delay_s
    assert now.x == pytest.approx(t, abs=1e-9)
    assert now.heading == pytest.approx(math.remainder(3.0 + 0.5 * t, math.tau), abs=1e-9)


def test_delays_are_drawn_between_their_bounds(site, monkeypatch):
    ages = []
    for seed in range(40):
        moving = Moving(site, monkeypatch)
        sensors = Sensors(site, replace(NOISY, position_m=0.0), np.random.default_rng(seed))
        for moving.period in range(1, 8):
            sensors.observe()
        ages.append(moving.period * PERIOD_S - sensors.measure(0).x)
    assert min(ages) >= NOISY.min_delay_s - 1e-9
    assert max(ages) <= NOISY.max_delay_s + 1e-9
    assert max(ages) - min(ages) > 0.7 * (NOISY.max_delay_s - NOISY.min_delay_s)


def test_wheel_speeds_follow_a_jump_with_the_declared_time_constant(site, monkeypatch):
    moving = Moving(site, monkeypatch)
    sensors = Sensors(site, SensorNoise(encoder_lag_s=0.05), np.random.default_rng(0))
    for moving.period in range(1, 11):
        sensors.observe()
        expected = 5.0 * (1 - math.exp(-moving.period * PERIOD_S / 0.05))
        np.testing.assert_allclose(sensors.measure(0).wheel_speeds, expected, rtol=1e-12)


@pytest.mark.parametrize("name", [field.name for field in fields(SensorNoise)])
@pytest.mark.parametrize("value", [-1e-9, 1.0, math.nan, math.inf])
def test_a_figure_that_cannot_be_is_refused_by_its_name(name, value):
    with pytest.raises(InputError, match=f"SensorNoise.{name} must be"):
        SensorNoise(**{name: value})


def test_a_file_of_noise_gives_some_figures_and_leaves_the_others(tmp_path):
    (tmp_path / "late.yaml").write_text("{min_delay_s: 0.06, max_delay_s: 0.08}")
    assert load_noise(tmp_path / "late.yaml", NOISY) == replace(NOISY, min_delay_s=0.06, max_delay_s=0.08)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{min_delay: 0.1}", "min_delay_s"),
        ("{min_delay_s: 0.06}", "max_delay_s must not"),
        ("{heading_rad: x}", "number"),
    ],
)
def test_a_file_of_noise_that_says_what_it_should_not_is_refused_by_its_name(tmp_path, text, message):
    (tmp_path / "late.yaml").write_text(text)
    with pytest.raises(InputError, match=f"late.yaml.*{message}"):
        load_noise(tmp_path / "late.yaml", NOISY)


def test_a_greatest_delay_below_the_least_is_refused():
    with pytest.raises(InputError, match="max_delay_s must not be below min_delay_s"):
        SensorNoise(min_delay_s=0.03, max_delay_s=0.02)
