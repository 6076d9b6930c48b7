"""A car believes to be where it is, as surely as it says, from slipping wheels and noisy, late localisations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from craftsim.checking.setup import RANDOMIZE, Seed, set_up, setup_of
from craftsim.compiled.jit import records
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.mjcf.machines import NOMINAL, Machines
from craftsim.models.measuring import READING, write_reading
from craftsim.models.sensing import (
    ASSUMED,
    EXACT,
    CarMeasurement,
    SensorNoise,
    Sensors,
    measure,
    measurement_of,
)
from craftsim.models.world import PhysicsWorld
from craftsim.skills.estimator import PoseEstimator
from craftsim.skills.executor import Executor
from craftsim.skills.gains import load_gains
from craftsim.skills.laws import Profile
from craftsim.skills.mecanum import Mecanum

NOISY = RANDOMIZE["strong"].sensors

PERIOD_S = 0.02
KINEMATICS = Mecanum(NOMINAL.cars[0])
LATE = SensorNoise(position_m=0.001, heading_rad=0.003, min_delay_s=0.03, max_delay_s=0.03)
STILL = CarMeasurement(0.0, 0, 0, 0.0, 0, 0.0, 0.0, np.zeros(4), 0.0, 0.0, None, None)
DRIVE = np.array([1.0, 0.0, 0.0]), Profile.within(0.3225, 0.8, 3.0)
SIDEWAYS = np.array([0.0, 1.0, 0.0]), Profile.within(0.3225, 0.8, 3.0)
TURN = np.array([0.0, 0.0, 1.0]), Profile.within(math.pi / 2, 5.0, 22.0)


def _estimator(noise: SensorNoise) -> PoseEstimator:
    return PoseEstimator(noise, PERIOD_S, NOMINAL.cars, load_gains().localisation, (3, 3, 2))


def _update(estimator: PoseEstimator, now: CarMeasurement) -> CarMeasurement:
    """Feed one measurement to an estimator, and return the view."""
    reading = records(1, READING)
    write_reading(now, reading)
    return measurement_of(estimator.update(reading)[0])


def _truth(direction, profile, rest_s, heading=0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return poses (n, 3) at the period's ends and body twists (n, 3) over the periods before them."""
    times = np.arange(0, profile.duration_s + rest_s, PERIOD_S)
    way = np.array([profile.distance(float(t)) for t in times])
    c, s = math.cos(heading), math.sin(heading)
    world = np.array(
        [c * direction[0] - s * direction[1], s * direction[0] + c * direction[1], direction[2]]
    )
    twists = np.outer(np.diff(way, prepend=0.0) / PERIOD_S, direction)
    return np.array([0.5, 0.5, heading]) + np.outer(way, world), twists


def _feed(noise, poses, twists, n, slip=0.02):
    """Feed a synthetic motion to n cars; return their errors (n, t, 3) and standard deviations (n, t, 3).

    Wheels that slip turn more than a car moves.
    """
    estimator = PoseEstimator(
        noise, PERIOD_S, NOMINAL.cars * n, load_gains().localisation, (3, 3, 2)
    )
    rngs, times = [np.random.default_rng(car) for car in range(n)], np.arange(len(poses))
    late = np.array([rng.uniform(noise.min_delay_s, noise.max_delay_s) for rng in rngs]) / PERIOD_S
    sigma = np.array([noise.position_m, noise.position_m, noise.heading_rad])
    readings, errors, stds = records(n, READING), [], []
    for k in range(n):
        write_reading(STILL, readings[k : k + 1])
    for i, (pose, twist) in enumerate(zip(poses, twists, strict=True)):
        located = np.stack([np.interp(i - late, times, poses[:, k]) for k in range(3)], axis=1)
        located += sigma * [rng.normal(size=3) for rng in rngs]
        readings["x"], readings["y"] = located[:, 0], located[:, 1]
        readings["heading"] = np.remainder(located[:, 2] + math.pi, math.tau) - math.pi
        readings["wheel_speeds"] = KINEMATICS.wheel_speeds((1 + slip) * twist)
        views = estimator.update(readings)
        error = np.stack([views[name] for name in ("x", "y", "heading")], axis=1) - pose
        error[:, 2] = np.remainder(error[:, 2] + math.pi, math.tau) - math.pi
        errors.append(error)
        place = views["position_std_m"]
        stds.append(np.stack([place, place, views["heading_std_rad"]], axis=1))
    return np.stack(errors, axis=1), np.stack(stds, axis=1)


