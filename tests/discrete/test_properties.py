"""Laws that hold in every sane world, whatever the cars do."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from craftsim.discrete.grid import SECOND_PART, CarField, Kind, beside
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules

from .worldgen import MIRRORED_ACTIONS, TURNED_ACTIONS, mirrored, play, random_world, turned

PUBLISHED, PHYSICAL = Rules("published"), Rules("physical")
SEEDS = st.integers(0, 2**32 - 1)
PLENTY = settings(
    max_examples=40, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True
)


def count(grid):
    loads = grid.cars[:, CarField.LOAD]
    return [
        int((grid.kind == kind).sum() + (loads == kind).sum()) for kind in (Kind.BLOCK, Kind.FLAG)
    ] + [int(np.isin(grid.kind, (Kind.FSLOPE, Kind.BODY)).sum() + (loads == Kind.FSLOPE).sum())]


def is_quirky(before, after):
    """Whether a tick did what CraftEnv's rules let break the world: docs/rules.md, 'Things can vanish or overlap'."""
    feet = np.argwhere(after.kind == Kind.FOOT)
    cars = {tuple(row[:3]): row[CarField.SLOPE] for row in after.cars.tolist()}
    on_foot = any(cars.get(tuple(cell), 1) != 1 for cell in feet.tolist())
    gears = sum((grid.kind == Kind.GEAR).sum() for grid in (before, after))
    slopes = sum((grid.kind == Kind.FSLOPE).sum() for grid in (before, after))
    shared_gear = gears != slopes
    hanging = False
    for x, y, z in np.argwhere(after.kind == Kind.GEAR):
        hanging |= after.kind[x, y, z - 1] not in (Kind.GROUND, Kind.BLOCK)
    return on_foot or shared_gear or hanging


@PLENTY
@given(SEEDS)
def test_objects_are_conserved_and_cars_stand_apart_on_something(seed):
    rng = np.random.default_rng(seed)
    grid = random_world(rng)
    numbers = count(grid)
    for _, after in play(PHYSICAL, grid, rng, 25):
        if is_quirky(grid, after):
            return
        assert count(after) == numbers
        cells = [tuple(row[: CarField.Z + 1]) for row in after.cars.tolist()]
        assert len(set(cells)) == len(cells)
        for car, (x, y, z) in enumerate(cells):
            below = after.kind[x, y, z - 1]
            assert below in {2: (Kind.BODY,)}.get(
                after.cars[car, CarField.SLOPE], (Kind.GROUND, Kind.BLOCK)
            )
        for kind, second in SECOND_PART.items():
            for cell in np.argwhere(after.kind == kind).tolist():
                other = beside(tuple(cell), after.yaw[tuple(cell)])
                assert after.kind[other] == second
        assert not np.any(after.kind[:, :, 0] != Kind.GROUND)
        grid = after


@pytest.mark.parametrize("rules", [PUBLISHED, PHYSICAL], ids=["published", "physical"])
@pytest.mark.parametrize(
    ("change", "names"),
    [(mirrored, MIRRORED_ACTIONS), (turned, TURNED_ACTIONS)],
    ids=["mirrored", "turned"],
)
@PLENTY
@given(SEEDS)
def test_changed_worlds_give_changed_masks_and_effects(rules, change, names, seed):
    rng = np.random.default_rng(seed)
    grid = random_world(rng)
    for joint, after in play(rules, grid, rng, 15):
        assert np.array_equal(rules.mask(change(grid))[:, names[:11]], rules.mask(grid)[:, :11])
        changed, _ = rules.tick(change(grid), [(car, int(names[action])) for car, action in joint])
        assert changed.same_visible(change(after))
        assert changed.same_marks(change(after))
        grid = after


@PLENTY
@given(SEEDS)
def test_applied_means_legal_at_its_turn_and_the_illegal_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    grid = random_world(rng)
    for joint, _ in play(PUBLISHED, grid, rng, 5, eager=False):
        for car, action in joint:
            legal = PUBLISHED.legal(grid, car, action)
            after, applied = PUBLISHED.tick(grid, [(car, action)])
            assert applied[0] == legal
            if not legal:
                assert after.same_visible(grid)
                assert after.same_marks(grid)
            grid = after


UNDOES = {
    Action.LIFT: Action.DROP,
    Action.UNFOLD: Action.FOLD,
    Action.FOLD: Action.UNFOLD,
    Action.ROTATE_LEFT: Action.ROTATE_RIGHT,
    Action.ROTATE_RIGHT: Action.ROTATE_LEFT,
}


@PLENTY
@given(SEEDS)
def test_what_undoes_an_action_is_legal_after_it_and_brings_the_world_back(seed):
    rng = np.random.default_rng(seed)
    grid = random_world(rng)
    for _, after in play(PHYSICAL, grid, rng, 15):
        if is_quirky(grid, after):
            return
        grid = after
        for car, action in np.argwhere(PHYSICAL.mask(grid)).tolist():
            if action in UNDOES:
                done, applied = PHYSICAL.tick(grid, [(car, action), (car, UNDOES[Action(action)])])
                assert applied.all(), (car, Action(action).name)
                assert done.same_visible(grid)


@PLENTY
@given(SEEDS)
def test_a_plan_leads_step_by_legal_step_to_the_cell_asked_for(seed):
    rng = np.random.default_rng(seed)
    grid = random_world(rng)
    grid = list(play(PHYSICAL, grid, rng, 5))[-1][1]
    reachable, legal = PHYSICAL.reachable(grid, 12), PHYSICAL.mask(grid)
    assert (reachable >= legal).all()
    assert np.array_equal(np.delete(reachable, range(6, 10), 1), np.delete(legal, range(6, 10), 1))
    for car in range(grid.n_cars):
        for action, (dx, dy) in {6: (0, 1), 7: (0, -1), 8: (-1, 0), 9: (1, 0)}.items():
            plan = PHYSICAL.plan_move(grid, car, action, 12)
            assert reachable[car, action] == (plan is not None)
            if plan is None:
                continue
            assert len(plan) <= 13
            if legal[car, action]:
                assert plan == (action,)
            walker = grid
            for step in plan:
                walker, applied = PHYSICAL.tick(walker, [(car, step)])
                assert applied[0]
            assert walker.cars[car, :2].tolist() == [grid.cars[car, 0] + dx, grid.cars[car, 1] + dy]


@pytest.mark.parametrize("rules", [PUBLISHED, PHYSICAL], ids=["published", "physical"])
@PLENTY
@given(SEEDS)
def test_the_same_actions_give_the_same_worlds_again(rules, seed):
    rng = np.random.default_rng(seed)
    start = random_world(rng)
    episode = list(play(rules, start, rng, 15, eager=False))
    grid = start
    for joint, after in episode:
        grid, _ = rules.tick(grid, joint)
        assert grid.same_visible(after)
        assert grid.same_marks(after)
