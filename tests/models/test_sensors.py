"""Sensors are as noisy and as late as declared, encoders count, motors lag; equal seeds give equal readings."""

import math
from dataclasses import fields, replace
from itertools import count

import numpy as np
import pytest

from craftsim.checking.setup import RANDOMIZE, Setup, set_up, setup_of
from craftsim.compiled.jit import plain
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kernel.rotation import arcsine
from craftsim.discrete.kinds import Action
from craftsim.mjcf.drives import DRIVES
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.measuring import CarMeasurement, Motors, write_reading
from craftsim.models.randomization import NONE
from craftsim.models.sensing import EXACT, SensorNoise, Sensors, measure
from craftsim.models.world import PhysicsWorld

NOISY = RANDOMIZE["strong"].sensors

PERIOD_S = 0.02
N = 1500
MEASURED = ("x", "y", "z", "heading", "pitch", "roll", "board_m", "board_force_n", "hinge_rad")

DEVIATIONS = np.array(
    [
        *[NOISY.position_m] * 3,
        *(NOISY.heading_rad, NOISY.tilt_rad, NOISY.tilt_rad),
        *(NOISY.board_m, NOISY.board_force_n, NOISY.hinge_rad),
    ]
)


@pytest.fixture(scope="module")
def docked() -> PhysicsWorld:
    """A car under a slope."""
    grid = Grid.empty((2, 1, 2), 1)
    grid.cars[0, :4] = 0, 0, 1, 0
    grid.kind[0, 0, 1], grid.yaw[0, 0, 1] = Kind.FSLOPE, 0
    grid.derive_marks()
    return PhysicsWorld(grid)


def _readings(physics, noise, seed, n=N) -> list[CarMeasurement]:
    sensors, found = Sensors(physics, noise, np.random.default_rng(seed)), []
    for _ in range(n):
        sensors.observe()
        found.append(sensors.measure(0))
    return found


def _columns(readings, names=MEASURED) -> np.ndarray:
    """Return numbers (n, len(names)); nan for a hinge that is not felt."""
    return np.array(
        [
            [math.nan if (value := getattr(now, name)) is None else value for name in names]
            for now in readings
        ]
    )


def test_readings_of_a_parked_car_are_as_noisy_as_declared_white_and_centred_on_the_truth(docked):
    errors = _columns(_readings(docked, NOISY, 3)) - _columns([measure(docked, 0)])
    errors = errors[np.isfinite(errors).all(axis=1)]
    # Of N white readings the deviation is known to 1 / sqrt(2 N) = 2 %, the mean to 1 / sqrt(N) = 3 % of it.
    np.testing.assert_allclose(errors.std(axis=0), DEVIATIONS, rtol=4 / math.sqrt(2 * N))
    assert (abs(errors.mean(axis=0)) < 4 * DEVIATIONS / math.sqrt(N)).all()
    # White: neither one reading after the other nor one number and another go together.
    scaled = errors / DEVIATIONS
    assert (abs((scaled[1:] * scaled[:-1]).mean(axis=0)) < 4 / math.sqrt(N)).all()
    assert (abs(np.corrcoef(scaled.T) - np.eye(9)) < 4 / math.sqrt(N)).all()


def test_a_plug_is_without_contact_in_the_declared_share_of_readings(docked):
    readings = _readings(docked, SensorNoise(undocked_share=0.2), 0)
    assert all((now.slope is None) == (now.hinge_rad is None) for now in readings)
    felt = np.mean([now.slope is not None for now in readings])
    assert felt == pytest.approx(0.8, abs=4 * math.sqrt(0.2 * 0.8 / N))


BIASED = {
    "heading": ("heading_bias_rad", 0.01),
    "pitch": ("tilt_bias_rad", 0.002),
    "roll": ("tilt_bias_rad", 0.002),
    "board_m": ("board_bias_m", 0.0001),
    "board_force_n": ("board_force_bias_n", 0.3),
    "hinge_rad": ("hinge_bias_rad", 0.001),
}


