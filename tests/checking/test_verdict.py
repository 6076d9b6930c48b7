"""What is found of an action: agreed, not executed, wrong place, side effect, unreadable; and what differs in words."""

import numpy as np
import pytest

from craftsim.checking.attempt import AGREES, Cause, compare
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.readback import Reading, describe_car, describe_differences, own_differences


def _before() -> Grid:
    """Return two cars, a block and a folded slope."""
    grid = Grid.empty((4, 4, 3), 2)
    grid.cars[0, :4] = 0, 0, 1, 0
    grid.cars[1, :4] = 3, 3, 1, 2
    grid.kind[1, 2, 1] = Kind.BLOCK
    grid.kind[2, 2, 1], grid.kind[3, 2, 1] = Kind.FSLOPE, Kind.GEAR
    return grid


def _changed(grid: Grid, *, cars=(), cells=()) -> Grid:
    after = grid.copy()
    for car, field, value in cars:
        after.cars[car, field] = value
    for cell, kind in cells:
        after.kind[cell] = kind
    return after


def _compare(before: Grid, predicted: Grid, read: Grid, *problems: str) -> Cause:
    return compare(before, predicted, Reading(read, (), (), problems))


BEFORE = _before()
STEP = _changed(BEFORE, cars=[(0, CarField.X, 1)])


def test_what_is_read_as_predicted_agrees():
    assert _compare(BEFORE, STEP, STEP.copy()) == AGREES
    assert _compare(BEFORE, STEP, STEP.copy())[0] == "agrees"


def test_an_action_that_is_predicted_to_change_nothing_agrees_when_nothing_changes():
    assert _compare(BEFORE, BEFORE.copy(), BEFORE.copy())[0] == "agrees"


def test_marks_do_not_decide():
    read = STEP.copy()
    read.occupant[:] = 7
    read.landing[:] = True
    assert _compare(BEFORE, STEP, read)[0] == "agrees"


def test_no_change_at_all_is_not_executed():
    cause = _compare(BEFORE, STEP, BEFORE.copy())
    assert cause[0] == "not executed"
    assert cause[1] == ("car 0: predicted 1,0,1 +x, read 0,0,1 +x",)
    assert cause[0] != "agrees"


@pytest.mark.parametrize(
    "change", [(CarField.Y, 1), (CarField.YAW, 1), (CarField.LOAD, Kind.BLOCK)], ids=["cell", "yaw", "load"]
)
def test_the_acting_car_elsewhere_is_a_wrong_place(change):
    read = _changed(BEFORE, cars=[(0, *change)])
    assert _compare(BEFORE, STEP, read)[0] == "wrong place"


def test_a_load_set_down_wrong_is_a_wrong_place():
    loaded = _changed(BEFORE, cars=[(0, CarField.LOAD, Kind.FLAG)])
    dropped = _changed(BEFORE, cells=[((0, 0, 1), Kind.FLAG)])
    read = _changed(BEFORE, cells=[((0, 0, 1), Kind.BLOCK)])
    cause = _compare(loaded, dropped, read)
    assert cause[0] == "wrong place"
    assert cause[1] == ("cell (0, 0, 1): predicted flag yaw 0, read block yaw 0",)


@pytest.mark.parametrize(
    "read",
    [
        _changed(STEP, cars=[(1, CarField.Y, 2)]),
        _changed(STEP, cars=[(1, CarField.YAW, 0)]),
        _changed(STEP, cells=[((1, 2, 1), Kind.AIR), ((1, 3, 1), Kind.BLOCK)]),
        _changed(STEP, cells=[((2, 2, 1), Kind.BODY), ((3, 2, 1), Kind.FOOT)]),
        _changed(BEFORE, cells=[((1, 2, 1), Kind.AIR)]),
    ],
    ids=["car pushed", "car turned", "block pushed", "slope opened", "block gone and car not moved"],
)
def test_a_change_of_what_the_action_leaves_alone_is_a_side_effect(read):
    cause = _compare(BEFORE, STEP, read)
    assert cause[0] == "side effect"
    assert cause[1]


def test_a_turned_thing_is_a_side_effect():
    read = STEP.copy()
    read.yaw[2, 2, 1] = 1
    cause = _compare(BEFORE, STEP, read)
    assert cause[0] == "side effect"
    assert cause[1] == ("cell (2, 2, 1): predicted fslope yaw 0, read fslope yaw 1",)


def test_poses_that_are_no_grid_are_unreadable_whatever_the_grid_says():
    cause = _compare(BEFORE, STEP, STEP.copy(), "car 0 leans: pitch +0.30 rad, roll 0.00 rad")
    assert cause == ("unreadable", ("car 0 leans: pitch +0.30 rad, roll 0.00 rad",))


def test_every_difference_gets_its_line():
    read = _changed(STEP, cars=[(0, CarField.X, 2), (1, CarField.YAW, 3)], cells=[((1, 2, 1), Kind.AIR)])
    assert describe_differences(STEP, read) == [
        "cell (1, 2, 1): predicted block yaw 0, read air yaw 0",
        "car 0: predicted 1,0,1 +x, read 2,0,1 +x",
        "car 1: predicted 3,3,1 -x, read 3,3,1 -y",
    ]


@pytest.mark.parametrize(
    ("row", "text"),
    [
        ((2, 3, 1, 1, Kind.AIR, 0, 0), "2,3,1 +y"),
        ((2, 3, 1, 1, Kind.BLOCK, 0, 0), "2,3,1 +y block"),
        ((0, 1, 2, 2, Kind.FSLOPE, 0, 2), "0,1,2 -x fslope+x high"),
        ((0, 1, 1, 3, Kind.FLAG, 0, 1), "0,1,1 -y flag low"),
    ],
)
def test_a_car_is_described_in_brief(row, text):
    grid = Grid.empty((4, 4, 3), 1)
    grid.cars[0] = np.array(row)
    assert describe_car(grid, 0) == text


def test_an_action_has_its_effect_whatever_else_happened():
    dropped = _changed(STEP, cells=[((1, 0, 1), Kind.BLOCK)])
    pushed = _changed(dropped, cars=[(1, CarField.Y, 2)], cells=[((1, 2, 1), Kind.AIR)])
    assert own_differences(BEFORE, dropped, dropped, car=0) == []
    assert own_differences(BEFORE, dropped, pushed, car=0) == []


@pytest.mark.parametrize("read", [BEFORE, STEP, _changed(BEFORE, cells=[((1, 0, 1), Kind.BLOCK)])])
def test_an_action_whose_car_or_cell_is_not_as_predicted_has_not_its_effect(read):
    dropped = _changed(STEP, cells=[((1, 0, 1), Kind.BLOCK)])
    assert own_differences(BEFORE, dropped, read, car=0)
