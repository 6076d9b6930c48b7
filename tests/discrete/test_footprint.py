"""What an action needs of the world while it runs."""

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from craftsim.discrete.actions import claims_of, footprint
from craftsim.discrete.grid import Kind, cell_of
from craftsim.discrete.kernel.claims import CHANGES, LOADS, RELIES, SPACE
from craftsim.discrete.kernel.claims import conflict as claims_conflict
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule

from .worldgen import conflict, play, random_world

RULES = Rules("physical")
PLENTY = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)


def needs(grid, car, action):
    assert RULES.legal(grid, car, action), f"the rules forbid {action.name} here"
    return footprint(grid, RULES.apply(grid, car, action), car, action)


def cells_of(needs, bit):
    return {cell for cell, bits in needs.items() if bits & bit}


def random_steps(seed, ticks=8):
    rng = np.random.default_rng(seed)
    grid = random_world(rng)
    return make_schedule(grid, [joint for joint, _ in play(RULES, grid, rng, ticks)], RULES).steps


@PLENTY
@given(st.integers(0, 2**32 - 1))
def test_what_an_action_changes_on_the_grid_is_in_its_footprint_within_three_cells_of_its_car(seed):
    for step in random_steps(seed):
        before, after, own = step.before, step.after, step.footprint
        changed = np.argwhere((before.kind != after.kind) | (before.yaw != after.yaw))
        assert {tuple(cell) for cell in changed.tolist()} <= cells_of(own, CHANGES)
        for x, y, z in (cell_of(before, step.car), cell_of(after, step.car)):
            assert own[x, y, z] & SPACE
            assert own[x, y, z - 1] & RELIES
        assert np.abs(np.array(list(own)) - cell_of(before, step.car)).max() <= 3, step


def test_each_reason_for_a_conflict_is_enough_alone():
    here, beside, apart, above = (1, 1, 1), (1, 2, 1), (2, 2, 1), (1, 2, 2)
    for mine, theirs, expected in (
        ({here: SPACE}, {here: SPACE}, True),
        ({here: CHANGES}, {here: CHANGES}, True),
        ({here: CHANGES}, {here: RELIES}, True),
        ({here: RELIES}, {here: RELIES}, False),
        ({here: LOADS}, {beside: LOADS}, True),
        ({here: LOADS}, {apart: LOADS}, False),
        ({here: LOADS}, {above: LOADS}, False),
        ({here: SPACE}, {beside: SPACE}, False),
        ({here: SPACE}, {here: CHANGES}, False),
    ):
        for one, other in ((mine, theirs), (theirs, mine)):
            assert conflict(one, other) is expected, (mine, theirs)
            claims = claims_of(one)
            found = any(claims_conflict(claims, len(claims), *row) for row in claims_of(other).tolist())
            assert found is expected


def test_a_flap_needs_the_columns_of_body_and_foot_and_the_cell_beyond(scene, car):
    for kind, action in ((Kind.FSLOPE, Action.UNFOLD), (Kind.BODY, Action.FOLD)):
        grid = scene([(kind, (4, 2, 1), 2)], [car(4, 2)], size=(7, 5, 4))
        own = needs(grid, 0, action)
        swing = {(x, 2, z) for x in (4, 3) for z in (1, 2, 3)} | {(2, 2, 1)}
        assert cells_of(own, SPACE) == swing
        assert cells_of(own, CHANGES) == {(4, 2, 1), (3, 2, 1)}
        assert own[3, 2, 0] & RELIES


def test_a_turning_load_needs_its_neighbours_and_a_turning_slope_the_corners_too(scene, car):
    cross = {(2, 2, 1), (1, 2, 1), (3, 2, 1), (2, 1, 1), (2, 3, 1)}
    corners = {(x, y, 1) for x in (1, 3) for y in (1, 3)}
    bare, block, slope = (
        needs(scene([], [car(2, 2, load=load)]), 0, Action.ROTATE_LEFT)
        for load in (Kind.AIR, Kind.BLOCK, Kind.FSLOPE)
    )
    assert cells_of(bare, SPACE) == {(2, 2, 1)}
    assert cells_of(block, LOADS) == cross
    assert cells_of(slope, LOADS) == cross | corners
    # A lifted load reaches into the level above.
    assert {(x, y, 2) for x, y, _ in cross} <= cells_of(block, SPACE)
