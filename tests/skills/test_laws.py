"""Kinematics, profiles, the lag of motors, the hold of parked cars, and driving on uneven floors."""

import math
from dataclasses import replace

import numpy as np
import pytest
from discrete.drawn import draw
from hypothesis import given, settings
from hypothesis import strategies as st

from craftsim.checking.setup import Seed, Setup, set_up, setup_of
from craftsim.compiled.jit import records
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.mjcf.machines import NOMINAL
from craftsim.mjcf.parameters import SmartcarParameters
from craftsim.models.config import SimulationConfig
from craftsim.models.floor import Floor
from craftsim.models.randomization import NONE
from craftsim.models.sensing import SensorNoise, measure, measurement_of
from craftsim.models.world import PhysicsWorld
from craftsim.skills.estimator import likeliest_delay, update_floor
from craftsim.skills.executor import Executor
from craftsim.skills.gains import careful, load_gains
from craftsim.skills.laws import LAG_STEP_S, Profile, compensate_lag, shake, step_task
from craftsim.skills.mecanum import Mecanum
from craftsim.skills.setup import SkillSetup, Terrain
from craftsim.skills.skill import begin_move
from craftsim.skills.state import CAR, DRIVE, DRIVE_TASK, GRAVITY, IDLE, RUNNING, constants_of

SMARTCAR = NOMINAL.cars[0]
MECANUM = Mecanum(SMARTCAR)
R = 0.0496
LEVER = 0.060 + 0.083


def test_every_twist_survives_the_way_through_the_wheels():
    twist = np.array([0.3, -0.2, 1.7])
    np.testing.assert_allclose(MECANUM.body_twist(MECANUM.wheel_speeds(twist)), twist, atol=1e-12)


def test_torques_do_the_work_of_the_wrench_and_are_the_smallest_that_do():
    wrench, twist = np.array([2.0, -3.0, 0.5]), np.array([0.3, -0.2, 1.7])
    assert np.dot(MECANUM.wheel_torques(wrench), MECANUM.wheel_speeds(twist)) == pytest.approx(
        wrench @ twist
    )
    matrix = np.array([MECANUM.wheel_speeds(axis) for axis in np.eye(3)])
    np.testing.assert_allclose(
        MECANUM.wheel_torques(wrench), np.linalg.lstsq(matrix, wrench)[0], rtol=1e-12
    )
    np.testing.assert_allclose(MECANUM.wrench(MECANUM.wheel_torques(wrench)), wrench, rtol=1e-12)


def test_the_wheels_turn_as_the_formula_says():
    for twist, rim_speeds in (
        ((1, 0, 0), (1, 1, 1, 1)),
        ((0, 1, 0), (-1, 1, 1, -1)),
        ((0, 0, 1), (-LEVER, LEVER, -LEVER, LEVER)),
        ((1, 1, 1), (-LEVER, 2 + LEVER, 2 - LEVER, LEVER)),
    ):
        np.testing.assert_allclose(
            MECANUM.wheel_speeds(twist), np.array(rim_speeds) / R, rtol=1e-12
        )


def test_smaller_wheels_turn_faster_and_a_wider_car_turns_its_wheels_further():
    other = Mecanum(SmartcarParameters(wheel_radius_m=0.0490, wheel_y_m=0.09))
    np.testing.assert_allclose(other.wheel_speeds((1, 0, 0)), np.ones(4) / 0.0490)
    np.testing.assert_allclose(
        other.wheel_speeds((0, 0, 1)), 0.15 / 0.0490 * np.array([-1, 1, -1, 1])
    )