@pytest.mark.parametrize(("motion", "heading"), [(DRIVE, 0.0), (SIDEWAYS, 3.0), (TURN, 3.0)])
def test_after_a_motion_with_slip_the_estimate_is_off_by_few_of_its_own_deviations(motion, heading):
    errors, stds = _feed(LATE, *_truth(*motion, rest_s=0.3, heading=heading), 60)
    scaled = errors[:, -1] / stds[:, -1]
    assert np.abs(scaled).max() < 4.0
    assert np.sqrt(np.square(scaled).mean(axis=0)).max() < 1.6


def test_while_it_moves_the_estimate_is_much_better_than_late_localisations_are():
    poses, twists = _truth(*DRIVE, rest_s=0.0)
    assert np.linalg.norm(twists, axis=1).max() * LATE.max_delay_s > 0.015
    assert np.abs(_feed(LATE, poses, twists, 30)[0][..., 0]).max() < 0.006


def test_at_rest_errors_fall_as_declared_and_what_a_car_says_of_its_own_covers_the_truth():
    errors, stds = _feed(NOISY, np.tile([0.5, 0.5, 1.0], (200, 1)), np.zeros((200, 3)), 200)
    declared = np.array([NOISY.position_m, NOISY.position_m, NOISY.heading_rad])
    for n in (1, 4, 16):
        # As one over the root of the number of localisations. Of 200 cars the deviation is known to 5 %; the filter's
        # own unrest adds a little.
        found = np.sqrt(np.square(errors[:, n - 1]).mean(axis=0))
        np.testing.assert_allclose(found, declared / math.sqrt(n), rtol=0.16)
        np.testing.assert_allclose(stds[0, n - 1], declared / math.sqrt(n), rtol=0.06)
    for n in (5, 40, 200):
        covered = (np.abs(errors[:, n - 1]) < 1.96 * stds[:, n - 1]).mean(axis=0)
        # 95 %, give or take three deviations of a share of 200. Overcaution would show as more than 99 %.
        assert covered.min() > 0.95 - 3 * math.sqrt(0.95 * 0.05 / 200)
        assert covered.min() <= 0.995


def test_a_car_that_rests_for_long_never_gets_overconfident():
    _, (stds,) = _feed(NOISY, np.tile([0.5, 0.5, 1.0], (3000, 1)), np.zeros((3000, 3)), 1)
    assert stds[-1, 0] > 5e-5
    assert stds[-1, 2] > 1e-4
    # But for how much noise it finds, it gets surer all the time.
    assert np.diff(stds[:, 0]).max() < 0.01 * stds[-1, 0]


def test_slip_to_the_side_that_is_expected_is_found_while_it_lasts():
    errors = []
    for share in (0.0, 0.5):
        estimator, speed, at = _estimator(LATE), 0.04, np.array([0.5, 0.5])
        estimator.expect_loose(share)
        past, offs, rng = [at] * 3, [], np.random.default_rng(3)
        for k in range(100):
            # It stands for a second, and then goes aslant, while all wheels turn as they do on a straight way.
            rolls = k >= 50
            at = at + rolls * PERIOD_S * speed * np.array([0.5, -0.5])
            past.append(at)
            x, y = past[-3] + rng.normal(0.0, LATE.position_m, 2)
            wheels = KINEMATICS.wheel_speeds((rolls * speed, 0.0, 0.0))
            now = _update(estimator, STILL._replace(x=x, y=y, wheel_speeds=np.array(wheels)))
            offs.append(abs(now.y - at[1]))
        errors.append(np.mean(offs[70:]))
    assert errors[1] < 0.7 * errors[0]