def test_a_bias_is_as_long_as_declared_on_every_seed_and_points_anywhere(docked):
    noise, true, ways = (
        SensorNoise(position_bias_m=0.005, **dict(BIASED.values())),
        measure(docked, 0),
        [],
    )
    for seed in range(200):
        now = Sensors(docked, noise, np.random.default_rng(seed)).measure(0)
        assert math.hypot(now.x - true.x, now.y - true.y) == pytest.approx(0.005, rel=1e-9)
        assert now.z == true.z
        off = [getattr(now, name) - getattr(true, name) for name in BIASED]
        np.testing.assert_allclose(np.abs(off), [size for _, size in BIASED.values()], rtol=1e-9)
        ways.append([*off, now.x - true.x, now.y - true.y])
    # Each side in half of the seeds, give or take four deviations.
    assert (abs((np.array(ways) > 0).mean(axis=0) - 0.5) < 4 * 0.5 / math.sqrt(200)).all()


def test_a_bias_drifts_as_far_as_declared_and_as_a_random_walk(docked):
    noise = SensorNoise(position_drift_m=0.001, heading_drift_rad=0.002)
    seconds = _columns(_readings(docked, noise, 1, 60 * 50)[::50])
    steps = np.diff(seconds[:, [0, 1, 3]], axis=0) / (0.001, 0.001, 0.002)
    np.testing.assert_allclose(steps.std(axis=0), 1.0, rtol=4 / math.sqrt(2 * len(steps)))
    assert (abs((steps[1:] * steps[:-1]).mean(axis=0)) < 4 / math.sqrt(len(steps))).all()
    assert not np.diff(seconds[:, 2]).any()


@pytest.fixture
def drive(docked, monkeypatch):
    """Return a function of noise, seed and n: readings of a car that drives at 1 m/s and turns at 0.5 rad/s."""

    def readings(noise, seed=0, n=600):
        still, periods = measure(docked, 0), count()

        def moving(_, out):
            t = next(periods) * PERIOD_S
            heading = math.remainder(3.0 + 0.5 * t, math.tau)
            wheels = (0.0 if t == 0 else 5.0,) * 4
            write_reading(
                still._replace(time_s=t, x=1.0 * t, heading=heading, wheel_speeds=wheels), out
            )

        with monkeypatch.context() as patch:
            patch.setattr("craftsim.models.sensing.exact_reader", lambda *_: moving)
            sensors, found = Sensors(docked, noise, np.random.default_rng(seed)), []
            for _ in range(n):
                sensors.observe()
                found.append(sensors.measure(0))
        return found

    return readings


def _ages(readings) -> tuple[np.ndarray, np.ndarray]:
    """Return the ages in seconds of what such a car reads of x, and whether each is fresh."""
    return np.array([now.time_s - now.x for now in readings]), np.array(
        [now.fresh for now in readings]
    )


def test_the_age_of_single_localisations_jitters_as_declared_and_none_is_of_the_future(drive):
    ages, fresh = _ages(drive(SensorNoise(min_delay_s=0.1, max_delay_s=0.1, jitter_s=0.01)))
    assert fresh.all()
    late = ages[20:]
    assert late.mean() == pytest.approx(0.1, abs=4 * 0.01 / math.sqrt(len(late)))
    assert late.std() == pytest.approx(0.01, rel=4 / math.sqrt(2 * len(late)))
    assert _ages(drive(SensorNoise(jitter_s=0.01)))[0].min() >= -1e-12


@pytest.mark.parametrize("period_s", [1 / 30, 0.05, 0.01])
def test_between_two_localisations_a_car_reads_the_last_one(drive, period_s):
    noise = SensorNoise(min_delay_s=0.03, max_delay_s=0.03, localisation_period_s=period_s)
    ages, fresh = _ages(drive(noise))
    # One that arrives between two control periods waits for the next.
    assert (
        0.03 - 1e-9
        <= ages[fresh][5:].min()
        <= ages[fresh][5:].max()
        < 0.03 + min(PERIOD_S, period_s)
    )
    assert fresh.sum() == pytest.approx(600 * min(PERIOD_S / period_s, 1.0), abs=2)
    np.testing.assert_allclose(np.diff(ages)[~fresh[1:]], PERIOD_S, atol=1e-9)


