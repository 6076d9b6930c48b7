"""Moves, marks and corrections of the rules in drawn worlds; what else is legal is recorded: test_conformance."""

import json
from pathlib import Path

import numpy as np
import pytest

from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action, Correction
from craftsim.discrete.rules import Rules

from .conftest import recorded_world

PUBLISHED, PHYSICAL = Rules("published"), Rules("physical")
BLOCK, FSLOPE, GEAR, BODY, FOOT = Kind.BLOCK, Kind.FSLOPE, Kind.GEAR, Kind.BODY, Kind.FOOT
RIGHT, LEFT = Action.MOVE_RIGHT, Action.MOVE_LEFT
RAMP = [(BODY, (3, 3, 1), 2), (BLOCK, (4, 3, 1))]
"""A ramp that is climbed in direction +x: foot at (2, 3), landing on the block at (4, 3)."""
FALLING_RAMP = [(BLOCK, (1, 3, 1)), (BODY, (2, 3, 1), 0)]
"""A ramp that falls in +x from the block at (1, 3) to its foot at (3, 3)."""
LINES = (Path(__file__).parents[1] / "data" / "corrections.jsonl").read_text().splitlines()
EXAMPLES = [json.loads(line) for line in LINES]
"""Worlds, each with an action, whether each rule set allows it, and the correction that forbids it."""


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
            states.append(
                [int(grid.cars[0, field]) for field in (CarField.X, CarField.Z, CarField.SLOPE)]
            )
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
    for order, applied_in_order, places in (
        ((1, 0), [True, True], [4, 5]),
        ((0, 1), [False, True], [3, 5]),
    ):
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


def test_the_stale_mark_of_a_gear_forbids_a_lift_for_published_only(scene, car):
    objects = [(BLOCK, (3, 3, 1)), (BLOCK, (2, 3, 1)), (BLOCK, (4, 3, 1)), (FSLOPE, (2, 3, 2), 0)]
    grid = scene(objects, [car(3, 3, 2), car(2, 3, 2, yaw=2), car(3, 3, 1)])
    joint = [(0, Action.MOVE_RIGHT), (1, Action.LIFT)]
    for rules, free in ((PUBLISHED, False), (PHYSICAL, True)):
        after, applied = rules.tick(grid, joint)
        assert applied.all()
        assert rules.legal(after, 2, Action.LIFT) == free


def test_a_fold_unmarks_a_landing_that_another_ramp_still_leans_on(scene, car):
    grid = scene(
        [(BODY, (3, 3, 1), 0), (BLOCK, (2, 3, 1)), (BODY, (2, 4, 1), 1)], [car(3, 3, yaw=2)]
    )
    assert not PUBLISHED.apply(grid, 0, Action.FOLD).landing[2, 3, 1]
    assert PHYSICAL.apply(grid, 0, Action.FOLD).landing[2, 3, 1]


def test_unfolding_onto_a_car_hides_it_from_the_marks(scene, car):
    grid = scene([(FSLOPE, (3, 3, 1), 0), (BLOCK, (2, 3, 1))], [car(3, 3, yaw=2), car(4, 3)])
    assert PUBLISHED.apply(grid, 0, Action.UNFOLD).occupant[4, 3, 0] == -2
    assert PHYSICAL.apply(grid, 0, Action.UNFOLD).occupant[4, 3, 0] == 1


def test_physical_ignores_wrong_marks_and_leaves_derived_ones(scene, car, rng):
    grid = scene([(BLOCK, (3, 3, 1)), (BODY, (3, 4, 1), 1)], [car(3, 3), car(1, 1)])
    wrong = grid.copy()
    wrong.occupant[:] = rng.integers(-2, 2, wrong.occupant.shape)
    wrong.landing[:] = rng.integers(0, 2, wrong.landing.shape)
    assert np.array_equal(PHYSICAL.mask(grid), PHYSICAL.mask(wrong))
    after = PHYSICAL.apply(wrong, 0, Action.LIFT)
    derived = after.copy()
    derived.derive_marks()
    assert after.same_marks(derived)


def test_physical_forbids_what_published_allows_because_of_one_correction_alone():
    for example in EXAMPLES:
        grid, car, action = recorded_world(example), example["car"], Action[example["action"]]
        assert PUBLISHED.legal(grid, car, action) == example["published"], example
        assert PHYSICAL.legal(grid, car, action) == example["physical"], example
        if "correction" in example:
            assert Rules("physical", ~Correction[example["correction"]]).legal(grid, car, action), (
                example
            )


def test_every_correction_that_forbids_something_has_a_law_and_its_bounds():
    shown = {example.get("correction") for example in EXAMPLES}
    effects = {"derived_marks", "second_ramp", "lasting_gears"}
    assert shown == {*Correction.__members__, None} - effects
    assert sum(example["physical"] for example in EXAMPLES) > 80


def test_from_a_top_onto_a_second_foot_a_car_is_on_the_second_ramp(scene, car):
    stairs = [(BODY, (4, 3, 1), 0), *[(BLOCK, (x, 3, 1)) for x in (1, 2, 3)], (BODY, (2, 3, 2), 0)]
    grid = scene([*stairs, (BLOCK, (1, 3, 2))], [car(4, 3, 2, yaw=2, slope=2)])
    for rules, slope in ((PUBLISHED, 0), (PHYSICAL, 1)):
        after = rules.apply(grid, 0, Action.MOVE_LEFT)
        assert after.cars[0, [CarField.X, CarField.Z, CarField.SLOPE]].tolist() == [3, 2, slope]


def test_a_gear_lasts_as_long_as_its_slope_and_gives_way_to_what_stands(scene, car):
    facing = [(FSLOPE, (1, 3, 1), 0), (FSLOPE, (3, 3, 1), 2)]
    grid = scene(facing, [car(3, 3)])
    lifted = {rules.rule_set: rules.apply(grid, 0, Action.LIFT) for rules in (PUBLISHED, PHYSICAL)}
    assert lifted["published"].kind[2, 3, 1] == Kind.AIR
    assert (lifted["physical"].kind[2, 3, 1], lifted["physical"].yaw[2, 3, 1]) == (GEAR, 0)
    for yaw, rules in ((2, PUBLISHED), (0, PHYSICAL)):
        assert rules.apply(lifted["physical"], 0, Action.DROP).yaw[2, 3, 1] == yaw
    alone = PHYSICAL.apply(scene([(FSLOPE, (3, 3, 1), 2)], [car(3, 3)]), 0, Action.LIFT)
    assert not (alone.kind == GEAR).any()
    behind_ramp = scene(FALLING_RAMP, [car(4, 3, yaw=0, load=FSLOPE)])
    assert PUBLISHED.apply(behind_ramp, 0, Action.DROP).kind[3, 3, 1] == GEAR
    assert PHYSICAL.apply(behind_ramp, 0, Action.DROP).kind[3, 3, 1] == FOOT