def _yard() -> Grid:
    grid = Grid.empty((3, 3, 2), 1)
    grid.cars[0, :4] = 0, 1, 1, 0
    grid.kind[1, 1, 1] = Kind.BLOCK
    grid.derive_marks()
    return grid


def test_skills_see_the_truth_of_exact_sensors_and_the_estimate_of_noisy_ones():
    physics = PhysicsWorld(_yard())
    noisy = Sensors(physics, NOISY, np.random.default_rng(0))
    exact, estimated = Executor(physics), Executor(physics, sensors=noisy, assumed=NOISY)
    true = measure(physics, 0)
    assert measurement_of(exact.readings()[0]) == true
    view = measurement_of(estimated.readings()[0])
    assert view.x != true.x
    assert view.position_std_m > 0.0


def _parameters(executor: Executor) -> list:
    """Return all that the estimates of an executor know before they have measured anything, to the last bit."""
    if executor._estimator is None:
        return []
    estimates, delays = executor._estimator._estimates, executor._estimator._delays
    names = ("noise", "drifts", "delay", "delay_std", "jitter", "slip", "marker")
    return [a.tobytes() for a in (delays, *(estimates[name] for name in names))]


@pytest.mark.parametrize(
    "world", [EXACT, SensorNoise(0.005, 0.02, min_delay_s=0.06, max_delay_s=0.08)]
)
def test_the_estimate_is_made_from_what_cars_assume_and_not_from_the_noise_of_the_world(world):
    told = _parameters(set_up(_yard(), setup_of("none")).executor)
    assert told
    assert _parameters(set_up(_yard(), setup_of("strong")).executor) == told
    assert _parameters(set_up(_yard(), setup_of("strong", noise=world)).executor) == told
    assert _parameters(set_up(_yard(), setup_of("strong", assume="mild")).executor) != told
    assert not _parameters(set_up(_yard(), setup_of("strong", noise=world, assume="none")).executor)


def test_cars_that_take_each_pose_as_it_is_fail_with_late_ones_and_those_that_find_out_do_not():
    late = SensorNoise(min_delay_s=0.1, max_delay_s=0.1)

    def moves(**options):
        return (
            set_up(_yard(), setup_of("none", noise=late, **options))
            .perform(0, Action.MOVE_RIGHT)
            .agrees
        )

    assert not moves(assume="none")
    assert moves()


@pytest.mark.parametrize("delay_s", [0.0, 0.17])
def test_a_car_that_has_moved_knows_how_late_its_localisations_are(delay_s):
    world = SensorNoise(0.001, 0.003, min_delay_s=delay_s, max_delay_s=delay_s)
    judge = set_up(_yard(), setup_of("none", noise=world))
    estimate = judge.executor._estimator._estimates[0]
    before_s = PERIOD_S * estimate["delay_std"]
    judge.perform(0, Action.MOVE_RIGHT)
    assert before_s > 0.04
    # Wheels are read at the end of a period over which the speed is taken to be the same: half of it.
    assert PERIOD_S * estimate["delay"] == pytest.approx(delay_s, abs=0.012)
    assert PERIOD_S * estimate["delay_std"] < 0.006


@pytest.mark.parametrize(
    "noise", [(0.0, 0.0), (0.003, 0.01)], ids=["exact", "three times as noisy"]
)
def test_at_rest_a_car_finds_out_how_noisy_its_localisations_are(noise):
    estimator, rng = _estimator(SensorNoise(0.001, 0.003)), np.random.default_rng(0)
    for _ in range(400):
        x, y, heading = rng.normal(size=3) * (noise[0], noise[0], noise[1])
        view = _update(estimator, STILL._replace(x=x, y=y, heading=heading))
    found = np.sqrt(estimator._estimates[0]["noise"])
    np.testing.assert_allclose(found, (noise[0], noise[0], noise[1]), rtol=0.15, atol=0.0005)
    assert (view.position_std_m < 0.0001) is (noise[0] == 0.0)