def test_of_the_localisations_the_declared_share_is_lost_and_the_car_reads_the_one_before(drive):
    ages, fresh = _ages(drive(SensorNoise(lost_share=0.2), n=N))
    assert (~fresh).mean() == pytest.approx(0.2, abs=4 * math.sqrt(0.2 * 0.8 / N))
    np.testing.assert_allclose(ages[fresh], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.diff(ages)[~fresh[1:]], PERIOD_S, atol=1e-9)


def test_of_the_localisations_the_declared_share_is_off_by_the_declared_length(docked):
    names = ("x", "y")
    found = _columns(_readings(docked, SensorNoise(outlier_share=0.1, outlier_m=0.3), 2), names)
    errors = found - _columns([measure(docked, 0)], names)
    off = np.hypot(*errors.T)
    wrong = off > 1e-9
    np.testing.assert_allclose(off[wrong], 0.3, rtol=1e-9)
    assert wrong.mean() == pytest.approx(0.1, abs=4 * math.sqrt(0.1 * 0.9 / N))
    assert (abs(errors[wrong].mean(axis=0)) < 4 * 0.3 / math.sqrt(2 * wrong.sum())).all()


def test_equal_seeds_give_equal_readings_and_a_new_figure_changes_none_that_it_does_not_concern(
    docked,
):
    first, again, other = (_columns(_readings(docked, NOISY, seed, 20)) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()
    more = replace(NOISY, outlier_share=0.1, lost_share=0.1, jitter_s=0.01, board_bias_m=0.001)
    changed = _columns(_readings(docked, more, 5, 20))
    np.testing.assert_array_equal(changed[:, [4, 5, 7]], first[:, [4, 5, 7]])


def test_silent_sensors_are_exact_and_noisy_ones_need_a_generator(docked):
    assert EXACT.silent
    for name in [f.name for f in fields(SensorNoise) if "delay" not in f.name]:
        assert SensorNoise(**{name: 0.01}).silent is (name == "motor_lag_s")
    sensors = Sensors(docked)
    sensors.observe()
    assert sensors.measure(0) == measure(docked, 0)
    with pytest.raises(ValueError, match="random generator"):
        Sensors(docked, NOISY)


@pytest.mark.parametrize("delay_s", [0.0, 0.02, 0.03, 0.037])
def test_a_localisation_is_as_old_as_declared(drive, delay_s):
    # Almost no noise, so that the delay shows alone; none at all and no delay would be silent.
    now = drive(SensorNoise(position_m=1e-12, min_delay_s=delay_s, max_delay_s=delay_s), n=59)[-1]
    t = now.time_s - delay_s
    assert now.x == pytest.approx(t, abs=1e-9)
    assert now.heading == pytest.approx(math.remainder(3.0 + 0.5 * t, math.tau), abs=1e-9)


def test_delays_are_drawn_between_their_bounds(drive):
    noise = replace(NOISY, position_m=0.0)
    ages = [_ages(drive(noise, seed, 7))[0][-1] for seed in range(40)]
    assert min(ages) >= NOISY.min_delay_s - 1e-9
    assert max(ages) <= NOISY.max_delay_s + 1e-9
    assert np.ptp(ages) > 0.7 * (NOISY.max_delay_s - NOISY.min_delay_s)


def test_wheel_speeds_follow_a_jump_with_the_declared_time_constant(drive):
    times = PERIOD_S * np.arange(1, 11)
    found = [now.wheel_speeds for now in drive(SensorNoise(encoder_lag_s=0.05), n=10)]
    np.testing.assert_allclose(
        found, np.tile(5.0 * (1 - np.exp(-times / 0.05)), (4, 1)).T, rtol=1e-12
    )


def test_a_file_gives_some_figures(tmp_path):
    (tmp_path / "late.yaml").write_text("{min_delay_s: 0.06, max_delay_s: 0.08}")
    read = setup_of("strong", noise=tmp_path / "late.yaml").randomization.sensors
    assert read == replace(NOISY, min_delay_s=0.06, max_delay_s=0.08)


STEP_RAD = 2 * math.pi / 4096
COUNTING = SensorNoise(encoder_step_rad=STEP_RAD)

WHEELS = {
    "forward": (8.0, 8.0, 8.0, 8.0),
    "left": (-8.0, 8.0, 8.0, -8.0),
    "turning": (-5.0, 5.0, -5.0, 5.0),
    "in an arc": (3.0, 9.0, 3.0, 9.0),
}

CAR = NOMINAL.cars[0]


def _counted(drive: str, wheels: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Drive a car for a second; return the readings of its speeds (50, 4), its way and its wheels' turning."""
    physics = PhysicsWorld(Grid.empty((5, 5, 1), 1), machines=replace(NOMINAL, drive=drive))
    sensors, car = Sensors(physics, COUNTING, np.random.default_rng(0)), physics.cars[0]
    joints = physics.model.jnt_qposadr[physics.model.dof_jntid[car.wheel_dofs]]
    speeds, turned = [], []
    for _ in range(51):
        turned.append(physics.data.qpos[joints].copy())
        physics.drive(0, wheels)
        physics.advance()
        sensors.observe()
        speeds.append(sensors.measure(0).wheel_speeds)
    return np.array(speeds[:-1]), np.array(turned)


@pytest.mark.parametrize("drive", DRIVES)
def test_the_counts_of_a_wheel_add_up_to_its_turning_within_one_count(drive):
    for wheels in WHEELS.values():
        speeds, turned = _counted(drive, wheels)
        counted = 0.02 * speeds.cumsum(axis=0)
        assert abs(counted - (turned[1:] - turned[0])).max() < STEP_RAD * (1 + 1e-9)
        counts = 0.02 * speeds / STEP_RAD
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
        assert np.unique(np.round(counts[25:])).size > 1


GRID = Grid.empty((3, 1, 1), 1)


def _told(motors, physics, command, periods):
    """Return the speeds that reach the servos."""
    told = []
    for _ in range(periods):
        motors.drive(0, command)
        told.append(physics.data.ctrl[physics.cars[0].wheel_actuators].copy())
    return np.array(told)


def test_a_commanded_speed_arrives_with_the_declared_time_constant_and_a_stop_at_once():
    physics = PhysicsWorld(GRID)
    motors = Motors(physics, 0.05)
    periods = np.arange(1, 11)[:, None]
    expected = 5.0 * (1 - np.exp(-periods * physics.config.control_period_s / 0.05))
    np.testing.assert_allclose(
        _told(motors, physics, (5.0,) * 4, 10), np.tile(expected, 4), rtol=1e-12
    )
    assert not _told(motors, physics, (0.0,) * 4, 1).any()


def test_a_setups_motor_lag_reaches_the_wheels():
    def way_m(lag_s):
        judge = set_up(
            GRID, Setup(randomization=replace(NONE, sensors=SensorNoise(motor_lag_s=lag_s)))
        )
        judge.executor.begin(0, Action.MOVE_RIGHT)
        for _ in range(8):
            judge.executor.advance()
        return judge.physics.data.qpos.item(judge.physics.cars[0].base.qpos)

    assert not math.isclose(way_m(0.0), way_m(0.1), abs_tol=1e-3)
    assert way_m(0.1) < way_m(0.0)


def test_what_is_no_number_is_measured_as_none(docked):
    """A clamp would make a nan a pitch of a quarter turn."""
    start = docked.data.qpos.copy()
    base = docked.cars[0].base.qpos
    try:
        docked.data.qpos[base + 3] = math.nan
        now = measure(docked, 0)
    finally:
        docked.data.qpos[:] = start
    assert all(map(math.isnan, (now.heading, now.pitch, now.roll)))
    assert all(map(math.isfinite, (measure(docked, 0).pitch, measure(docked, 0).roll)))


@pytest.mark.parametrize("compiled", [arcsine, plain(arcsine)])
def test_an_arcsine_ends_at_a_quarter_turn_and_lets_nan_pass(compiled):
    beyond = 1 + 1e-9
    assert [compiled(x) for x in (-beyond, -1.0, 0.0, 0.5, 1.0, beyond)] == [
        *(-math.pi / 2, -math.pi / 2, 0.0),
        *(math.asin(0.5), math.pi / 2, math.pi / 2),
    ]
    assert math.isnan(compiled(math.nan))