def test_a_car_feels_by_its_motors_what_pushes_against_it_and_what_it_carries(make_site):
    free = measure(make_site((1, 1, 1), [(0, 0, 1, 0)]), 0)
    felt = MECANUM.felt_forces(free, (0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose([*felt.wheels_n, *felt.wrench, felt.board_n], 0.0, atol=0.05)
    physics = make_site((1, 1, 2), [(0, 0, 1, 0, Kind.BLOCK)])
    for _ in range(50):
        physics.advance()
    carried_n = MECANUM.felt_forces(measure(physics, 0), (0.0,) * 4).board_n
    # The screw's friction takes its share of the weight.
    assert abs(carried_n - NOMINAL.block.mass_kg * 9.81) < SMARTCAR.screw_friction_n
    # Held at a wall, while its wheels are commanded to turn: as much as the motors give, less what gears take.
    pushing = MECANUM.felt_forces(free._replace(wheel_speeds=(0.0,) * 4), (50.0,) * 4)
    most = 4 * (SMARTCAR.wheel_torque_nm - SMARTCAR.gear_friction_nm) / R
    np.testing.assert_allclose(pushing.wrench, (most, 0.0, 0.0), atol=0.05)


DISTANCES, LIMITS = st.floats(1e-4, 10.0), st.floats(0.01, 20.0)


@given(DISTANCES, LIMITS, LIMITS, st.floats(0.0, 1.0))
@settings(max_examples=60)
def test_it_goes_from_rest_to_rest_within_both_limits_and_uses_one_in_full(
    distance, speed, acceleration, part
):
    profile = Profile.within(distance, speed, acceleration)
    end, t = profile.duration_s, part * profile.duration_s
    assert profile.distance(0.0) == pytest.approx(0.0, abs=1e-9 * distance)
    assert profile.distance(end) == pytest.approx(distance, rel=1e-9)
    assert profile.distance(end + 5.0) == profile.distance(end)
    assert profile.motion(0.0) == profile.motion(end) == profile.motion(end + 5.0) == (0.0, 0.0)
    assert 0.0 <= profile.motion(t)[0] <= speed * (1 + 1e-12)
    assert abs(profile.motion(t)[1]) <= acceleration * (1 + 1e-9)
    assert profile.distance(part * t) <= profile.distance(t) + 1e-12 * distance, (
        "it never goes back"
    )
    # The second half mirrors the first.
    assert profile.distance(t) + profile.distance(end - t) == pytest.approx(distance, rel=1e-9)
    assert profile.motion(profile.ramp_s / 2)[1] == pytest.approx(acceleration, rel=1e-6)
    if end > 2 * profile.ramp_s * (1 + 1e-9):
        assert profile.motion(end / 2)[0] == pytest.approx(speed, rel=1e-9)


@given(DISTANCES, LIMITS, LIMITS, st.floats(0.01, 0.99))
@settings(max_examples=60)
def test_speed_is_the_derivative_of_distance_and_acceleration_that_of_speed(
    distance, speed, acceleration, part
):
    profile = Profile.within(distance, speed, acceleration)
    t, h = part * profile.duration_s, 1e-4 * profile.duration_s
    slope = (profile.distance(t + h) - profile.distance(t - h)) / (2 * h)
    assert slope == pytest.approx(profile.motion(t)[0], abs=1e-4 * profile.cruise_speed)
    curve = (profile.motion(t + h)[0] - profile.motion(t - h)[0]) / (2 * h)
    corners = (0.0, profile.ramp_s, profile.duration_s - profile.ramp_s, profile.duration_s)
    if min(abs(t - corner) for corner in corners) > h:
        steepest = 1.5 * profile.cruise_speed / profile.ramp_s
        assert curve == pytest.approx(profile.motion(t)[1], abs=1e-3 * steepest)


def test_no_distance_takes_no_time():
    profile = Profile.within(0.0, 1.0, 1.0)
    assert (profile.duration_s, profile.distance(1.0), profile.motion(1.0)) == (
        0.0,
        0.0,
        (0.0, 0.0),
    )


PERIOD_S = 0.02


def _car():
    """Return the record of a car that has not moved."""
    return Executor(PhysicsWorld(Grid.empty((1, 1, 1), 1)))._cars[0]


def _sent(car, wanted, turning, level=True):
    """Return what is commanded for wheels to have these speeds."""
    car["command"]["wheels"], car["now"]["wheel_speeds"] = wanted, turning
    compensate_lag(car, level)
    return car["command"]["wheels"].copy()


def _lag_s(car):
    return LAG_STEP_S * likeliest_delay(car["lag"]["mismatches"])[0]


def _turn(lag_s, n=60):
    """Let ideal motors of a lag follow a ramp; return the found lag and how far the wheels are behind at its end."""
    car, speeds = _car(), np.zeros(4)
    share = 1 - math.exp(-PERIOD_S / lag_s) if lag_s else 1.0
    for k in range(n):
        wanted = np.full(4, 0.2 * (k + 1))
        speeds += share * (_sent(car, wanted, speeds) - speeds)
    return _lag_s(car), float(wanted[0] - speeds[0])


@pytest.mark.parametrize("lag_s", [0.0, 0.015, 0.05, 0.08])
def test_wheels_keep_up_with_what_is_wanted_however_much_motors_lag(lag_s):
    found_s, behind = _turn(lag_s)
    assert found_s == pytest.approx(lag_s, abs=0.006)
    # Without compensation a ramp of 10 rad/s^2 would be behind by the lag.
    assert abs(behind) < 0.03


def test_wheels_are_never_commanded_faster_than_their_motors_turn():
    car = _car()
    fastest = car["known"]["car"]["wheel_speed_rad_s"]
    wanted = np.array([3.0, -3.0, 1.0, -1.0]) * fastest
    expected = [fastest, -fastest, fastest, -fastest]
    np.testing.assert_allclose(_sent(car, wanted, np.zeros(4), level=False), expected)


def test_wheels_that_lack_grip_are_not_taken_to_lag():
    car, speeds = _car(), np.zeros(4)
    for k in range(30):
        # Prompt motors, whose wheels speed up by no more than this.
        speeds += np.minimum(_sent(car, np.full(4, 0.8 * (k + 1)), speeds) - speeds, 0.4)
    assert _lag_s(car) < 0.025


def test_four_zeros_stop_at_once():
    car = _car()
    _sent(car, np.full(4, 3.0), np.zeros(4), level=False)
    assert not _sent(car, np.zeros(4), np.zeros(4), level=False).any()
    assert not car["lag"]["servos"].any()


@pytest.mark.parametrize("action", [Action.MOVE_RIGHT, Action.ROTATE_LEFT])
def test_a_car_whose_motors_lag_by_50_ms_does_as_predicted(action):
    grid = Grid.empty((3, 1, 1), 1)
    attempt = set_up(grid, setup_of("none", noise=SensorNoise(motor_lag_s=0.05))).perform(0, action)
    assert attempt.agrees, attempt


def _moved_m(grid: Grid, gear_friction: float, held: bool = True) -> float:
    """Return how far the first car moves in 6 s with its gears' friction scaled, with or without an executor."""
    physics = PhysicsWorld(grid, reset=False)
    smooth = physics.baseline.copy()
    smooth.dof_frictionloss[physics.cars[0].wheel_dofs] *= gear_friction
    physics.set_baseline(smooth)
    physics.reset()
    start, _ = physics.free_body_state(physics.cars[0].base)
    advance = Executor(physics).advance if held else physics.advance
    for _ in range(300):
        advance()
    end, _ = physics.free_body_state(physics.cars[0].base)
    return float(np.linalg.norm(end - start))


@pytest.mark.parametrize("place", [(2, 0, 1, 0, Kind.BLOCK, 0, 1), (1, 0, 2, 0, Kind.BLOCK, 0, 2)])
def test_a_loaded_car_with_smooth_gears_is_held_on_the_slope(place):
    grid = draw((3, 1, 3), [(Kind.BLOCK, (0, 0, 1)), (Kind.BODY, (1, 0, 1), 0)], [place])
    assert _moved_m(grid, 0.6) < 4e-4
    assert _moved_m(grid, 0.6, held=False) > 1.2e-3


def _pushed_m(way_m: float) -> list[float]:
    """Push a car on the slope by so much to its side, and return how far it is away in the 4 s after that."""
    grid = draw((3, 1, 2), [(Kind.BODY, (1, 0, 1), 0)], [(1, 0, 2, 0)])
    physics = PhysicsWorld(grid)
    executor, base = Executor(physics), physics.cars[0].base
    start, _ = physics.free_body_state(base)
    physics.data.qpos[base.qpos + 1] += way_m
    away = []
    for _ in range(200):
        executor.advance()
        away.append(float(np.linalg.norm(physics.free_body_state(base)[0] - start)))
    return away


def test_a_car_that_crept_without_turning_its_wheels_goes_back():
    away = _pushed_m(0.003)
    assert min(away[:20]) > 2e-3, "it is not sure yet"
    assert away[-1] < 6e-4


def test_a_car_that_crept_by_less_than_it_can_be_sure_of_stays():
    away = _pushed_m(0.0008)
    assert max(away) - min(away) < 2e-4


@pytest.mark.parametrize("seed", range(4))
def test_a_car_that_starts_on_the_slope_takes_the_noise_of_its_first_localisation_for_no_creep(
    seed,
):
    grid = draw((3, 1, 2), [(Kind.BODY, (1, 0, 1), 0)], [(1, 0, 2, 0)])
    noise = SensorNoise(position_m=0.001, heading_rad=0.003)
    judge = set_up(grid, setup_of("none", noise=noise, drive="wheels"), Seed((seed,)))
    base = judge.physics.cars[0].base
    start, _ = judge.physics.free_body_state(base)
    for _ in range(150):
        judge.executor.advance()
    assert np.linalg.norm(judge.physics.free_body_state(base)[0] - start) < 3e-4


def test_a_car_on_the_flat_is_left_alone():
    physics = PhysicsWorld(draw((1, 1, 2), cars=[(0, 0, 1, 0, Kind.BLOCK)]))
    executor = Executor(physics)
    for _ in range(50):
        executor.advance()
        assert not physics.data.ctrl.any()


GAINS = load_gains()
CAREFUL = careful(GAINS)
WHEELS = replace(NOMINAL, drive="wheels")
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
        machines=WHEELS,
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
    felt, move_s, whole_s = _durations(
        replace(NONE, sensors=SensorNoise(tilt_rad=tilt_rad)), "robust"
    )
    assert not felt
    assert whole_s - move_s < 0.5 * GAINS.uneven.tilt_time


def _loaded(gains, terrain, direction=0):
    """Return a loaded car that begins a move, and its hinge's angles."""
    setup = SkillSetup(NOMINAL.cars[0], NOMINAL, gains, PERIOD_S).on(terrain)
    cars = records(1, CAR)
    cars["known"] = setup.constants
    car, now = cars[0], cars[0]["now"]
    now["x"] = now["y"] = CELL_PITCH_M / 2
    now["board_m"], now["board_force_n"] = setup.machine.board_travel_m, 5 * GRAVITY
    begin_move(setup, measurement_of(now), car["task"], direction)
    return car, np.zeros(4)


def _drive(aslant_m, gains, terrain, seconds, direction=0):
    """Return how far the path of a loaded car gets that keeps so far beside it, and its commanded speeds (n,)."""
    car, angles = _loaded(gains, terrain, direction)
    now, drive, speeds = car["now"], car["task"]["drive"], []
    along, across = (0, 1) if direction == 0 else (1, 0)
    for _ in range(round(seconds / PERIOD_S)):
        place = drive["path"].copy()
        place[across] = CELL_PITCH_M / 2 + aslant_m
        now["x"], now["y"] = place[:2]
        step_task(car, angles)
        speeds.append(MECANUM.body_twist(car["command"]["wheels"])[along])
    return drive["path"][along] - CELL_PITCH_M / 2, np.array(speeds)


def _way_m(part, gains=CAREFUL, terrain=TIGHT, seconds=1.5):
    """Return how far the path gets of a car that keeps beside it by a part of what counts as astray."""
    return _drive(part * CAREFUL.drive.astray, gains, terrain, seconds)[0]


def test_the_path_of_a_load_past_something_waits_the_more_the_further_its_car_is_from_it():
    ways = [_way_m(part) for part in (0.0, 0.9, 1.5, 2.1)]
    assert ways[0] == ways[1] > ways[2] > ways[3]
    assert ways[3] < 1e-4, "it stands"


def test_a_load_past_something_moves_to_and_fro_where_its_path_waits_and_where_one_to_a_side_starts():
    def goes_back(part, direction=0):
        speeds = _drive(part * CAREFUL.drive.astray, CAREFUL, TIGHT, 0.8, direction)[1]
        return (speeds[5:] < 0).any()

    assert not goes_back(0.4)
    assert goes_back(1.8)
    assert goes_back(0.0, direction=1)


def test_on_an_uneven_floor_cars_go_to_a_side_slower():
    def top_m_s(gains, direction):
        return _loaded(gains, Terrain(), direction)[0]["task"]["drive"]["profile"]["cruise_speed"]

    assert top_m_s(CAREFUL, 1) == pytest.approx(0.35 * CAREFUL.drive.load_factor)
    assert top_m_s(CAREFUL, 0) == pytest.approx(CAREFUL.drive.max_speed * CAREFUL.drive.load_factor)
    assert top_m_s(GAINS, 1) == top_m_s(GAINS, 0)


def _corrected(behind_m, beside_m, gains, terrain=TIGHT, after_s=1.5):
    """Return the speeds (m/s), along and across its path, by which a loaded car corrects so large errors on its way."""
    twists = []
    for along, aside in ((0.0, 0.0), (behind_m, beside_m)):
        car, angles = _loaded(gains, terrain)
        for n in range(round(after_s / PERIOD_S) + 1):
            last = n * PERIOD_S >= after_s
            car["now"]["x"] = car["task"]["drive"]["path"][0] - along * last
            car["now"]["y"] = CELL_PITCH_M / 2 + aside * last
            step_task(car, angles)
        twists.append(MECANUM.body_twist(car["command"]["wheels"])[:2])
    return np.subtract(*twists[::-1])


def test_a_load_past_something_is_kept_to_its_path_firmly_and_along_it_slowly():
    gain = GAINS.drive.position_gain
    np.testing.assert_allclose(_corrected(0.0005, 0.0, CAREFUL), (0.0005 * gain, 0.0), atol=1e-4)
    np.testing.assert_allclose(_corrected(0.03, 0.0, CAREFUL), (0.02, 0.0), atol=1e-4)
    np.testing.assert_allclose(_corrected(-0.03, 0.0, CAREFUL), (-0.02, 0.0), atol=1e-4)
    np.testing.assert_allclose(_corrected(0.0, 0.0005, CAREFUL), (0.0, -0.0015 * gain), atol=1e-4)
    for gains, terrain in ((CAREFUL, Terrain()), (GAINS, TIGHT)):
        found = _corrected(0.005, 0.0005, gains, terrain, 0.6)
        np.testing.assert_allclose(found, (0.005 * gain, -0.0005 * gain), atol=1e-4)


def test_its_path_waits_for_a_car_that_does_not_follow():
    car, angles = _loaded(CAREFUL, TIGHT)
    for _ in range(round(2.0 / PERIOD_S)):
        step_task(car, angles)
    assert car["task"]["drive"]["path"][0] - CELL_PITCH_M / 2 < 0.009


def test_it_waits_neither_for_ever_nor_elsewhere_nor_on_a_slope_where_a_car_that_stands_slides():
    waited_s = CAREFUL.drive.settle_allowance
    assert _way_m(3, seconds=waited_s) == pytest.approx(0.0, abs=1e-4)
    assert _way_m(3, seconds=waited_s + 2.0) > 0.01
    for gains, terrain in (
        *((CAREFUL, Terrain()), (GAINS, TIGHT), (CAREFUL, Terrain(end_rad=-0.28, tight=True))),
    ):
        assert _way_m(3, gains, terrain) == _way_m(0, gains, terrain)


def _beside_m(gains):
    """Return (n, 2): how far the path of a load that has room to its left leads along and to the left."""
    car, angles = _loaded(gains, Terrain(tight=True, free_side=(0, 1)))
    ways = []
    while car["task"]["status"] == RUNNING:
        car["now"]["x"], car["now"]["y"] = car["task"]["drive"]["path"][:2]
        step_task(car, angles)
        ways.append(car["task"]["drive"]["path"][:2] - CELL_PITCH_M / 2)
    return np.array(ways)


def test_a_load_keeps_off_what_it_passes_where_its_floor_is_uneven_and_there_is_room():
    along, aside = _beside_m(CAREFUL).T
    amid = (along > 1e-6) & (along < CELL_PITCH_M - 1e-6)
    assert amid.sum() > 100
    np.testing.assert_allclose(aside[amid], 0.005, atol=1e-6)
    assert (along[-1], aside[-1]) == pytest.approx((CELL_PITCH_M, 0.0), abs=1e-6)
    assert not _beside_m(GAINS)[:, 1].any()


def test_a_car_that_is_shaken_forgets_how_it_arrived():
    car, angles = _loaded(CAREFUL, Terrain())
    drive, before = car["task"]["drive"], 0.0
    ends_s = drive["profile"]["duration_s"] + CAREFUL.drive.shake_after
    while car["task"]["elapsed_s"] <= ends_s:
        before = drive["integral"]["x"]
        car["now"]["x"] = drive["path"][0] + 0.002
        step_task(car, angles)
    assert before < -0.001
    step_task(car, angles)
    assert drive["integral"]["x"] == 0.0


def _shaken(times_s, gains=CAREFUL, error=(0.003, 0.004, 0.0)):
    """Return the velocities (n, 2) by which a car that lacks 5 mm is shaken so long after its path's end."""
    drive = records(1, DRIVE_TASK)
    drive[0]["ends_s"] = 2.0
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
    again = _shaken(after_s + np.array([4.0, 12.0, 400.0]) / gains.shake_rate + 1e-9)
    assert np.linalg.norm(again, axis=1) == pytest.approx(
        gains.shake_speed * np.array([1.5, 2.5, 3.0]), rel=1e-3
    )


def test_a_car_that_is_there_or_has_only_just_ended_its_path_or_feels_a_flat_floor_does_not_shake():
    after_s, near = CAREFUL.drive.shake_after, 0.9 * CAREFUL.drive.position_tolerance
    for error in ((0.0, 0.0, 0.0), (near, 0.0, 0.0)):
        assert not _shaken(after_s + np.linspace(0.01, 0.3, 20), error=error).any()
    assert not _shaken([0.0, after_s / 2, after_s]).any()
    for preset in ("robust", "fast"):
        gains = load_gains(preset)
        assert not _shaken(np.linspace(0, gains.drive.settle_allowance, 200), gains).any()
