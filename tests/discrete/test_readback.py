"""A Grid is read from poses alone: what stands where, who carries what, and what cannot be a grid at all.

That what stands in physics is read as what was drawn, at each yaw, on each level, is tests/models/test_round_trip.py's.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from craftsim.discrete.geometry import (
    CELL_PITCH_M,
    INCLINE_RAD,
    LEVEL_HEIGHT_M,
    cell_position,
    yaw_angle,
)
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.readback import Poses, nearest_yaw, read_grid
from craftsim.errors import InputError

SIZE = (4, 4, 3)
NO_WALLS = np.zeros((0, 3), int)
LIFT_M = 0.032


def _turn(heading, nose_up=0.0, left_up=0.0):
    """Return the quaternion of a heading, then a raised nose, then a raised left side."""

    def product(a, b):
        (aw, *av), (bw, *bv) = a, b
        return np.array(
            [aw * bw - np.dot(av, bv), *(aw * np.array(bv) + bw * np.array(av) + np.cross(av, bv))]
        )

    about = [
        np.array([math.cos(angle / 2), *(math.sin(angle / 2) * np.array(axis))])
        for angle, axis in ((heading, (0, 0, 1)), (-nose_up, (0, 1, 0)), (left_up, (1, 0, 0)))
    ]
    return product(product(about[0], about[1]), about[2])


def _poses(cars=(), things=()):
    """Return poses of cars (position, quaternion) and things (kind, position, quaternion, hinge)."""
    return Poses(
        np.array([p for p, _ in cars], float).reshape(-1, 3),
        np.array([q for _, q in cars], float).reshape(-1, 4),
        tuple(kind for kind, *_ in things),
        np.array([p for _, p, *_ in things], float).reshape(-1, 3),
        np.array([q for _, _, q, _ in things], float).reshape(-1, 4),
        np.array([hinge for *_, hinge in things], float),
    )


def _car(cell, yaw=0, shift=(0, 0, 0), **tilt):
    return cell_position(*cell) + np.array(shift), _turn(
        yaw_angle(yaw) + tilt.pop("off", 0.0), **tilt
    )


def _thing(kind, cell, yaw=0, shift=(0, 0, 0), hinge=math.nan, off=0.0, **tilt):
    return kind, cell_position(*cell) + np.array(shift), _turn(yaw_angle(yaw) + off, **tilt), hinge


def _slope(cell, yaw=0, hinge=math.pi, **rest):
    return _thing(Kind.FSLOPE, cell, yaw, hinge=hinge, **rest)


def _read(cars=(), things=(), walls=NO_WALLS):
    return read_grid(_poses(cars, things), SIZE, walls)


def _problems(cars=(), things=()):
    return _read(cars, things).problems


def test_the_nearest_yaw_and_the_excess_make_up_the_heading():
    for turns in (-2, -1, 0, 1, 2):
        for off in (-0.7, 0.0, 0.7):
            yaw, excess = nearest_yaw(turns * math.pi / 2 + off)
            assert yaw == turns % 4
            assert excess == pytest.approx(off)


def test_a_load_on_the_incline_is_lifted_across_the_incline():
    for yaw in range(4):
        for facing_up in (True, False):
            pitch = INCLINE_RAD if facing_up else -INCLINE_RAD
            position, turn = _car((1, 1, 1), yaw, (0, 0, 0.25 * LEVEL_HEIGHT_M), nose_up=pitch)
            forward = np.array([math.cos(yaw_angle(yaw)), math.sin(yaw_angle(yaw)), 0])
            up = -math.sin(pitch) * forward + np.array([0, 0, math.cos(pitch)])
            reading = _read(
                [(position, turn)], [(Kind.BLOCK, position + LIFT_M * up, turn, math.nan)]
            )
            assert reading.problems == ()
            assert reading.grid.cars[0, CarField.LOAD] == Kind.BLOCK
            assert reading.objects[0].offset_m == pytest.approx(0.0, abs=1e-12)


def test_a_gear_leaves_its_cell_to_what_stands_there():
    for things in (
        [_slope((0, 0, 1)), _thing(Kind.BLOCK, (1, 0, 1))],
        [_thing(Kind.BLOCK, (1, 0, 1)), _slope((0, 0, 1))],
    ):
        reading = _read(things=things)
        assert reading.problems == ()
        assert reading.grid.kind[1, 0, 1] == Kind.BLOCK
        assert reading.grid.yaw[1, 0, 1] == 0


CAR_PROBLEMS = (
    (_car((1, 1, 1), shift=(0.03, 0.04, 0)), "car 0 is 50 mm from the centre of (1, 1)"),
    (_car((-1, 1, 1)), "car 0 is outside the area, at (-1, 1)"),
    (_car((1, 1, 1), shift=(0, 0, 0.05)), "car 0 is +50 mm from the floor of level 1"),
    (_car((1, 1, 5)), "car 0 is on level 5, outside 1..4"),
    (_car((1, 1, 1), off=0.3), "car 0 heads +0.30 rad away from yaw 0"),
    (_car((1, 1, 1), nose_up=0.1), "car 0 leans: pitch +0.10 rad, roll 0.00 rad"),
    (_car((1, 1, 1), nose_up=0.02, left_up=-0.2), "car 0 leans: pitch +0.02 rad, roll 0.20 rad"),
    (_car((1, 1, 1), left_up=math.pi), "car 0 leans: pitch +0.00 rad, roll 0.00 rad"),
)
THING_PROBLEMS = (
    (
        _thing(Kind.BLOCK, (1, 1, 1), shift=(-0.03, 0, 0)),
        "block 0 is 30 mm from the centre of (1, 1)",
    ),
    (_thing(Kind.FLAG, (4, 1, 1)), "flag 0 is outside the area, at (4, 1)"),
    (
        _thing(Kind.BLOCK, (1, 1, 1), shift=(0, 0, 0.02)),
        "block 0 is +20 mm from the floor of level 1",
    ),
    (_thing(Kind.BLOCK, (1, 1, 4)), "block 0 is on level 4, outside 1..3"),
    (_thing(Kind.BLOCK, (1, 1, 1), left_up=0.3), "block 0 leans by 0.30 rad"),
    (_thing(Kind.BLOCK, (1, 1, 1), left_up=math.pi), "block 0 leans by 3.14 rad"),
    (_thing(Kind.BLOCK, (1, 1, 1), off=0.2), "block 0 is turned by +0.20 rad"),
    (_slope((1, 1, 1), hinge=1.0), "slope 0 is half open: its hinge stands at 1.00 rad"),
    (_slope((3, 1, 1)), "slope 0 reaches outside the area, into (4, 1, 1)"),
)


def test_what_stands_in_no_cell_is_a_problem_said_in_words():
    for car, problem in CAR_PROBLEMS:
        assert _problems([car]) == (problem,)
    for thing, problem in THING_PROBLEMS:
        assert _problems(things=[thing]) == (problem,)
    for (car, one), (thing, other) in zip(CAR_PROBLEMS, THING_PROBLEMS, strict=False):
        assert _problems([car], [thing]) == (one, other), "every problem is named at once"


def test_two_things_in_a_cell_a_thing_in_a_wall_and_a_second_load_are_problems():
    pair = [_thing(Kind.BLOCK, (1, 1, 1)), _thing(Kind.FLAG, (1, 1, 1), shift=(0.01, 0, 0))]
    assert _problems(things=pair) == ("flag 0 shares the cell (1, 1, 1) with a block",)
    foot = [_thing(Kind.BLOCK, (1, 1, 1)), _slope((0, 1, 1), hinge=0.0)]
    assert _problems(things=foot) == ("slope 0 shares the cell (1, 1, 1) with a block",)
    reading = _read(things=[_thing(Kind.BLOCK, (2, 2, 1))], walls=np.array([[2, 2, 1]]))
    assert reading.problems == ("block 0 shares the cell (2, 2, 1) with a wall",)
    loads = [_thing(Kind.BLOCK, (1, 1, 1), shift=(0, 0, LIFT_M + d)) for d in (0, 0.01)]
    assert _problems([_car((1, 1, 1))], loads) == ("block 1 is a second load on car 0",)


def test_just_within_the_tolerances_nothing_is_a_problem():
    car = _car((1, 1, 1), shift=(0.017, 0.017, 0.009), off=0.14, nose_up=0.04, left_up=0.04)
    slope = _slope((2, 2, 1), hinge=math.pi - 0.04, shift=(0.024, 0, -0.009), off=-0.14)
    assert _problems([car], [slope]) == ()


def test_reading_does_not_depend_on_the_sign_or_length_of_a_quaternion():
    poses = _poses([_car((1, 1, 1), 1)], [_slope((2, 2, 1), 3)])
    flipped = replace(
        poses, car_quaternions=-poses.car_quaternions, quaternions=2.0 * poses.quaternions
    )
    assert read_grid(flipped, SIZE, NO_WALLS).grid.same_visible(
        read_grid(poses, SIZE, NO_WALLS).grid
    )


def test_a_load_off_its_seat_is_a_problem():
    slid = _thing(Kind.BLOCK, (1, 1, 1), shift=(0.012, 0, LIFT_M))
    assert _problems([_car((1, 1, 1))], [slid]) == ("block 0 sits 12 mm off its seat on car 0",)
    seated = _thing(Kind.BLOCK, (1, 1, 1), shift=(0.001, 0, LIFT_M))
    assert _problems([_car((1, 1, 1))], [seated]) == ()


def test_heights_are_told_above_the_floor_or_the_incline_and_things_are_counted_by_kind():
    level, climbing = _car((0, 0, 2), shift=(0, 0, 0.003)), _car((2, 2, 1), 2, nose_up=INCLINE_RAD)
    climbing[0][2] += LEVEL_HEIGHT_M / 4 - 0.002
    things = [_thing(Kind.BLOCK, (1, 1, 1), shift=(0, 0, -0.001)), _slope((2, 2, 1), hinge=0.0)]
    things += [_thing(Kind.BLOCK, (0, 0, 1))]
    reading = _read([level, climbing], things)
    assert [car.height_m for car in reading.cars] == pytest.approx([0.003, -0.002])
    assert [thing.height_m for thing in reading.objects] == pytest.approx([-0.001, 0, 0])
    poses = _poses([], things)
    assert [poses.name(i) for i in range(3)] == ["block 0", "slope 0", "block 1"]


@pytest.mark.parametrize("off", [-1e-12, 0.0, 1e-12])
def test_a_pose_on_the_border_of_two_readings_is_a_problem_whichever_its_last_digits_choose(off):
    half = (0.5 + off) * CELL_PITCH_M
    for shift in (
        (half, 0, 0),
        (0, half, 0),
        (-half, 0, 0),
        (half, half, 0),
        (0, 0, LEVEL_HEIGHT_M / 2 + off),
    ):
        assert _problems([_car((1, 1, 1), shift=shift)]), shift
        assert _problems(things=[_thing(Kind.BLOCK, (1, 1, 1), shift=shift)]), shift
        assert _problems(things=[_slope((1, 1, 1), shift=shift)]), shift
    assert _problems([((*cell_position(1, 1, 1),), _turn(math.pi / 4 + off))])
    assert _problems(things=[_slope((1, 1, 1), hinge=math.pi / 2 + off)])
    # Neither level nor on the incline.
    assert _problems([_car((1, 1, 1), nose_up=INCLINE_RAD / 2 + off)])


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_a_pose_that_is_no_number_is_refused_not_read(number):
    """All comparisons with nan are false, so that none of the limits would be exceeded."""
    somewhere = _car((0, 0, 1))[0]
    for at in range(3):
        position = somewhere.copy()
        position[at] = number
        with pytest.raises(InputError, match="finite numbers"):
            read_grid(_poses([(position, _turn(0.0))]), (3, 3, 2), NO_WALLS)
        with pytest.raises(InputError, match="finite numbers"):
            read_grid(
                _poses(things=[(Kind.BLOCK, position, _turn(0.0), math.nan)]), (3, 3, 2), NO_WALLS
            )
    with pytest.raises(InputError, match="the hinge of a slope"):
        read_grid(_poses(things=[_slope((0, 0, 1), hinge=number)]), (3, 3, 2), NO_WALLS)


@pytest.mark.parametrize(
    "turn", [(math.nan, 0, 0, 0), (0, 0, 0, 0), (math.inf, 0, 0, 0), (5e-324, 0, 0, 0)]
)
def test_a_quaternion_that_is_no_rotation_is_refused(turn):
    place = cell_position(0, 0, 1)
    with pytest.raises(InputError, match="a quaternion that is not zero"):
        read_grid(_poses([(place, turn)]), (3, 3, 2), NO_WALLS)
    with pytest.raises(InputError, match="a quaternion that is not zero"):
        read_grid(_poses(things=[(Kind.BLOCK, place, turn, math.nan)]), (3, 3, 2), NO_WALLS)
