"""The published rule set keeps its marks by events, drift included; the physical one always derives them."""

import numpy as np

from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules

PUBLISHED, PHYSICAL = Rules("published"), Rules("physical")
BLOCK, FSLOPE, BODY = Kind.BLOCK, Kind.FSLOPE, Kind.BODY


def test_the_stale_mark_of_a_gear_forbids_a_lift_for_published_only(scene, car):
    objects = [(BLOCK, (3, 3, 1)), (BLOCK, (2, 3, 1)), (BLOCK, (4, 3, 1)), (FSLOPE, (2, 3, 2), 0)]
    grid = scene(objects, [car(3, 3, 2), car(2, 3, 2, yaw=2), car(3, 3, 1)])
    joint = [(0, Action.MOVE_RIGHT), (1, Action.LIFT)]
    for rules, free in ((PUBLISHED, False), (PHYSICAL, True)):
        after, applied = rules.tick(grid, joint)
        assert applied.all()
        assert rules.legal(after, 2, Action.LIFT) == free


def test_a_fold_unmarks_a_landing_that_another_ramp_still_leans_on(scene, car):
    grid = scene([(BODY, (3, 3, 1), 0), (BLOCK, (2, 3, 1)), (BODY, (2, 4, 1), 1)], [car(3, 3, yaw=2)])
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
