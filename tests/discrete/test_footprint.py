"""What an action needs of the world while it runs."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from craftsim.discrete.actions import footprint
from craftsim.discrete.footprint import Footprint
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule

from .worldgen import play, random_world

RULES = Rules("physical")
PLENTY = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
RIGHT = Action.MOVE_RIGHT


def needs(grid, car, action):
    assert RULES.legal(grid, car, action), f"the rules forbid {action.name} here"
    return footprint(grid, RULES.apply(grid, car, action), car, action)


def random_steps(seed, ticks=8):
    rng = np.random.default_rng(seed)
    grid = random_world(rng)
    return make_schedule(grid, [joint for joint, _ in play(RULES, grid, rng, ticks)], RULES).steps


@PLENTY
@given(st.integers(0, 2**32 - 1))
def test_whether_two_actions_conflict_does_not_depend_on_who_is_asked(seed):
    for a, b in combinations(random_steps(seed), 2):
        assert a.footprint.conflicts(b.footprint) == b.footprint.conflicts(a.footprint)


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
def test_a_footprint_stays_within_two_cells_of_its_car(seed):
    for step in random_steps(seed):
        own = step.before.cars[step.car, : CarField.Z + 1]
        parts = step.footprint
        cells = parts.space | parts.changes | parts.relies | parts.loads
        assert max(np.abs(np.array(list(cells)) - own).max(axis=1)) <= 2, step


@pytest.mark.parametrize(
    ("mine", "theirs", "expected"),
    [
        ({"space": (1, 1, 1)}, {"space": (1, 1, 1)}, True),
        ({"changes": (1, 1, 1)}, {"changes": (1, 1, 1)}, True),
        ({"changes": (1, 1, 1)}, {"relies": (1, 1, 1)}, True),
        ({"relies": (1, 1, 1)}, {"relies": (1, 1, 1)}, False),
        ({"loads": (1, 1, 1)}, {"loads": (1, 2, 1)}, True),
        ({"loads": (1, 1, 1)}, {"loads": (2, 2, 1)}, False),
        ({"loads": (1, 1, 1)}, {"loads": (1, 2, 2)}, False),
        ({"space": (1, 1, 1)}, {"space": (1, 2, 1)}, False),
        ({"space": (1, 1, 1)}, {"changes": (1, 1, 1)}, False),
    ],
)
def test_each_reason_for_a_conflict_is_enough_alone(mine, theirs, expected):
    def only(**part):
        return Footprint(
            *(frozenset([part[f]] if f in part else []) for f in ("space", "changes", "relies", "loads"))
        )

    assert only(**mine).conflicts(only(**theirs)) is expected
    assert only(**theirs).conflicts(only(**mine)) is expected


SITUATIONS = {
    "bare": ([], {}),
    "under a block": ([(Kind.BLOCK, (2, 2, 1))], {}),
    "under a folded slope": ([(Kind.FSLOPE, (2, 2, 1), 2)], {}),
    "under a ramp": ([(Kind.BODY, (2, 2, 1), 2)], {}),
    "loaded with a block": ([], {"load": Kind.BLOCK}),
    "loaded with a slope": ([], {"load": Kind.FSLOPE}),
}


@pytest.mark.parametrize("situation", SITUATIONS)
def test_cars_in_distant_places_never_wait_for_each_other(scene, car, situation):
    objects, load = SITUATIONS[situation]
    far = [(kind, (cell[0] + 5, *cell[1:]), *yaw) for kind, cell, *yaw in objects]
    grid = scene([*objects, *far], [car(2, 2, **load), car(7, 2, **load)], size=(10, 5, 3))
    legal = [action for action in Action if RULES.legal(grid, 0, action)]
    assert len(legal) > 1
    for mine in legal:
        for theirs in legal:
            assert not needs(grid, 0, mine).conflicts(needs(grid, 1, theirs)), (mine.name, theirs.name)


def test_loads_that_pass_side_by_side_conflict_and_bare_cars_do_not(scene, car):
    for loads, expected in (
        ((Kind.BLOCK, Kind.BLOCK), True),
        ((Kind.FLAG, Kind.BLOCK), True),
        ((Kind.BLOCK, Kind.AIR), False),
        ((Kind.AIR, Kind.AIR), False),
    ):
        grid = scene([], [car(1, 1, load=loads[0]), car(1, 2, load=loads[1])])
        assert needs(grid, 0, RIGHT).conflicts(needs(grid, 1, RIGHT)) is expected, loads
    apart = scene([], [car(1, 1, load=Kind.BLOCK), car(1, 3, load=Kind.BLOCK)])
    assert not needs(apart, 0, RIGHT).conflicts(needs(apart, 1, RIGHT))


def test_a_car_above_a_block_conflicts_with_who_lifts_it_and_not_with_who_drives_under_it(scene, car):
    blocks = [(Kind.BLOCK, (x, 1, 1)) for x in (1, 2)]
    on_top = needs(scene(blocks, [car(1, 1, 2), car(5, 5)]), 0, RIGHT)
    lifting = needs(scene(blocks, [car(5, 5), car(2, 1)]), 1, Action.LIFT)
    passing = needs(scene(blocks, [car(5, 5), car(1, 1)]), 1, RIGHT)
    assert on_top.conflicts(lifting)
    assert not on_top.conflicts(passing)


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
