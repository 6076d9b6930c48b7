"""The judge finds what exceeds a limit by 3 %, and accepts what stays 3 % below: poses written by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from discrete.drawn import draw

from craftsim.checking.pose_judge import judge_poses
from craftsim.checking.setup import Setup, compile_world
from craftsim.checking.thresholds import thresholds_of
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import read_grid
from craftsim.discrete.schedule import nominal_durations
from craftsim.errors import InputError
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.composition import lift_m
from craftsim.testing import Poses

SIZE = (5, 3, 2)
LIMITS = thresholds_of()
PITCH_M = 0.3225
BLOCK, SLOPE = 1, 2
"""Indices of the standing block and the unfolded slope; 0 is the load of car 1."""
SEAT_M = lift_m(Kind.BLOCK, NOMINAL.cars[0], NOMINAL)
NOMINAL_S = float(nominal_durations()[Action.MOVE_RIGHT, 0])


@pytest.fixture(scope="module")
def still():
    """An empty car, a loaded one, a block and an unfolded slope, at rest."""
    things = [(Kind.BLOCK, (2, 2, 1)), (Kind.BODY, (3, 0, 1), 0)]
    cars = [(0, 0, 1, 0), (0, 1, 1, 0, Kind.BLOCK)]
    physics = compile_world(draw(SIZE, things, cars), Setup())
    physics.reset_compiled()
    return physics.poses()


def _about(axis: int, angle: float, quaternion: np.ndarray) -> np.ndarray:
    """Return a quaternion turned about an axis of the world."""
    turn = np.zeros(4)
    turn[0], turn[1 + axis] = math.cos(angle / 2), math.sin(angle / 2)
    w, x, y, z = turn
    a, b, c, d = quaternion
    return np.array(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ]
    )


def _copy(poses: Poses) -> Poses:
    arrays = {
        name: getattr(poses, name).copy()
        for name in ("car_positions", "car_quaternions", "positions", "quaternions", "hinges")
    }
    return replace(poses, **arrays)


def _moved(poses: Poses, car: int) -> Poses:
    """Return the poses after a car, and its load, moved by a cell to the right."""
    after = _copy(poses)
    after.car_positions[car, 0] = 1.5 * PITCH_M
    after.car_positions[car, 1] = (car + 0.5) * PITCH_M
    if car == 1:
        after.positions[0, :2] = 1.5 * PITCH_M, 1.5 * PITCH_M
    return after


def _car(column, *, angle=False):
    def plant(after, size):
        if angle:
            after.car_quaternions[0] = _about(column, size, after.car_quaternions[0])
        else:
            after.car_positions[0, column] += size

    return plant


def _object(index, column, *, angle=False):
    def plant(after, size):
        if angle:
            after.quaternions[index] = _about(column, size, after.quaternions[index])
        else:
            after.positions[index, column] += size

    return plant


def _load_and_car(after, size):
    """Carry a load so that it reaches out by ``size``: half by its place, half by its heading."""
    after.car_positions[1, 1] += size / 2
    after.positions[0, 1] += size / 2
    angle = size / 2 / (PITCH_M / 2)
    after.car_quaternions[1] = _about(2, angle, after.car_quaternions[1])
    after.quaternions[0] = _about(2, angle, after.quaternions[0])


def _hinge(after, size):
    after.hinges[SLOPE] += size


PLANTED = {
    "car's place along x": (0, _car(0), "place_m", "failed", "the car is"),
    "car's place along y": (0, _car(1), "place_m", "failed", "the car is"),
    "car's height": (0, _car(2), "place_m", "failed", "the car's height"),
    "car's heading": (0, _car(2, angle=True), "turn_rad", "failed", "the car is turned"),
    "car's roll": (0, _car(0, angle=True), "turn_rad", "failed", "the car leans"),
    "car's pitch": (0, _car(1, angle=True), "turn_rad", "failed", "the car leans"),
    "load's reach": (1, _load_and_car, "place_m", "failed", "too near to a neighbouring cell"),
    "load's seat": (1, _object(0, 0), "seat_m", "failed", "off its seat"),
    "load's height": (1, _object(0, 2), "place_m", "failed", "the thing's height"),
    "load's heading": (1, _object(0, 2, angle=True), "turn_rad", "failed", "the thing is turned"),
    "block's place": (0, _object(BLOCK, 0), "place_m", "side effect", "block 1 was moved"),
    "block's height": (0, _object(BLOCK, 2), "place_m", "side effect", "block 1 was moved"),
    "block's heading": (0, _object(BLOCK, 2, angle=True), "turn_rad", "side effect", "block 1"),
    "slope's hinge": (0, _hinge, "turn_rad", "side effect", "slope 0"),
    "slope's place": (0, _object(SLOPE, 1), "place_m", "side effect", "slope 0 was moved"),
}
"""The car that moves, what is planted, its limit, the verdict and words of the reason."""


@pytest.mark.parametrize("name", PLANTED)
def test_an_error_is_found_from_3_per_cent_above_its_limit(name, still):
    car, plant, limit, verdict, words = PLANTED[name]
    before = _copy(still)
    _settle(before)
    for share, expected in ((0.97, "as predicted"), (1.03, verdict)):
        after = _moved(before, car)
        plant(after, share * getattr(LIMITS, limit))
        attempt = judge_poses(before, after, car, "MOVE_RIGHT", size=SIZE)
        assert attempt.result == expected, (share, attempt.reason)
        assert expected == "as predicted" or words in attempt.reason


def _settle(poses: Poses) -> None:
    """Put everything exactly where it should be: what physics leaves of errors would count, too."""
    poses.car_positions[:, :2] = [(0.5 * PITCH_M, 0.5 * PITCH_M), (0.5 * PITCH_M, 1.5 * PITCH_M)]
    poses.car_positions[:, 2] = 0.0
    poses.car_quaternions[:] = 1.0, 0.0, 0.0, 0.0
    poses.positions[0, :2] = poses.car_positions[1, :2]
    poses.positions[0, 2] = SEAT_M
    poses.positions[BLOCK] = 2.5 * PITCH_M, 2.5 * PITCH_M, 0.0
    poses.positions[SLOPE] = 3.5 * PITCH_M, 0.5 * PITCH_M, 0.0
    poses.quaternions[:] = 1.0, 0.0, 0.0, 0.0
    poses.hinges[SLOPE] = 0.0


@pytest.mark.parametrize(
    ("option", "limit", "verdict"),
    [
        ("contacts", "contact_n", "side effect"),
        ("contacts", "impact_n", "unsafe"),
        ("duration_s", "duration_ratio", "failed"),
        ("boards_m", "place_m", "failed"),
        ("way_m", "way_m", "failed"),
        ("way_lean_rad", "way_lean_rad", "failed"),
    ],
)
def test_what_is_no_pose_is_held_against_its_limit(option, limit, verdict, still):
    before = _copy(still)
    _settle(before)
    after = _moved(before, 0)
    below = {"impact_n": "side effect"}.get(limit, "as predicted")
    for share, expected in ((0.97, below), (1.03, verdict)):
        value = share * getattr(LIMITS, limit)
        if option == "contacts":
            value = [("car 0", "block 1", value)]
        elif option == "duration_s":
            value *= NOMINAL_S
        elif option == "boards_m":
            value = np.array([value, 0.045])
        attempt = judge_poses(before, after, 0, "MOVE_RIGHT", size=SIZE, **{option: value})
        assert attempt.result == expected, (share, attempt.reason)


def test_a_second_try_is_told_apart(still):
    before = _copy(still)
    _settle(before)
    again = judge_poses(before, _moved(before, 0), 0, "MOVE_RIGHT", size=SIZE, tries=2)
    assert (again.result, again.agrees, again.reason) == ("as predicted, retried", True, "")


def test_a_car_that_tips_is_unsafe_and_one_that_stays_has_failed(still):
    before = _copy(still)
    _settle(before)
    after = _moved(before, 0)
    after.car_quaternions[0] = _about(0, 0.6, after.car_quaternions[0])
    assert judge_poses(before, after, 0, "MOVE_RIGHT", size=SIZE).result == "unsafe"
    stays = judge_poses(before, before, 0, Action.MOVE_RIGHT, size=SIZE)
    assert (stays.result, stays.finding) == ("failed", "not executed")


def test_what_the_rules_forbid_has_failed_unless_it_was_asked_for(still):
    before = _copy(still)
    _settle(before)
    forbidden = judge_poses(before, before, 0, "LIFT", size=SIZE)
    assert (forbidden.result, forbidden.performed) == ("failed", False)
    assert forbidden.reason.startswith("the rules forbid it: there is nothing to lift")
    same = read_grid(before, SIZE, np.zeros((0, 3), int)).grid
    assert judge_poses(before, before, 0, "LIFT", size=SIZE, predicted=same).agrees
    hit = judge_poses(before, before, 0, "LIFT", size=SIZE, contacts=[("car 0", "wall", 500.0)])
    assert hit.result == "unsafe"


def test_walls_are_lists_and_quaternions_of_any_length(still):
    before = _copy(still)
    _settle(before)
    after = _moved(before, 0)
    assert judge_poses(before, after, 0, "MOVE_RIGHT", size=list(SIZE), walls=[[4, 2, 1]]).agrees
    blocked = judge_poses(before, after, 0, "MOVE_RIGHT", size=SIZE, walls=[[1, 0, 1]])
    assert "the rules forbid it" in blocked.reason
    after.car_quaternions[0] = 0.5 * _about(0, 0.6, after.car_quaternions[0])
    assert judge_poses(before, after, 0, "MOVE_RIGHT", size=SIZE).result == "unsafe"


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("size", (3, 1), "size"),
        ("size", (3.5, 1, 1), "whole numbers"),
        ("size", None, "whole numbers"),
        ("walls", [[9, 9, 9]], "allowed: x from 0 to 4"),
        ("walls", [[0, 0, 0]], "level 1 to 2"),
        ("walls", [[-1, 0, 1]], "outside the area"),
        ("walls", [[1.5, 0, 1]], "whole numbers"),
        ("walls", [1, 0, 1], "shape"),
        ("walls", [[0, 0, 1]], "car 0 and a wall"),
        ("rules", None, "unknown rule set"),
        ("predicted", Grid.empty((5, 3, 1), 2), "2 cars in"),
        ("predicted", "up", "craftsim.Grid"),
        ("machines", None, "craftsim.Machines"),
        ("contacts", None, "allowed: tuples"),
        ("contacts", [("car 0", "wall")], "a tuple"),
        ("contacts", [("car 0", "block 7", 12.0)], "unknown machine 'block 7'"),
        ("contacts", [(0, 1, 12.0)], "unknown machine '0'"),
        ("contacts", [("car 0", "car 0", 12.0)], "itself"),
        ("contacts", [("car 0", "wall", -5.0)], "from 0 on"),
        ("contacts", [("car 0", "wall", math.nan)], "from 0 on"),
        ("duration_s", -1.0, "from 0 on"),
        ("duration_s", math.nan, "from 0 on"),
        ("duration_s", None, "from 0 on"),
        ("tries", 0, "from 1 on"),
        ("tries", 1.5, "from 1 on"),
        ("boards_m", [0.0], "shape"),
        ("boards_m", [0.0, math.inf], "nan for unknown"),
        ("boards_m", "up", "numbers"),
        ("way_m", -1.0, "from 0 on"),
        ("way_m", None, "from 0 on"),
        ("way_lean_rad", math.inf, "from 0 on"),
    ],
)
def test_options_that_nothing_can_have_are_refused(option, value, words, still):
    with pytest.raises(InputError, match=words):
        judge_poses(still, still, 0, "STOP", **{"size": SIZE, option: value})


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("car_positions", np.zeros((2, 2)), "allowed: .2, 3."),
        ("car_positions", None, "shape"),
        ("car_positions", np.full((2, 3), math.nan), "finite"),
        ("car_quaternions", np.zeros((2, 4)), "zeros"),
        ("car_quaternions", np.ones((2, 3)), "allowed: .2, 4."),
        ("positions", np.zeros((1, 3)), "allowed: .3, 3."),
        ("positions", "here", "numbers"),
        ("hinges", np.full(3, math.nan), "hinge of a slope"),
        ("hinges", np.zeros(2), "allowed: .3,"),
        ("kinds", (Kind.BLOCK, Kind.BLOCK, Kind.WALL), "allowed: BLOCK, FLAG, FSLOPE"),
    ],
)
def test_poses_that_nothing_can_have_are_refused(name, value, words, still):
    for poses in (
        (replace(still, **{name: value}), still),
        (still, replace(still, **{name: value})),
    ):
        with pytest.raises(InputError, match=words):
            judge_poses(*poses, 0, "STOP", size=SIZE)


def test_what_cannot_be_judged_is_refused(still):
    other = replace(still, kinds=(Kind.FLAG, *still.kinds[1:]))
    for poses, car, action, words in (
        (still, 2, "MOVE_RIGHT", "there is no car 2"),
        (still, 0.5, "MOVE_RIGHT", "there is no car 0.5"),
        (still, 0, "JUMP", "unknown action 'JUMP'"),
        (still, 0, 3, "unknown action '3'"),
        (None, 0, "MOVE_RIGHT", "craftsim.testing.Poses"),
        (other, 0, "MOVE_RIGHT", "the same cars and objects"),
    ):
        with pytest.raises(InputError, match=words):
            judge_poses(still, poses, car, action, size=SIZE)
