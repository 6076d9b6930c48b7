"""What an action needs of the world while it runs."""

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from craftsim.discrete.actions import footprint
from craftsim.discrete.footprint import Footprint
from craftsim.discrete.grid import CarField, Kind
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


def random_steps(seed, ticks=8):
    rng = np.random.default_rng(seed)
    grid = random_world(rng)
    return make_schedule(grid, [joint for joint, _ in play(RULES, grid, rng, ticks)], RULES).steps


@PLENTY
@given(st.integers(0, 2**32 - 1))
def test_what_an_action_changes_on_the_grid_is_in_its_footprint(seed):
    for step in random_steps(seed):
        before, after, own = step.before, step.after, step.footprint
        changed = np.argwhere((before.kind != after.kind) | (before.yaw != after.yaw))
        assert {tuple(cell) for cell in changed.tolist()} <= own.changes
        for grid in (before, after):
            x, y, z = (int(v) for v in grid.cars[step.car, : CarField.Z + 1])
            assert (x, y, z) in own.space
            assert (x, y, z - 1) in own.relies


@PLENTY
@given(st.integers(0, 2**32 - 1))
def test_a_footprint_stays_within_three_cells_of_its_car(seed):
    for step in random_steps(seed):
        own = step.before.cars[step.car, : CarField.Z + 1]
        parts = step.footprint
        cells = parts.space | parts.changes | parts.relies | parts.loads
        assert max(np.abs(np.array(list(cells)) - own).max(axis=1)) <= 3, step


def test_each_reason_for_a_conflict_is_enough_alone():
    def only(**part):
        names = ("space", "changes", "relies", "loads")
        return Footprint(*(frozenset([part[name]] if name in part else []) for name in names))

    here, beside, apart, above = (1, 1, 1), (1, 2, 1), (2, 2, 1), (1, 2, 2)
    for mine, theirs, expected in (
        ({"space": here}, {"space": here}, True),
        ({"changes": here}, {"changes": here}, True),
        ({"changes": here}, {"relies": here}, True),
        ({"relies": here}, {"relies": here}, False),
        ({"loads": here}, {"loads": beside}, True),
        ({"loads": here}, {"loads": apart}, False),
        ({"loads": here}, {"loads": above}, False),
        ({"space": here}, {"space": beside}, False),
        ({"space": here}, {"changes": here}, False),
    ):
        for one, other in ((only(**mine), only(**theirs)), (only(**theirs), only(**mine))):
            assert conflict(one, other) is expected, (mine, theirs)
            claims, others = one.claims(), other.claims()
            found = any(claims_conflict(claims, len(claims), *row) for row in others.tolist())
            assert found is expected


def test_a_flap_needs_the_columns_of_body_and_foot_and_the_cell_beyond(scene, car):
    for kind, action in ((Kind.FSLOPE, Action.UNFOLD), (Kind.BODY, Action.FOLD)):
        grid = scene([(kind, (4, 2, 1), 2)], [car(4, 2)], size=(7, 5, 4))
        own = needs(grid, 0, action)
        swing = {(x, 2, z) for x in (4, 3) for z in (1, 2, 3)} | {(2, 2, 1)}
        assert own.space == swing
        assert own.changes == {(4, 2, 1), (3, 2, 1)}
        assert (3, 2, 0) in own.relies


def test_a_turning_load_needs_its_neighbours_and_a_turning_slope_the_corners_too(scene, car):
    cross = {(2, 2, 1), (1, 2, 1), (3, 2, 1), (2, 1, 1), (2, 3, 1)}
    corners = {(x, y, 1) for x in (1, 3) for y in (1, 3)}
    bare, block, slope = (
        needs(scene([], [car(2, 2, load=load)]), 0, Action.ROTATE_LEFT)
        for load in (Kind.AIR, Kind.BLOCK, Kind.FSLOPE)
    )
    assert bare.space == {(2, 2, 1)}
    assert block.loads == cross
    assert slope.loads == cross | corners
    # A lifted load reaches into the level above.
    assert {(x, y, 2) for x, y, _ in cross} <= block.space
