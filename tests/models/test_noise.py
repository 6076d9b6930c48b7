"""Noisy sensors are as noisy and as late as declared, and equal seeds give equal readings."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from craftsim.discrete.grid import Grid, Kind
from craftsim.errors import InputError
from craftsim.models.measuring import write_reading
from craftsim.models.randomization import load_noise
from craftsim.models.sensing import EXACT, NOISY, SensorNoise, Sensors, measure
from craftsim.models.world import PhysicsWorld

PERIOD_S = 0.02
N = 1500


@pytest.fixture(scope="module")
def physics() -> PhysicsWorld:
    grid = Grid.empty((2, 1, 1), 2)
    grid.cars[1, 0] = 1
    return PhysicsWorld(grid)


class Moving:
    """Makes exact readings of the first car functions of the number of the period."""

    def __init__(self, physics, monkeypatch):
        self.period = 0
        still = measure(physics, 0)

        def moving(_, out):
            t = self.period * PERIOD_S
            heading = math.remainder(3.0 + 0.5 * t, math.tau)
            wheels = (0.0 if t == 0 else 5.0,) * 4
            write_reading(still._replace(time_s=t, x=1.0 * t, heading=heading, wheel_speeds=wheels), out)

        monkeypatch.setattr("craftsim.models.measuring.Wiring.read", moving)


def _readings(physics, noise, seed, n=N, car=0) -> np.ndarray:
    sensors = Sensors(physics, noise, np.random.default_rng(seed))
    rows = []
    for _ in range(n):
        sensors.observe()
        now = sensors.measure(car)
        rows.append((now.x, now.y, now.z, now.heading))
    return np.array(rows)


def test_the_deviations_of_a_parked_cars_readings_are_as_declared_and_centred_on_the_truth(physics):
    true = measure(physics, 0)
    errors = _readings(physics, NOISY, 3) - (true.x, true.y, true.z, true.heading)
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
def docked() -> PhysicsWorld:
    grid = Grid.empty((2, 1, 2), 1)
    grid.cars[0, :4] = 0, 0, 1, 0
    grid.kind[0, 0, 1], grid.yaw[0, 0, 1] = Kind.FSLOPE, 0
    grid.derive_marks()
    return PhysicsWorld(grid)


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


def test_no_noise_but_a_motors_lag_is_silent():
    for name in [f.name for f in fields(SensorNoise) if "delay" not in f.name]:
        assert SensorNoise(**{name: 0.01}).silent is (name == "motor_lag_s")


BIASED = SensorNoise(
    position_bias_m=0.005,
    heading_bias_rad=0.01,
    tilt_bias_rad=0.002,
    board_bias_m=0.0001,
    board_force_bias_n=0.3,
    hinge_bias_rad=0.001,
)


def test_a_bias_is_as_long_as_declared_on_every_seed_and_points_anywhere(docked):
    true, ways = measure(docked, 0), []
    for seed in range(200):
        now = Sensors(docked, BIASED, np.random.default_rng(seed)).measure(0)
        assert math.hypot(now.x - true.x, now.y - true.y) == pytest.approx(0.005, rel=1e-9)
        assert now.z == true.z
        biased = {
            "heading": "heading_bias_rad",
            "pitch": "tilt_bias_rad",
            "roll": "tilt_bias_rad",
            "board_m": "board_bias_m",
            "board_force_n": "board_force_bias_n",
            "hinge_rad": "hinge_bias_rad",
        }
        off = {name: getattr(now, name) - getattr(true, name) for name in biased}
        for name, figure in biased.items():
            assert abs(off[name]) == pytest.approx(getattr(BIASED, figure), rel=1e-9)
        ways.append([*(np.sign(way) for way in off.values()), now.x > true.x, now.y > true.y])
    # Each side in half of the seeds, give or take four deviations.
    assert (abs((np.array(ways) > 0).mean(axis=0) - 0.5) < 4 * 0.5 / math.sqrt(200)).all()


def test_a_bias_drifts_as_far_as_declared_and_as_a_random_walk(physics):
    noise = SensorNoise(position_drift_m=0.001, heading_drift_rad=0.002)
    seconds = _readings(physics, noise, 1, 60 * 50)[::50]
    steps = np.diff(seconds[:, [0, 1, 3]], axis=0) / (0.001, 0.001, 0.002)
    np.testing.assert_allclose(steps.std(axis=0), 1.0, rtol=4 / math.sqrt(2 * len(steps)))
    assert (abs((steps[1:] * steps[:-1]).mean(axis=0)) < 4 / math.sqrt(len(steps))).all()
    assert not np.diff(seconds[:, 2]).any()


def _ages(physics, monkeypatch, noise, n=600, seed=0) -> tuple[np.ndarray, np.ndarray]:
    """Return the ages in seconds of what a car that drives at 1 m/s reads of x, and whether each is fresh."""
    moving = Moving(physics, monkeypatch)
    sensors = Sensors(physics, noise, np.random.default_rng(seed))
    seen = []
    for moving.period in range(1, n + 1):
        sensors.observe()
        now = sensors.measure(0)
        assert now.time_s == moving.period * PERIOD_S
        seen.append((now.time_s - now.x, now.fresh))
    ages, fresh = np.array(seen).T
    return ages, fresh > 0


def test_the_age_of_single_localisations_jitters_as_declared_and_none_is_of_the_future(physics, monkeypatch):
    ages, fresh = _ages(physics, monkeypatch, SensorNoise(min_delay_s=0.1, max_delay_s=0.1, jitter_s=0.01))
    assert fresh.all()
    late = ages[20:]
    assert late.mean() == pytest.approx(0.1, abs=4 * 0.01 / math.sqrt(len(late)))
    assert late.std() == pytest.approx(0.01, rel=4 / math.sqrt(2 * len(late)))
    assert _ages(physics, monkeypatch, SensorNoise(jitter_s=0.01))[0].min() >= -1e-12


@pytest.mark.parametrize("period_s", [1 / 30, 0.05, 0.01])
def test_between_two_localisations_a_car_reads_the_last_one(physics, monkeypatch, period_s):
    noise = SensorNoise(min_delay_s=0.03, max_delay_s=0.03, localisation_period_s=period_s)
    ages, fresh = _ages(physics, monkeypatch, noise)
    # One that arrives between two control periods waits for the next.
    assert 0.03 - 1e-9 <= ages[fresh][5:].min() <= ages[fresh][5:].max() < 0.03 + min(PERIOD_S, period_s)
    assert fresh.sum() == pytest.approx(600 * min(PERIOD_S / period_s, 1.0), abs=2)
    np.testing.assert_allclose(np.diff(ages)[~fresh[1:]], PERIOD_S, atol=1e-9)


def test_of_the_localisations_the_declared_share_is_lost_and_the_car_reads_the_one_before(
    physics, monkeypatch
):
    ages, fresh = _ages(physics, monkeypatch, SensorNoise(lost_share=0.2), N)
    assert (~fresh).mean() == pytest.approx(0.2, abs=4 * math.sqrt(0.2 * 0.8 / N))
    np.testing.assert_allclose(ages[fresh], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.diff(ages)[~fresh[1:]], PERIOD_S, atol=1e-9)


def test_of_the_localisations_the_declared_share_is_off_by_the_declared_length(physics):
    true = measure(physics, 0)
    errors = _readings(physics, SensorNoise(outlier_share=0.1, outlier_m=0.3), 2)[:, :2] - (true.x, true.y)
    off = np.hypot(*errors.T)
    wrong = off > 1e-9
    np.testing.assert_allclose(off[wrong], 0.3, rtol=1e-9)
    assert wrong.mean() == pytest.approx(0.1, abs=4 * math.sqrt(0.1 * 0.9 / N))
    assert (abs(errors[wrong].mean(axis=0)) < 4 * 0.3 / math.sqrt(2 * wrong.sum())).all()


def test_a_new_figure_changes_no_reading_that_it_does_not_concern(physics):
    more = replace(NOISY, outlier_share=0.1, lost_share=0.1, jitter_s=0.01, board_bias_m=0.001)
    both = [Sensors(physics, noise, np.random.default_rng(4)) for noise in (NOISY, more)]
    for _ in range(20):
        for sensors in both:
            sensors.observe()
        old, new = (sensors.measure(0) for sensors in both)
        assert (old.pitch, old.roll, old.board_force_n) == (new.pitch, new.roll, new.board_force_n)


def test_equal_seeds_give_equal_readings_and_others_do_not(physics):
    first, again, other = (_readings(physics, NOISY, seed, 20) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()


def test_silent_sensors_are_exact_and_need_no_generator(physics):
    assert EXACT.silent
    assert SensorNoise(motor_lag_s=0.02).silent
    sensors = Sensors(physics)
    sensors.observe()
    now, true = sensors.measure(1), measure(physics, 1)
    for name in ("x", "y", "z", "heading", "pitch", "roll", "board_m", "board_force_n"):
        assert getattr(now, name) == getattr(true, name)
    np.testing.assert_array_equal(now.wheel_speeds, true.wheel_speeds)
    assert now.position_std_m == now.heading_std_rad == 0.0
    assert now.fresh


def test_noisy_sensors_without_a_generator_are_refused(physics):
    with pytest.raises(ValueError, match="random generator"):
        Sensors(physics, NOISY)


@pytest.mark.parametrize("delay_s", [0.0, 0.02, 0.03, 0.037])
def test_a_localisation_is_as_old_as_declared(physics, monkeypatch, delay_s):
    moving = Moving(physics, monkeypatch)
    # Almost no noise, so that the delay shows alone; none at all and no delay would be silent.
    noise = SensorNoise(position_m=1e-12, min_delay_s=delay_s, max_delay_s=delay_s)
    sensors = Sensors(physics, noise, np.random.default_rng(0))
    for moving.period in range(1, 60):
        sensors.observe()
    now = sensors.measure(0)
    # At 1 m/s and 0.5 rad/s, past the jump of the heading at pi.
    t = moving.period * PERIOD_S - delay_s
    assert now.x == pytest.approx(t, abs=1e-9)
    assert now.heading == pytest.approx(math.remainder(3.0 + 0.5 * t, math.tau), abs=1e-9)


def test_delays_are_drawn_between_their_bounds(physics, monkeypatch):
    ages = []
    for seed in range(40):
        moving = Moving(physics, monkeypatch)
        sensors = Sensors(physics, replace(NOISY, position_m=0.0), np.random.default_rng(seed))
        for moving.period in range(1, 8):
            sensors.observe()
        ages.append(moving.period * PERIOD_S - sensors.measure(0).x)
    assert min(ages) >= NOISY.min_delay_s - 1e-9
    assert max(ages) <= NOISY.max_delay_s + 1e-9
    assert max(ages) - min(ages) > 0.7 * (NOISY.max_delay_s - NOISY.min_delay_s)


def test_wheel_speeds_follow_a_jump_with_the_declared_time_constant(physics, monkeypatch):
    moving = Moving(physics, monkeypatch)
    sensors = Sensors(physics, SensorNoise(encoder_lag_s=0.05), np.random.default_rng(0))
    for moving.period in range(1, 11):
        sensors.observe()
        expected = 5.0 * (1 - math.exp(-moving.period * PERIOD_S / 0.05))
        np.testing.assert_allclose(sensors.measure(0).wheel_speeds, expected, rtol=1e-12)


def test_a_figure_that_cannot_be_is_refused_by_its_name():
    for value in (-1e-9, 1.0, math.nan, math.inf):
        for name in [field.name for field in fields(SensorNoise)]:
            with pytest.raises(InputError, match=f"SensorNoise.{name}: .*at least 0 and below 1"):
                SensorNoise(**{name: value})


def test_a_file_of_noise_gives_some_figures_and_leaves_the_others(tmp_path):
    (tmp_path / "late.yaml").write_text("{min_delay_s: 0.06, max_delay_s: 0.08}")
    assert load_noise(tmp_path / "late.yaml", NOISY) == replace(NOISY, min_delay_s=0.06, max_delay_s=0.08)
