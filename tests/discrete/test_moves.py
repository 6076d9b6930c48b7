"""Ticks, ways up and down a ramp, and actions that undo each other; what is legal is recorded: test_conformance."""

import pytest

from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules

BLOCK, FSLOPE, BODY = Kind.BLOCK, Kind.FSLOPE, Kind.BODY
RIGHT, LEFT = Action.MOVE_RIGHT, Action.MOVE_LEFT
RAMP = [(BODY, (3, 3, 1), 2), (BLOCK, (4, 3, 1))]
"""A ramp that is climbed in direction +x: foot at (2, 3), landing on the block at (4, 3)."""


@pytest.fixture(params=["published", "physical"])
def rules(request):
    return Rules(request.param)


def test_a_climb_is_three_moves_to_the_level_above_the_top_and_a_descent_the_same_three_back(
    rules, scene, car
):
    grid, states = scene(RAMP, [car(1, 3)], size=(7, 7, 1)), []
    for yaw, move in ((0, RIGHT), (2, LEFT)):
        grid.cars[0, CarField.YAW] = yaw
        for _ in range(3):
            assert rules.legal(grid, 0, move)
            grid = rules.apply(grid, 0, move)
            states.append([int(grid.cars[0, field]) for field in (CarField.X, CarField.Z, CarField.SLOPE)])
    assert states == [[2, 1, 1], [3, 2, 2], [4, 2, 0], [3, 2, 2], [2, 1, 1], [1, 1, 0]]


def test_a_carried_gear_needs_room_beside_it(rules, scene, car):
    mine = car(3, 3, yaw=0, load=FSLOPE)
    for kind, yaw, free in (
        (BLOCK, 0, False),
        (Kind.GEAR, 0, True),
        (Kind.GEAR, 2, False),
        (Kind.GEAR, 1, False),
    ):
        assert rules.legal(scene([(kind, (2, 4, 1), yaw)], [mine]), 0, Action.MOVE_FORWARD) == free
    for other, free in (
        (car(2, 4, load=BLOCK), False),
        (car(1, 4, yaw=2, load=FSLOPE), True),
        (car(2, 5, yaw=1, load=FSLOPE), False),
    ):
        assert rules.legal(scene([], [mine, other]), 0, Action.MOVE_FORWARD) == free, other


def test_a_block_turns_whatever_stands_at_the_corners(rules, scene, car):
    corners = [(x, y) for x in (2, 4) for y in (2, 4)]
    things = scene([(BLOCK, (*corner, 1)) for corner in corners], [car(3, 3, load=BLOCK)])
    loads = scene([], [car(3, 3, load=BLOCK), *(car(*corner, load=BLOCK) for corner in corners)])
    far = scene([], [car(3, 3, load=BLOCK), car(6, 6, load=FSLOPE), car(1, 6, yaw=1, load=FSLOPE)])
    for grid in (things, loads, far):
        assert rules.mask(grid)[0, [Action.ROTATE_LEFT, Action.ROTATE_RIGHT]].all()


def test_cars_act_one_after_the_other_on_what_the_earlier_ones_left(rules, scene, car):
    grid = scene([], [car(3, 3), car(4, 3)])
    kept = grid.copy()
    for order, applied_in_order, places in (((1, 0), [True, True], [4, 5]), ((0, 1), [False, True], [3, 5])):
        after, applied = rules.tick(grid, [(one, RIGHT) for one in order])
        assert applied.tolist() == applied_in_order
        assert after.cars[:, CarField.X].tolist() == places
    assert grid.same_visible(kept)
    assert grid.same_marks(kept)


def test_a_car_that_is_not_there_is_refused_and_an_action_that_does_not_exist_is_never_legal(
    rules, scene, car
):
    grid = scene([], [car(3, 3)])
    for number in (-1, 1, 99):
        for call in (
            lambda number: rules.legal(grid, number, Action.STOP),
            lambda number: rules.tick(grid, [(number, Action.STOP)]),
            lambda number: rules.plan_move(grid, number, RIGHT),
        ):
            with pytest.raises(ValueError, match=f"no car {number}; the world has 1"):
                call(number)
    for action in (-1, 11, 14, 15, 10**6):
        assert not rules.legal(grid, 0, action)
        assert rules.apply(grid, 0, action).same_visible(grid)
