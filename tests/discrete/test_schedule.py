"""Which action waits for which: enough for the same end in any order that respects it, and no more than needed."""

import itertools
from typing import get_args

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from craftsim.discrete.actions import footprint
from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.geometry import INCLINE_RAD
from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Concurrency, make_schedule
from craftsim.discrete.tasks import make_task

from .conftest import make_scene
from .worldgen import conflict, play, random_world

RULES = Rules("physical")
SEEDS = st.integers(0, 2**32 - 1)
PLENTY = settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
FORWARD, BACK, LEFT, RIGHT = Action.MOVE_FORWARD, Action.MOVE_BACK, Action.MOVE_LEFT, Action.MOVE_RIGHT


def waits(grid, *joint, order="concurrent"):
    """Return for each action of one tick the actions before it that it waits for; all must be legal."""
    schedule = make_schedule(grid, [joint], RULES, order)
    assert schedule.forbidden == ()
    return [set(step.waits_for) for step in schedule.steps]


def crowd(rng):
    """Return a small yard full of cars, some loaded, and things: what one does is near what others do."""
    length, width = (int(n) for n in rng.integers(3, 6, 2))
    cells = rng.permutation(length * width)
    grid = make_scene(size=(length, width, 3), cars=[{} for _ in range(int(rng.integers(2, 5)))])
    n_blocks = int(rng.integers(0, 6))
    for cell in cells[:n_blocks]:
        grid.kind[cell // width, cell % width, 1] = Kind.BLOCK
    loads = [Kind.AIR, Kind.AIR, Kind.BLOCK]
    for row, cell in zip(grid.cars, cells[n_blocks:], strict=False):
        row[: CarField.LOAD_YAW] = cell // width, cell % width, 1, rng.integers(4), rng.choice(loads)
    used = {tuple(row[:2]) for row in grid.cars.tolist()}
    for x in range(length):
        for y in range(width):
            down = int(rng.integers(4))
            dx, dy = [(1, 0), (0, 1), (-1, 0), (0, -1)][down]
            inside = 0 <= x + dx < length and 0 <= y + dy < width
            if not inside or used & {(x, y), (x + dx, y + dy)}:
                continue
            if (
                grid.kind[x, y, 1] != Kind.AIR
                or grid.kind[x + dx, y + dy, 1] != Kind.AIR
                or rng.random() < 0.6
            ):
                continue
            high, low = (Kind.FSLOPE, Kind.GEAR) if rng.random() < 0.5 else (Kind.BODY, Kind.FOOT)
            grid.kind[x, y, 1], grid.kind[x + dx, y + dy, 1] = high, low
            grid.yaw[x, y, 1] = grid.yaw[x + dx, y + dy, 1] = down
    grid.derive_marks()
    return grid


def ramps(rng):
    """Return a world of ramps, most with a landing, and cars that may drive onto them, from below and from above."""
    length, width = int(rng.integers(5, 8)), int(rng.integers(2, 5))
    grid = make_scene(size=(length, width, 3), cars=[{} for _ in range(int(rng.integers(2, 5)))])
    kind = grid.kind
    for _ in range(int(rng.integers(1, 3))):
        body, y, up = int(rng.integers(1, length - 1)), int(rng.integers(width)), int(rng.choice([-1, 1]))
        if (kind[[body - up, body], y, 1] == Kind.AIR).all():
            kind[body, y, 1], kind[body - up, y, 1] = Kind.BODY, Kind.FOOT
            grid.yaw[[body, body - up], y, 1] = 2 if up == 1 else 0
            if kind[body + up, y, 1] == Kind.AIR and rng.random() < 0.8:
                kind[body + up, y, 1] = Kind.BLOCK
    columns = [(x, y) for x in range(length) for y in range(width)]
    for x, y in rng.permutation(columns)[: int(rng.integers(4))].tolist():
        if kind[x, y, 1] == Kind.AIR:
            kind[x, y, 1] = Kind.BLOCK
    standing = [(x, y, z) for x, y in columns for z in (1, 2) if kind[x, y, z] == Kind.AIR]
    standing = [cell for cell in standing if cell[2] == 1 or kind[cell[0], cell[1], 1] == Kind.BLOCK]
    for row, cell in zip(grid.cars, rng.permutation(standing), strict=False):
        row[: CarField.LOAD_YAW] = *cell, rng.integers(4), rng.choice([Kind.AIR, Kind.AIR, Kind.BLOCK])
    grid.derive_marks()
    return grid


def random_plan(rng, ticks=10):
    grid = (crowd, ramps, random_world)[rng.choice(3, p=(0.4, 0.3, 0.3))](rng)
    return grid, [joint for joint, _ in play(RULES, grid, rng, ticks)]


def any_order(steps, rng):
    """Yield the indices of steps in a random order in which none comes before what it waits for."""
    waiting, done = set(range(len(steps))), set()
    while waiting:
        ready = sorted(i for i in waiting if steps[i].waits_for <= done)
        assert ready, "the steps wait for each other in a circle"
        # Late steps first, half of the time: as far from the plan's order as can be.
        index = ready[-1] if rng.random() < 0.5 else int(rng.choice(ready))
        yield index
        waiting.remove(index)
        done.add(index)


@PLENTY
@given(SEEDS)
def test_every_order_that_respects_the_dependencies_is_legal_and_ends_in_the_same_world(seed):
    rng = np.random.default_rng(seed)
    grid, ticks = random_plan(rng)
    schedule = make_schedule(grid, ticks, RULES)
    for _ in range(4):
        world = grid
        for index in any_order(schedule.steps, rng):
            step = schedule.steps[index]
            assert RULES.legal(world, step.car, step.action), (index, step.car, step.action.name)
            world = RULES.apply(world, step.car, step.action)
        assert world.same_visible(schedule.final)


def changed_places(grid):
    """Yield for each pair of actions, the second of which need not wait, whether the other order ends the same."""
    for first, does in itertools.product(range(grid.n_cars), Action):
        if not RULES.legal(grid, first, does):
            continue
        then = RULES.apply(grid, first, does)
        needs = footprint(grid, then, first, does)
        for second, action in itertools.product(range(grid.n_cars), Action):
            if second == first or not RULES.legal(then, second, action):
                continue
            end = RULES.apply(then, second, action)
            if conflict(needs, footprint(then, end, second, action)):
                continue
            if not RULES.legal(grid, second, action):
                yield False
                continue
            other = RULES.apply(grid, second, action)
            yield RULES.legal(other, first, does) and RULES.apply(other, first, does).same_visible(end)


def test_two_actions_that_do_not_wait_for_each_other_may_change_places():
    """On ramps above all, at whose far end the rules look before a car drives onto them."""
    pairs = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        grid = ramps(rng)
        for world in (grid, *(after for _, after in play(RULES, grid, rng, 2))):
            same = list(changed_places(world))
            assert all(same), seed
            pairs += len(same)
    assert pairs > 5_000


def test_the_sampled_orders_are_truly_different_from_the_plans():
    reordered = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        grid, ticks = random_plan(rng)
        order = list(any_order(make_schedule(grid, ticks, RULES).steps, rng))
        reordered += order != sorted(order)
    assert reordered >= 30


@PLENTY
@given(SEEDS)
def test_the_plans_order_ends_as_the_rules_say_whatever_the_dependencies(seed):
    rng = np.random.default_rng(seed)
    grid, ticks = random_plan(rng)
    after, n_forbidden = grid, 0
    for joint in ticks:
        after, applied = RULES.tick(after, joint)
        n_forbidden += int((~applied).sum())
    for order in get_args(Concurrency):
        schedule = make_schedule(grid, ticks, RULES, order)
        assert schedule.final.same_visible(after)
        assert len(schedule.forbidden) == n_forbidden


def test_every_order_keeps_each_cars_own_actions_in_order():
    for order in get_args(Concurrency):
        for seed in range(25):
            grid, ticks = random_plan(np.random.default_rng(seed))
            steps = make_schedule(grid, ticks, RULES, order).steps
            ancestors: list[set[int]] = []
            last: dict[int, int] = {}
            for index, step in enumerate(steps):
                assert all(earlier < index for earlier in step.waits_for)
                ancestors.append(set().union(step.waits_for, *(ancestors[i] for i in step.waits_for)))
                if step.car in last:
                    assert last[step.car] in ancestors[index]
                last[step.car] = index


def test_sequential_is_a_chain_and_at_once_waits_for_all_earlier_ticks_and_for_nothing_in_its_own():
    for seed in range(10):
        grid, ticks = random_plan(np.random.default_rng(seed))
        steps = make_schedule(grid, ticks, RULES, "sequential").steps
        chain = [frozenset({i - 1} if i else ()) for i in range(len(steps))]
        assert [step.waits_for for step in steps] == chain
        steps = make_schedule(grid, ticks, RULES, "at-once").steps
        for step in steps:
            assert step.waits_for == {i for i, other in enumerate(steps) if other.tick < step.tick}


def test_four_cars_on_the_complex_two_story_plan_work_side_by_side():
    task = make_task("complex_two_story")
    plan = read_plan(shipped_plan("complex_two_story"), task.starts[0].n_cars)
    steps = make_schedule(task.starts[0].grid(np.random.default_rng(0)), plan.ticks, RULES).steps
    longest: list[int] = []
    for step in steps:
        longest.append(1 + max((longest[j] for j in step.waits_for), default=0))
    assert max(longest) <= 0.6 * len(steps)


def test_two_bare_cars_side_by_side_do_not_wait_and_two_loaded_ones_do(scene, car):
    for load, second in ((Kind.AIR, set()), (Kind.BLOCK, {0}), (Kind.FSLOPE, {0})):
        grid = scene([], [car(2, 2, load=load), car(2, 3, load=load)])
        assert waits(grid, (0, RIGHT), (1, RIGHT)) == [set(), second], load.name


def test_a_load_in_motion_waits_for_the_gear_of_a_carried_slope_beside_it(scene, car):
    # Car 0 heads +x at (3, 2): its slope's gear is carried along at (2, 2), beside the load that follows at (2, 3).
    grid = scene([], [car(3, 2, load=Kind.FSLOPE), car(1, 3, load=Kind.BLOCK)])
    assert waits(grid, (0, RIGHT), (1, LEFT)) == [set(), set()]
    assert waits(grid, (0, RIGHT), (1, RIGHT)) == [set(), {0}]


def test_who_drives_under_a_block_does_not_wait_for_the_one_above(scene, car):
    blocks = [(Kind.BLOCK, (x, 1, 1)) for x in (1, 2)]
    grid = scene(blocks, [car(1, 1), car(2, 1, 2)])
    assert waits(grid, (1, LEFT), (0, RIGHT)) == [set(), set()]


def test_unfolding_waits_for_what_leaves_the_swing(scene, car):
    for cell in ((3, 2), (2, 2)):
        grid = scene([(Kind.FSLOPE, (4, 2, 1), 2)], [car(4, 2), car(*cell)])
        assert waits(grid, (1, FORWARD), (0, Action.UNFOLD)) == [set(), {0}]
        away = scene([(Kind.FSLOPE, (4, 2, 1), 2)], [car(4, 2), car(1, 2)])
        assert waits(away, (1, FORWARD), (0, Action.UNFOLD)) == [set(), set()]


def test_what_the_rules_forbid_is_left_out_and_named(scene, car):
    grid = scene([], [car(0, 0), car(1, 0)])
    ticks = [[(0, RIGHT), (1, RIGHT)], [(0, Action.LIFT), (0, RIGHT)]]
    schedule = make_schedule(grid, ticks, RULES)
    assert [(a.tick, a.car, a.action) for a in schedule.forbidden] == [(0, 0, RIGHT), (1, 0, Action.LIFT)]
    assert [(step.tick, step.car, step.action) for step in schedule.steps] == [(0, 1, RIGHT), (1, 0, RIGHT)]
    nothing = make_schedule(grid, [], RULES)
    assert nothing.steps == ()
    assert nothing.final.same_visible(grid)


def test_a_step_knows_the_ground_of_its_move(scene, car):
    grid = scene([(Kind.BLOCK, (4, 2, 1)), (Kind.BODY, (3, 2, 1), 2)], [car(1, 2)])
    ticks = [[(0, action)] for action in (RIGHT, RIGHT, RIGHT, Action.ROTATE_LEFT)]
    inclines = [step.inclines for step in make_schedule(grid, ticks, RULES).steps]
    assert inclines == [(0.0, INCLINE_RAD), (INCLINE_RAD, INCLINE_RAD), (INCLINE_RAD, 0.0), (0.0, 0.0)]


def test_a_step_is_tight_under_things_and_where_a_load_passes_something(scene, car):
    for objects, load, tight in (
        ([], Kind.AIR, False),
        ([(Kind.BLOCK, (2, 3, 1))], Kind.AIR, False),
        ([(Kind.BLOCK, (3, 2, 1))], Kind.AIR, True),
        ([(Kind.BLOCK, (2, 2, 1))], Kind.AIR, True),
        ([(Kind.BLOCK, (2, 4, 1))], Kind.BLOCK, False),
        ([(Kind.BLOCK, (2, 3, 1))], Kind.BLOCK, True),
        ([(Kind.WALL, (4, 1, 1))], Kind.BLOCK, True),
    ):
        grid = scene(objects, [car(2, 2, load=load)])
        (step,) = make_schedule(grid, [[(0, RIGHT)]], RULES).steps
        assert step.tight == tight
