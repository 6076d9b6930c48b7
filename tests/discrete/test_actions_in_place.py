"""LIFT, DROP, FOLD, UNFOLD, turns and STOP: when they are legal, and what they change."""

import numpy as np
import pytest

from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules

BOTH = pytest.mark.parametrize(
    "rules", [Rules("published"), Rules("physical")], ids=["published", "physical"]
)
BLOCK, FLAG, FSLOPE, GEAR, BODY, FOOT, WALL = (
    Kind.BLOCK,
    Kind.FLAG,
    Kind.FSLOPE,
    Kind.GEAR,
    Kind.BODY,
    Kind.FOOT,
    Kind.WALL,
)


@BOTH
@pytest.mark.parametrize("kind", [BLOCK, FLAG])
def test_lift_takes_what_is_in_the_own_cell_and_drop_puts_it_back(rules, scene, car, kind):
    start = scene([(kind, (3, 3, 1))], [car(3, 3)])
    lifted = rules.apply(start, 0, Action.LIFT)
    assert lifted.kind[3, 3, 1] == Kind.AIR
    assert lifted.cars[0, CarField.LOAD] == kind
    assert rules.apply(lifted, 0, Action.DROP).same_visible(start)


@BOTH
def test_lift_takes_a_folded_slope_with_its_gear_and_drop_puts_both_back(rules, scene, car):
    start = scene([(FSLOPE, (3, 3, 1), 2)], [car(3, 3, yaw=0)])
    lifted = rules.apply(start, 0, Action.LIFT)
    assert not np.isin(lifted.kind, (FSLOPE, GEAR)).any()
    assert lifted.cars[0, CarField.LOAD_YAW] == 2
    assert rules.apply(lifted, 0, Action.DROP).same_visible(start)


@BOTH
@pytest.mark.parametrize("own", [None, GEAR, WALL, BODY, FOOT])
def test_lift_needs_something_that_can_be_lifted(rules, scene, car, own):
    objects = [(own, (3, 3, 1), 2)] if own else []
    assert not rules.legal(scene(objects, [car(3, 3)]), 0, Action.LIFT)


@BOTH
@pytest.mark.parametrize("above", [BLOCK, FLAG])
def test_lift_needs_nothing_on_top(rules, scene, car, above):
    assert not rules.legal(scene([(BLOCK, (3, 3, 1)), (above, (3, 3, 2))], [car(3, 3)]), 0, Action.LIFT)


@BOTH
def test_lift_needs_no_car_on_top(rules, scene, car):
    assert not rules.legal(scene([(BLOCK, (3, 3, 1))], [car(3, 3), car(3, 3, 2)]), 0, Action.LIFT)


@BOTH
def test_lift_of_a_block_under_a_gear_is_legal(rules, scene, car):
    grid = scene([(BLOCK, (3, 3, 1)), (BLOCK, (2, 3, 1)), (FSLOPE, (2, 3, 2), 0)], [car(3, 3)])
    assert rules.legal(grid, 0, Action.LIFT)


@BOTH
def test_a_loaded_car_can_drop_but_not_lift_fold_or_unfold(rules, scene, car):
    mask = rules.mask(scene([], [car(3, 3, load=BLOCK)]))[0]
    assert mask[Action.DROP]
    assert not mask[[Action.LIFT, Action.FOLD, Action.UNFOLD]].any()


@BOTH
def test_an_empty_car_cannot_drop(rules, scene, car):
    assert not rules.legal(scene([], [car(3, 3)]), 0, Action.DROP)


@BOTH
def test_nothing_can_be_dropped_above_the_top_level(rules, scene, car):
    tower = [(BLOCK, (3, 3, 1)), (BLOCK, (3, 3, 2))]
    assert not rules.legal(scene(tower, [car(3, 3, 3, load=BLOCK)], size=(7, 7, 2)), 0, Action.DROP)
    assert rules.legal(scene(tower, [car(3, 3, 3, load=BLOCK)], size=(7, 7, 3)), 0, Action.DROP)


@BOTH
@pytest.mark.parametrize("yaw", range(4))
def test_unfold_turns_slope_and_gear_into_body_and_foot_and_fold_turns_them_back(rules, scene, car, yaw):
    start = scene([(FSLOPE, (3, 3, 1), yaw)], [car(3, 3, yaw=(yaw + 2) % 4)])
    unfolded = rules.apply(start, 0, Action.UNFOLD)
    assert unfolded.same_visible(scene([(BODY, (3, 3, 1), yaw)], [car(3, 3, yaw=(yaw + 2) % 4)]))
    assert rules.apply(unfolded, 0, Action.FOLD).same_visible(start)