def test_a_wrong_localisation_moves_a_sure_car_by_less_than_the_noise():
    estimator = _estimator(SensorNoise(0.001, 0.003))
    for _ in range(50):
        _update(estimator, STILL)
    view = _update(estimator, STILL._replace(x=0.3))
    assert abs(view.x) < 0.001


def test_a_reading_that_is_not_fresh_says_nothing_new():
    estimator = _estimator(SensorNoise(0.001, 0.003))
    sure = [_update(estimator, STILL._replace(fresh=k == 0)).position_std_m for k in range(20)]
    assert sure[-1] >= sure[0]


BIASED = SensorNoise(position_bias_m=0.005, heading_bias_rad=0.01)


def test_below_a_block_a_car_learns_the_bias_of_its_localisation_and_keeps_it():
    judge = set_up(_yard(), setup_of("none", noise=BIASED), Seed((0,)))
    first, second = (judge.perform(0, action) for action in (Action.MOVE_RIGHT, Action.MOVE_RIGHT))
    assert first.agrees
    assert second.agrees
    # Below the block, and then beside it, where nothing is seen.
    assert first.car_error_m < 0.0005
    assert first.heading_error_rad < 0.002
    assert second.car_error_m < 0.001
    assert second.heading_error_rad < 0.003


MIDDLE_M = CELL_PITCH_M / 2
AT_REST = STILL._replace(x=MIDDLE_M, y=MIDDLE_M)
NONE_SEEN = (math.inf,) * 4


def _look(estimator: PoseEstimator, beside_m: float, n: int, **now) -> CarMeasurement:
    """Look so long from below at a cross that is beside its cell's middle, to the car's left."""
    for _ in range(n):
        view = _update(estimator, AT_REST._replace(lines=(beside_m, beside_m, 0.0, 0.0), **now))
    return view


def test_however_long_a_car_looks_at_one_cross_the_next_one_says_as_much():
    estimator = _estimator(ASSUMED)
    first = _look(estimator, 0.006, 500)
    # The car takes the cross for the middle, and what its localisations say instead for their bias.
    assert first.y - MIDDLE_M == pytest.approx(-0.006, abs=3e-4)
    _update(estimator, AT_REST._replace(lines=NONE_SEEN))
    second = _look(estimator, 0.004, 50)
    assert second.y - MIDDLE_M == pytest.approx(-0.005, abs=2e-4)
    assert math.sqrt(estimator._estimates[0]["known"]["covariance"][1, 1]) > 5e-4


def test_a_cross_that_is_about_as_far_aside_as_crosses_are_does_not_move_a_car_that_is_localised_elsewhere():
    estimator = _estimator(ASSUMED)
    for beside_m in (0.001, -0.0005, 0.0008, 0.001):
        view = _look(estimator, beside_m, 100)
        assert abs(view.y - MIDDLE_M) < 1.5e-4
        _update(estimator, AT_REST._replace(lines=NONE_SEEN))


def _errors_m(
    n: int, bias_m: float, crosses: int, placement_m: float, noise_m: float = 0.0
) -> np.ndarray:
    """Return how far off along y n cars are that look at so many crosses, each so far (std) beside its place.

    Their localisations have a bias of this length in a random direction.
    """
    rng, errors = np.random.default_rng(0), []
    for _ in range(n):
        estimator, towards = _estimator(ASSUMED), rng.uniform(0, math.tau)
        x, y = MIDDLE_M + bias_m * math.cos(towards), MIDDLE_M + bias_m * math.sin(towards)
        for _ in range(crosses):
            aside, ahead = rng.normal(0.0, placement_m, 2)
            for _ in range(40):
                at_x, at_y = rng.normal((x, y), noise_m)
                view = _update(
                    estimator, STILL._replace(x=at_x, y=at_y, lines=(aside, aside, ahead, ahead))
                )
            _update(estimator, STILL._replace(x=x, y=y, lines=NONE_SEEN))
        errors.append(view.y - MIDDLE_M)
    return np.array(errors)


