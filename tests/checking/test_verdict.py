"""What is found of an action: agreed, not executed, wrong place, side effect, unreadable; and what differs in words."""

import numpy as np

from craftsim.checking.attempt import Cause, compare
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


def _turned(grid: Grid) -> Grid:
    after = grid.copy()
    after.yaw[2, 2, 1] = 1
    return after


def _other_marks(grid: Grid) -> Grid:
    after = grid.copy()
    after.occupant[:], after.landing[:] = 7, True
    return after


LOADED = _changed(BEFORE, cars=[(0, CarField.LOAD, Kind.FLAG)])
DROPPED = _changed(BEFORE, cells=[((0, 0, 1), Kind.FLAG)])
LEANS = "car 0 leans: pitch +0.30 rad, roll 0.00 rad"
FOUND = (
    (BEFORE, STEP, STEP, (), "agrees", None),
    (BEFORE, BEFORE, BEFORE, (), "agrees", None),
    (BEFORE, STEP, _other_marks(STEP), (), "agrees", None),
    (BEFORE, STEP, BEFORE, (), "not executed", "car 0: predicted 1,0,1 +x, read 0,0,1 +x"),
    *(
        (BEFORE, STEP, _changed(BEFORE, cars=[(0, *change)]), (), "wrong place", None)
        for change in ((CarField.Y, 1), (CarField.YAW, 1), (CarField.LOAD, Kind.BLOCK))
    ),
    (
        *(LOADED, DROPPED, _changed(BEFORE, cells=[((0, 0, 1), Kind.BLOCK)]), (), "wrong place"),
        "cell (0, 0, 1): predicted flag yaw 0, read block yaw 0",
    ),
    *(
        (BEFORE, STEP, _changed(STEP, cars=cars, cells=cells), (), "side effect", None)
        for cars, cells in (
            ([(1, CarField.Y, 2)], ()),
            ([(1, CarField.YAW, 0)], ()),
            ((), [((1, 2, 1), Kind.AIR), ((1, 3, 1), Kind.BLOCK)]),
            ((), [((2, 2, 1), Kind.BODY), ((3, 2, 1), Kind.FOOT)]),
        )
    ),
    (BEFORE, STEP, _changed(BEFORE, cells=[((1, 2, 1), Kind.AIR)]), (), "side effect", None),
    (
        BEFORE,
        STEP,
        _turned(STEP),
        (),
        "side effect",
        "cell (2, 2, 1): predicted fslope yaw 0, read fslope yaw 1",
    ),
    (BEFORE, STEP, STEP, (LEANS,), "unreadable", LEANS),
)
"""Before, predicted, read, problems of the reading; what is found, and in which words if one difference is all."""


def test_what_is_found_follows_from_what_is_predicted_and_read():
    for before, predicted, read, problems, found, words in FOUND:
        cause = _compare(before, predicted, read, *problems)
        assert cause[0] == found, cause
        assert bool(cause[1]) == (found != "agrees")
        assert words is None or cause[1] == (words,)


def test_every_difference_gets_its_line():
    read = _changed(STEP, cars=[(0, CarField.X, 2), (1, CarField.YAW, 3)], cells=[((1, 2, 1), Kind.AIR)])
    assert describe_differences(STEP, read) == [
        "cell (1, 2, 1): predicted block yaw 0, read air yaw 0",
        "car 0: predicted 1,0,1 +x, read 2,0,1 +x",
        "car 1: predicted 3,3,1 -x, read 3,3,1 -y",
    ]


def test_a_car_is_described_in_brief():
    for row, text in (
        ((2, 3, 1, 1, Kind.AIR, 0, 0), "2,3,1 +y"),
        ((2, 3, 1, 1, Kind.BLOCK, 0, 0), "2,3,1 +y block"),
        ((0, 1, 2, 2, Kind.FSLOPE, 0, 2), "0,1,2 -x fslope+x high"),
        ((0, 1, 1, 3, Kind.FLAG, 0, 1), "0,1,1 -y flag low"),
    ):
        grid = Grid.empty((4, 4, 3), 1)
        grid.cars[0] = np.array(row)
        assert describe_car(grid, 0) == text


def test_an_action_has_its_effect_whatever_else_happened():
    dropped = _changed(STEP, cells=[((1, 0, 1), Kind.BLOCK)])
    pushed = _changed(dropped, cars=[(1, CarField.Y, 2)], cells=[((1, 2, 1), Kind.AIR)])
    assert own_differences(BEFORE, dropped, dropped, car=0) == []
    assert own_differences(BEFORE, dropped, pushed, car=0) == []


def test_an_action_whose_car_or_cell_is_not_as_predicted_has_not_its_effect():
    for read in (BEFORE, STEP, _changed(BEFORE, cells=[((1, 0, 1), Kind.BLOCK)])):
        dropped = _changed(STEP, cells=[((1, 0, 1), Kind.BLOCK)])
        assert own_differences(BEFORE, dropped, read, car=0)