@BOTH
def test_unfold_needs_support_below_the_foot(rules, scene, car):
    high = [(BLOCK, (3, 3, 1)), (FSLOPE, (3, 3, 2), 0)]
    assert not rules.legal(scene(high, [car(3, 3, 2, yaw=2)]), 0, Action.UNFOLD)
    assert rules.legal(scene([*high, (BLOCK, (4, 3, 1))], [car(3, 3, 2, yaw=2)]), 0, Action.UNFOLD)


@BOTH
def test_unfold_needs_room_for_the_foot(rules, scene, car):
    grid = scene([(FSLOPE, (3, 3, 1), 0)], [car(3, 3, yaw=2)])
    assert rules.legal(grid, 0, Action.UNFOLD)
    for kind in (BLOCK, FLAG, WALL, FOOT, BODY, FSLOPE):
        grid.kind[4, 3, 1] = kind
        assert not rules.legal(grid, 0, Action.UNFOLD)


@BOTH
def test_no_ramp_is_unfolded_on_the_landing_of_another(rules, scene, car):
    for landing in ((3, 3, 1), (4, 3, 1)):
        below = [(BLOCK, (3, 3, 1)), (BLOCK, (4, 3, 1)), (BODY, (landing[0], 4, 1), 1)]
        grid = scene([*below, (FSLOPE, (3, 3, 2), 0)], [car(3, 3, 2, yaw=2)])
        assert not rules.legal(grid, 0, Action.UNFOLD)


@BOTH
def test_fold_needs_both_halves_of_the_ramp_free(rules, scene, car):
    ramp = [(BODY, (3, 3, 1), 0), (BLOCK, (2, 3, 1))]
    under = car(3, 3, yaw=2)
    assert rules.legal(scene(ramp, [under]), 0, Action.FOLD)
    assert not rules.legal(scene(ramp, [under, car(3, 3, 2, slope=2)]), 0, Action.FOLD)
    assert not rules.legal(scene(ramp, [under, car(4, 3, 1, slope=1)]), 0, Action.FOLD)
    assert not rules.legal(scene([(FSLOPE, (3, 3, 1), 0)], [under]), 0, Action.FOLD)


@BOTH
@pytest.mark.parametrize(("action", "turn"), [(Action.ROTATE_LEFT, 1), (Action.ROTATE_RIGHT, -1)])
@pytest.mark.parametrize("yaw", range(4))
def test_a_turn_changes_the_yaw_of_car_and_carried_slope(rules, scene, car, action, turn, yaw):
    after = rules.apply(scene([], [car(3, 3, yaw=yaw, load=FSLOPE)]), 0, action)
    assert after.cars[0, CarField.YAW] == (yaw + turn) % 4
    assert after.cars[0, CarField.LOAD_YAW] == (yaw + 2 + turn) % 4


TURNS = (Action.ROTATE_LEFT, Action.ROTATE_RIGHT)


@BOTH
def test_an_empty_car_turns_anywhere_but_under_a_slope(rules, scene, car):
    for kind, free in ((BLOCK, True), (FLAG, True), (FSLOPE, False), (BODY, False)):
        grid = scene([(kind, (3, 3, 1), 2)], [car(3, 3)])
        assert [rules.legal(grid, 0, turn) for turn in TURNS] == [free, free]


@BOTH
@pytest.mark.parametrize("direction", range(4))
def test_a_loaded_car_turns_only_with_its_four_neighbours_free(rules, scene, car, direction):
    dx, dy = ((1, 0), (0, 1), (-1, 0), (0, -1))[direction]
    beside = (3 + dx, 3 + dy, 1)
    for kind, yaw, free in (
        (BLOCK, 0, False),
        (WALL, 0, False),
        (GEAR, (direction + 2) % 4, True),
        (GEAR, direction, False),
        (GEAR, (direction + 1) % 4, False),
    ):
        grid = scene([(kind, beside, yaw)], [car(3, 3, load=BLOCK)])
        assert [rules.legal(grid, 0, turn) for turn in TURNS] == [free, free], (kind, yaw)
    for load, free in ((Kind.AIR, rules.rule_set == "published"), (BLOCK, False)):
        grid = scene([], [car(3, 3, load=BLOCK), car(beside[0], beside[1], load=load)])
        assert [rules.legal(grid, 0, turn) for turn in TURNS] == [free, free]


@BOTH
def test_a_loaded_car_does_not_turn_at_the_border(rules, scene, car):
    assert not rules.legal(scene([], [car(0, 3, load=BLOCK)]), 0, Action.ROTATE_LEFT)