@pytest.mark.parametrize(
    ("bias_m", "crosses", "least_m", "most_m"),
    [
        (0.0, 1, 0.0, 0.0005),
        (0.0, 4, 0.0, 0.00025),
        # Nothing but the crosses tells where the car is: their mean is as good as it gets.
        (0.005, 1, 0.0008, 0.0012),
        (0.005, 4, 0.0004, 0.0006),
        # A small bias is hard to tell from crosses that stand aside; it does no more harm than its own length.
        (0.001, 1, 0.0, 0.0011),
    ],
)
def test_a_car_finds_out_whether_its_localisations_have_a_bias_at_all(
    bias_m, crosses, least_m, most_m
):
    placement_m = load_gains().localisation.placement
    assert least_m <= math.sqrt(np.mean(_errors_m(60, bias_m, crosses, placement_m) ** 2)) < most_m


@pytest.mark.parametrize("noise_m", [0.0005, 0.001])
def test_localisations_that_scatter_may_have_a_small_bias_which_a_cross_shows(noise_m):
    errors = _errors_m(40, 0.001, 1, 0.0, noise_m)
    assert math.sqrt(np.mean(errors**2)) < 0.00025


def test_a_board_that_is_about_to_lift_a_slope_says_nothing_of_where_its_cross_stands():
    estimator = _estimator(ASSUMED)
    # A slope's pads are 2.9 mm above the board, less what is made thicker.
    view = _look(estimator, 0.006, 50, board_m=0.0025)
    assert view.y == pytest.approx(MIDDLE_M, abs=1e-6)


CYCLES = 200


def _set_down(estimator: PoseEstimator, setter: int, looker: int, off_rad: float) -> None:
    """Let one of two cars set down a block that is turned by an angle against the other, which then looks at it."""
    front, side = (
        off_rad * NOMINAL.cars[0].board_length_m / 2,
        off_rad * NOMINAL.cars[0].board_width_m / 2,
    )
    free = AT_REST._replace(lines=NONE_SEEN)
    raised, below = free._replace(board_m=0.03), free._replace(lines=(front, -front, -side, side))
    for car, now, n in (
        (setter, raised, 3),
        (setter, free, 1),
        (looker, below, 20),
        (looker, free, 1),
    ):
        reading = records(2, READING)
        for k in range(2):
            write_reading(now if k == car else free, reading[k : k + 1])
        for _ in range(n):
            estimator.update(reading)


@pytest.mark.parametrize("take_turns", [False, True], ids=["alone", "two cars in turn"])
def test_a_block_that_cars_set_down_does_not_lead_their_headings_astray(take_turns):
    cars = NOMINAL.cars * 2
    estimator = PoseEstimator(ASSUMED, PERIOD_S, cars, load_gains().localisation, (3, 3, 2))
    for cycle in range(CYCLES):
        setter = cycle % 2 if take_turns else 0
        _set_down(estimator, setter, 1 - setter if take_turns else 0, 0.001)
    # Localisations are exact here, and only what is set down is turned by a milliradian each time.
    assert np.abs([row["known"]["state"][5] for row in estimator._estimates]).max() < 5e-4


def test_wheels_that_turn_on_the_spot_are_not_taken_for_a_bias_of_localisations():
    estimator = _estimator(ASSUMED)
    _look(estimator, 0.0, 100)
    # Two millimetres to the left within half a second, by the wheels alone.
    view = _look(estimator, 0.0, 25, wheel_speeds=KINEMATICS.wheel_speeds([0.0, 0.004, 0.0]))
    assert np.abs(estimator._estimates[0]["known"]["state"][3:5]).max() < 1e-4
    assert abs(view.y - MIDDLE_M) < 5e-4
    assert abs(_look(estimator, 0.0, 50).y - MIDDLE_M) < 2e-5


