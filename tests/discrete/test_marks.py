"""The published rule set keeps its marks by events, drift included; the physical one always derives them."""

import numpy as np

from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules

PUBLISHED, PHYSICAL = Rules("published"), Rules("physical")
BLOCK, FSLOPE, BODY = Kind.BLOCK, Kind.FSLOPE, Kind.BODY


def test_leaving_a_gears_cell_marks_what_is_below_though_a_gear_is_no_object(scene, car):
    grid = scene([(FSLOPE, (2, 3, 1), 0)], [car(3, 3)])
    after = PUBLISHED.apply(grid, 0, Action.MOVE_RIGHT)
    assert after.occupant[3, 3, 0] == -2
    assert PHYSICAL.apply(grid, 0, Action.MOVE_RIGHT).occupant[3, 3, 0] == -1


def test_the_stale_mark_of_a_gear_forbids_a_lift_for_published_only(scene, car):
    objects = [(BLOCK, (3, 3, 1)), (BLOCK, (2, 3, 1)), (BLOCK, (4, 3, 1)), (FSLOPE, (2, 3, 2), 0)]
    grid = scene(objects, [car(3, 3, 2), car(2, 3, 2, yaw=2), car(3, 3, 1)])
    joint = [(0, Action.MOVE_RIGHT), (1, Action.LIFT)]
    for rules, free in ((PUBLISHED, False), (PHYSICAL, True)):
        after, applied = rules.tick(grid, joint)
        assert applied.all()
        assert rules.legal(after, 2, Action.LIFT) == free


def test_leaving_air_or_an_object_marks_nothing_or_object_and_arriving_marks_the_car(scene, car):
    grid = scene([(BLOCK, (3, 3, 1))], [car(3, 3)])
    after = PUBLISHED.apply(grid, 0, Action.MOVE_RIGHT)
    assert (after.occupant[3, 3, 0], after.occupant[4, 3, 0]) == (-2, 0)
    back = PUBLISHED.apply(PUBLISHED.apply(grid, 0, Action.LIFT), 0, Action.MOVE_LEFT)
    assert (back.occupant[3, 3, 0], back.occupant[2, 3, 0]) == (-1, 0)


def test_unfold_and_fold_mark_the_ground_below_the_foot_and_the_landing(scene, car):
    grid = scene([(FSLOPE, (3, 3, 1), 0), (BLOCK, (2, 3, 1))], [car(3, 3, yaw=2)])
    unfolded = PUBLISHED.apply(grid, 0, Action.UNFOLD)
    assert unfolded.occupant[4, 3, 0] == -2
    assert unfolded.landing[2, 3, 1]
    folded = PUBLISHED.apply(unfolded, 0, Action.FOLD)
    assert folded.occupant[4, 3, 0] == -1
    assert not folded.landing[2, 3, 1]


def test_a_fold_unmarks_a_landing_that_another_ramp_still_leans_on(scene, car):
    grid = scene([(BODY, (3, 3, 1), 0), (BLOCK, (2, 3, 1)), (BODY, (2, 4, 1), 1)], [car(3, 3, yaw=2)])
    assert not PUBLISHED.apply(grid, 0, Action.FOLD).landing[2, 3, 1]
    assert PHYSICAL.apply(grid, 0, Action.FOLD).landing[2, 3, 1]


def test_a_block_dropped_behind_a_body_is_marked_as_its_landing(scene, car):
    grid = scene([(BODY, (3, 3, 1), 0)], [car(2, 3, load=BLOCK)])
    dropped = PUBLISHED.apply(grid, 0, Action.DROP)
    assert dropped.landing[2, 3, 1]
    assert not PUBLISHED.apply(dropped, 0, Action.LIFT).landing[2, 3, 1]


def test_unfolding_onto_a_car_hides_it_from_the_marks(scene, car):
    grid = scene([(FSLOPE, (3, 3, 1), 0), (BLOCK, (2, 3, 1))], [car(3, 3, yaw=2), car(4, 3)])
    assert PUBLISHED.apply(grid, 0, Action.UNFOLD).occupant[4, 3, 0] == -2
    assert PHYSICAL.apply(grid, 0, Action.UNFOLD).occupant[4, 3, 0] == 1


def test_a_newcomer_starts_with_blank_marks(scene, car):
    grid = scene([(BLOCK, (3, 3, 1))], [car(3, 3)])
    grid.occupant[3, 3, 1] = -1
    grid.landing[3, 3, 1] = True
    lifted = PUBLISHED.apply(grid, 0, Action.LIFT)
    assert lifted.occupant[3, 3, 1] == -1
    assert not lifted.landing.any()


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


def test_lifting_one_of_two_slopes_with_a_common_gear_cell_empties_it(scene, car):
    grid = scene([(FSLOPE, (2, 3, 1), 0), (FSLOPE, (4, 3, 1), 2)], [car(4, 3, yaw=0)])
    assert PUBLISHED.apply(grid, 0, Action.LIFT).kind[3, 3, 1] == Kind.AIR


def test_a_drop_replaces_what_is_in_the_cell(scene, car):
    grid = scene([(BODY, (3, 3, 1), 2)], [car(2, 3, load=BLOCK)])
    assert PUBLISHED.apply(grid, 0, Action.DROP).kind[2, 3, 1] == BLOCK