@BOTH
def test_another_cars_carried_gear_stops_a_turn_unless_it_points_at_the_car(rules, scene, car):
    across = scene([], [car(3, 3, load=BLOCK), car(4, 2, yaw=3, load=FSLOPE)])
    assert not rules.legal(across, 0, Action.ROTATE_LEFT)
    pointing = scene([], [car(3, 3, load=BLOCK), car(5, 3, yaw=0, load=FSLOPE)])
    assert rules.legal(pointing, 0, Action.ROTATE_LEFT)


@BOTH
@pytest.mark.parametrize(
    ("yaw", "left", "right"),
    [(0, (2, 2), (2, 4)), (1, (4, 2), (2, 2)), (2, (4, 4), (4, 2)), (3, (2, 4), (4, 4))],
)
def test_a_carried_slope_needs_the_corner_that_its_gear_sweeps(rules, scene, car, yaw, left, right):
    grid = scene([], [car(3, 3, yaw=yaw, load=FSLOPE)])
    for corner, free_turns in ((left, [False, True]), (right, [True, False])):
        for kind, turns in ((BLOCK, free_turns), (GEAR, [True, True])):
            blocked = grid.copy()
            blocked.kind[(*corner, 1)] = kind
            assert [rules.legal(blocked, 0, turn) for turn in TURNS] == turns
        loaded = scene([], [car(3, 3, yaw=yaw, load=FSLOPE), car(*corner, load=BLOCK)])
        assert [rules.legal(loaded, 0, turn) for turn in TURNS] == free_turns


@BOTH
@pytest.mark.parametrize("slope", [1, 2])
def test_on_a_slope_nothing_but_the_forward_move_is_legal(rules, scene, car, slope):
    ramp = [(BODY, (3, 3, 1), 2), (BLOCK, (4, 3, 1))]
    here = car(2, 3, 1, slope=1) if slope == 1 else car(3, 3, 2, slope=2)
    mask = rules.mask(scene(ramp, [here]))[0]
    assert np.flatnonzero(mask).tolist() == [Action.MOVE_RIGHT]


@BOTH
def test_the_diagonal_moves_are_never_legal_and_stop_always_is_on_the_flat(rules, scene, car):
    mask = rules.mask(scene([], [car(3, 3)]))[0]
    assert mask[Action.STOP]
    assert not mask[11:].any()


@BOTH
@pytest.mark.parametrize("kind", [BLOCK, FLAG, FSLOPE])
def test_a_loaded_car_neither_lifts_nor_unfolds_what_is_in_its_cell(rules, scene, car, kind):
    mask = rules.mask(scene([(kind, (3, 3, 1), 2)], [car(3, 3, load=BLOCK)]))[0]
    assert not mask[[Action.LIFT, Action.UNFOLD]].any()


@BOTH
@pytest.mark.parametrize("kind", [None, BLOCK, FLAG, GEAR, BODY])
def test_only_a_folded_slope_is_unfolded(rules, scene, car, kind):
    objects = [(kind, (3, 3, 1), 2)] if kind else []
    assert not rules.legal(scene(objects, [car(3, 3)]), 0, Action.UNFOLD)


@BOTH
@pytest.mark.parametrize("kind", [BLOCK, FLAG])
def test_a_block_is_lifted_and_set_down_between_loads(rules, scene, car, kind):
    others = [car(x, y, load=BLOCK) for x, y in ((4, 3), (2, 3), (3, 4), (3, 2))]
    assert rules.legal(scene([(kind, (3, 3, 1))], [car(3, 3), *others]), 0, Action.LIFT)
    assert rules.legal(scene([], [car(3, 3, load=kind), *others]), 0, Action.DROP)


@BOTH
@pytest.mark.parametrize("load", [BLOCK, FLAG])
def test_a_block_turns_whatever_stands_at_the_corners(rules, scene, car, load):
    corners = [(x, y) for x in (2, 4) for y in (2, 4)]
    things = scene([(BLOCK, (*corner, 1)) for corner in corners], [car(3, 3, load=load)])
    loads = scene([], [car(3, 3, load=load), *(car(*corner, load=BLOCK) for corner in corners)])
    assert [rules.legal(grid, 0, turn) for grid in (things, loads) for turn in TURNS] == [True] * 4


@BOTH
@pytest.mark.parametrize("load", [BLOCK, FLAG, FSLOPE])
def test_a_load_turns_whatever_is_carried_elsewhere(rules, scene, car, load):
    grid = scene([], [car(3, 3, load=load), car(6, 6, load=FSLOPE), car(1, 6, yaw=1, load=FSLOPE)])
    assert [rules.legal(grid, 0, turn) for turn in TURNS] == [True, True]