def test_without_line_sensors_a_car_keeps_the_bias_of_its_localisation():
    blind = Machines(cars=(replace(NOMINAL.cars[0], line_reach_m=0.0),))
    attempt = set_up(_yard(), setup_of("none", noise=BIASED, machines=blind)).perform(
        0, Action.MOVE_RIGHT
    )
    assert attempt.car_error_m == pytest.approx(0.005, abs=0.001)


@pytest.mark.parametrize("yaw", [0, 3])
def test_line_sensors_see_where_the_cross_of_a_block_is(yaw):
    grid = Grid.empty((3, 3, 2), 1)
    grid.cars[0, :4], grid.kind[1, 1, 1] = (1, 1, 1, yaw), Kind.BLOCK
    grid.derive_marks()
    physics = PhysicsWorld(grid)
    np.testing.assert_allclose(measure(physics, 0).lines, 0.0, atol=1e-6)
    # Two millimetres forward, three to the left, and a hundredth of a radian.
    quarter, at = yaw * math.pi / 2, physics.cars[0].base.qpos
    c, s = math.cos(quarter), math.sin(quarter)
    physics.data.qpos[at : at + 2] += (0.002 * c - 0.003 * s, 0.002 * s + 0.003 * c)
    half = (quarter + 0.01) / 2
    physics.data.qpos[at + 3 : at + 7] = math.cos(half), 0.0, 0.0, math.sin(half)
    car = NOMINAL.cars[0]
    along, across = 0.01 * car.board_length_m / 2, 0.01 * car.board_width_m / 2
    expected = -0.003 - along, -0.003 + along, -0.002 + across, -0.002 - across
    np.testing.assert_allclose(measure(physics, 0).lines, expected, atol=5e-5)
    physics.data.qpos[at] += 0.05
    assert math.inf in measure(physics, 0).lines


PLANS = (
    [Action.MOVE_RIGHT, Action.LIFT, Action.MOVE_FORWARD, Action.DROP],
    [Action.ROTATE_RIGHT, Action.MOVE_FORWARD, Action.MOVE_RIGHT, Action.ROTATE_LEFT],
    [Action.MOVE_RIGHT, Action.LIFT, Action.ROTATE_LEFT, Action.DROP],
)


@pytest.mark.parametrize("seed", range(3))
def test_under_noise_and_randomised_physics_actions_succeed_within_three_deviations(seed):
    judge = set_up(_yard(), setup_of("strong"), Seed((seed,)))
    for action in PLANS[seed]:
        attempt = judge.perform(0, action)
        assert attempt.agrees, attempt
        assert attempt.car_error_m < 3e-3
        assert attempt.heading_error_rad < 9e-3
        assert (attempt.placed_error_m or 0.0) < 5e-3


def test_at_rest_every_localisation_counts_once_however_late_it_comes():
    estimator = _estimator(SensorNoise(0.001, 0.003, min_delay_s=0.04, max_delay_s=0.04))
    located = 0.001 * np.random.default_rng(0).normal(size=16)
    for n, x in enumerate(located, 1):
        view = _update(estimator, STILL._replace(x=x))
        # The mean, of which the filter's unrest and what it finds of the noise make a little less.
        assert abs(view.x - located[:n].mean()) < 0.4 * 0.001 / math.sqrt(n)


def test_driving_makes_a_car_unsure_and_resting_makes_it_sure_again():
    poses, twists = _truth(*DRIVE, rest_s=1.0)
    still = np.tile(poses[0], (50, 1)), np.zeros((50, 3))
    _, (stds,) = _feed(NOISY, np.vstack([still[0], poses]), np.vstack([still[1], twists]), 1)
    before, after = stds[49, 0], stds[-1, 0]
    assert stds[50:, 0].max() > 2 * before
    assert after == pytest.approx(before, rel=0.3)
