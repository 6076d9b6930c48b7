"""What an action needs while it runs, which action waits for which, no more than needed, and when each starts."""

import itertools
from typing import get_args

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from craftsim.discrete.actions import footprint
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.geometry import INCLINE_RAD
from craftsim.discrete.grid import CarField, Kind, cell_of
from craftsim.discrete.kernel.claims import CHANGES, LOADS, RELIES, SPACE
from craftsim.discrete.kernel.claims import conflict as claims_conflict
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Concurrency, make_schedule, nominal_durations
from craftsim.errors import InputError
from craftsim.planning.plan_file import read_plan
from craftsim.tasks import make_task

from .conftest import make_scene
from .worldgen import by_cell, conflict, play, random_world

RULES = Rules("physical")
SEEDS = st.integers(0, 2**32 - 1)
PLENTY = settings(
    max_examples=120, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True
)


def needs(grid, car, action):
    assert RULES.legal(grid, car, action), f"the rules forbid {action.name} here"
    return by_cell(footprint(grid, RULES.apply(grid, car, action), car, action))


def cells_of(needs, bit):
    return {cell for cell, bits in needs.items() if bits & bit}


def random_steps(seed, ticks=8):
    rng = np.random.default_rng(seed)
    grid = random_world(rng)
    return make_schedule(grid, [joint for joint, _ in play(RULES, grid, rng, ticks)], RULES).steps


@PLENTY
@given(SEEDS)
def test_what_an_action_changes_on_the_grid_is_in_its_footprint_within_three_cells_of_its_car(seed):
    for step in random_steps(seed):
        before, after, own = step.before, step.after, by_cell(step.footprint)
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
            one, other = (
                np.array([(*cell, bits) for cell, bits in needs.items()], np.int16)
                for needs in (one, other)
            )
            assert conflict(one, other) is expected, (mine, theirs)
            assert any(claims_conflict(one, len(one), *row) for row in other) is expected


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


FORWARD, BACK, LEFT, RIGHT = (
    Action.MOVE_FORWARD,
    Action.MOVE_BACK,
    Action.MOVE_LEFT,
    Action.MOVE_RIGHT,
)


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
        row[: CarField.LOAD_YAW] = (
            cell // width,
            cell % width,
            1,
            rng.integers(4),
            rng.choice(loads),
        )
    used = {tuple(row[:2]) for row in grid.cars.tolist()}
    for x in range(length):
        for y in range(width):
            down = int(rng.integers(4))
            dx, dy = [(1, 0), (0, 1), (-1, 0), (0, -1)][down]
            inside = 0 <= x + dx < length and 0 <= y + dy < width
            if not inside or used & {(x, y), (x + dx, y + dy)}:
                continue
            if (grid.kind[[x, x + dx], [y, y + dy], 1] != Kind.AIR).any() or rng.random() < 0.6:
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
        body, y, up = (
            int(rng.integers(1, length - 1)),
            int(rng.integers(width)),
            int(rng.choice([-1, 1])),
        )
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
    standing = [
        cell for cell in standing if cell[2] == 1 or kind[cell[0], cell[1], 1] == Kind.BLOCK
    ]
    for row, cell in zip(grid.cars, rng.permutation(standing), strict=False):
        row[: CarField.LOAD_YAW] = (
            *cell,
            rng.integers(4),
            rng.choice([Kind.AIR, Kind.AIR, Kind.BLOCK]),
        )
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
            yield RULES.legal(other, first, does) and RULES.apply(other, first, does).same_visible(
                end
            )


def test_two_actions_that_do_not_wait_for_each_other_may_change_places():
    """On ramps above all, at whose far end the rules look before a car drives onto them."""
    pairs = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        grid = ramps(rng)
        for world in (grid, *(after for _, after in play(RULES, grid, rng, 2))):
            same = list(changed_places(world))
            assert all(same), seed
            pairs += len(same)
    assert pairs > 1_500


@PLENTY
@given(SEEDS)
def test_in_every_order_the_end_is_the_rules_and_a_car_s_own_actions_follow_each_other(seed):
    grid, ticks = random_plan(np.random.default_rng(seed))
    after, n_forbidden = grid, 0
    for joint in ticks:
        after, applied = RULES.tick(after, joint)
        n_forbidden += int((~applied).sum())
    for order in get_args(Concurrency):
        schedule = make_schedule(grid, ticks, RULES, order)
        steps = schedule.steps
        assert schedule.final.same_visible(after)
        assert len(schedule.forbidden) == n_forbidden
        ancestors: list[set[int]] = []
        last: dict[int, int] = {}
        for index, step in enumerate(steps):
            assert all(earlier < index for earlier in step.waits_for)
            ancestors.append(set().union(step.waits_for, *(ancestors[i] for i in step.waits_for)))
            assert last.get(step.car) in {None, *ancestors[index]}
            last[step.car] = index
            if order == "sequential":
                assert step.waits_for == ({index - 1} if index else set())
            if order == "at-once":
                assert step.waits_for == {
                    i for i, other in enumerate(steps) if other.tick < step.tick
                }


@pytest.mark.parametrize("order", ["sequential", "concurrent", "at-once"])
def test_a_step_of_a_shipped_plan_starts_when_the_last_it_waits_for_ends(order, rng):
    grid = make_task("complex_two_story").draw(rng)
    plan = read_plan(shipped_plan("complex_two_story"), grid.n_cars)
    schedule = make_schedule(grid, plan.ticks, RULES, order)
    times, longest = schedule.times(), list[int]()
    assert (times[:, 1] > times[:, 0]).all()
    for (start, _), step in zip(times, schedule.steps, strict=True):
        assert start == max((times[other, 1] for other in step.waits_for), default=0.0)
        longest.append(1 + max((longest[j] for j in step.waits_for), default=0))
    if order == "sequential":
        assert schedule.makespan() == pytest.approx(np.diff(times).sum())
    if order == "concurrent":  # four cars side by side
        assert max(longest) <= 0.6 * len(longest)


BARE, LOADED, SLOPE = ({"load": load} for load in (Kind.AIR, Kind.BLOCK, Kind.FSLOPE))
FOLDED = [(Kind.FSLOPE, (4, 2, 1), 2)]


@pytest.mark.parametrize(
    ("things", "cars", "first", "second", "waits"),
    [
        # Side by side bare cars pass, loads do not, nor does one beside a carried slope's gear.
        ([], [((2, 2), BARE), ((2, 3), BARE)], (0, RIGHT), (1, RIGHT), False),
        ([], [((2, 2), LOADED), ((2, 3), LOADED)], (0, RIGHT), (1, RIGHT), True),
        ([], [((2, 2), SLOPE), ((2, 3), SLOPE)], (0, RIGHT), (1, RIGHT), True),
        ([], [((3, 2), SLOPE), ((1, 3), LOADED)], (0, RIGHT), (1, LEFT), False),
        ([], [((3, 2), SLOPE), ((1, 3), LOADED)], (0, RIGHT), (1, RIGHT), True),
        # Below a block one drives whatever is above it.
        (
            [(Kind.BLOCK, (x, 1, 1)) for x in (1, 2)],
            [((1, 1), {}), ((2, 1, 2), {})],
            (1, LEFT),
            (0, RIGHT),
            False,
        ),
        # A flap swings once its way is left.
        (FOLDED, [((4, 2), {}), ((3, 2), {})], (1, FORWARD), (0, Action.UNFOLD), True),
        (FOLDED, [((4, 2), {}), ((2, 2), {})], (1, FORWARD), (0, Action.UNFOLD), True),
        (FOLDED, [((4, 2), {}), ((1, 2), {})], (1, FORWARD), (0, Action.UNFOLD), False),
    ],
)
def test_an_action_waits_for_one_that_needs_the_same(
    scene, car, things, cars, first, second, waits
):
    grid = scene(things, [car(*place, **more) for place, more in cars])
    schedule = make_schedule(grid, [[first, second]], RULES)
    assert schedule.forbidden == ()
    assert [set(step.waits_for) for step in schedule.steps] == [set(), {0} if waits else set()]


def test_what_the_rules_forbid_is_left_out_and_named(scene, car):
    grid = scene([], [car(0, 0), car(1, 0)])
    ticks = [[(0, RIGHT), (1, RIGHT)], [(0, Action.LIFT), (0, RIGHT)]]
    schedule = make_schedule(grid, ticks, RULES)
    assert [(a.tick, a.car, a.action) for a in schedule.forbidden] == [
        (0, 0, RIGHT),
        (1, 0, Action.LIFT),
    ]
    assert [(step.tick, step.car, step.action) for step in schedule.steps] == [
        (0, 1, RIGHT),
        (1, 0, RIGHT),
    ]
    nothing = make_schedule(grid, [], RULES)
    assert nothing.steps == ()
    assert nothing.final.same_visible(grid)
    assert (nothing.times().shape, nothing.makespan()) == ((0, 2), 0.0)
    for order in ("ticks", None):
        with pytest.raises(InputError, match=f"no order {order!r}.*orders: sequential, concurrent"):
            make_schedule(grid, ticks, RULES, order)


def test_cars_far_from_each_other_start_together_and_a_constraint_delays_who_has_it_and_nobody_else(
    scene, car
):
    ticks = [[(0, RIGHT), (1, Action.ROTATE_LEFT), (2, RIGHT)], [(1, LEFT)]]
    grid = scene([], [car(0, 0), car(4, 4), car(0, 4)])
    move, turn = nominal_durations()[[RIGHT, Action.ROTATE_LEFT], 0]
    free = make_schedule(grid, ticks, RULES)
    np.testing.assert_allclose(free.times(), [(0, move), (0, turn), (0, move), (turn, turn + move)])
    assert free.makespan() == turn + move
    bound = make_schedule(grid, ticks, RULES, after={(0, 2): [(0, 0)]}).times()
    assert (np.delete(bound, 2, axis=0) == np.delete(free.times(), 2, axis=0)).all()
    assert bound[2, 0] == move


def test_a_step_knows_the_ground_of_its_move(scene, car):
    grid = scene([(Kind.BLOCK, (4, 2, 1)), (Kind.BODY, (3, 2, 1), 2)], [car(1, 2)])
    ticks = [[(0, action)] for action in (RIGHT, RIGHT, RIGHT, Action.ROTATE_LEFT)]
    inclines = [step.inclines for step in make_schedule(grid, ticks, RULES).steps]
    assert inclines == [
        (0.0, INCLINE_RAD),
        (INCLINE_RAD, INCLINE_RAD),
        (INCLINE_RAD, 0.0),
        (0.0, 0.0),
    ]


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


def test_a_step_knows_to_which_side_a_load_has_room(scene, car):
    for objects, load, side in (
        ([], Kind.BLOCK, (0, 0)),
        ([(Kind.BLOCK, (3, 1, 1))], Kind.AIR, (0, 0)),
        ([(Kind.BLOCK, (3, 1, 1))], Kind.BLOCK, (0, 1)),
        ([(Kind.WALL, (2, 3, 1))], Kind.BLOCK, (0, -1)),
        ([(Kind.BLOCK, (2, 1, 1)), (Kind.BLOCK, (3, 3, 1))], Kind.BLOCK, (0, 0)),
        ([(Kind.BLOCK, (1, 3, 1))], Kind.BLOCK, (0, 0)),
    ):
        grid = scene(objects, [car(2, 2, load=load)])
        (step,) = make_schedule(grid, [[(0, RIGHT)]], RULES).steps
        assert step.free_side == side
    grid = scene([], [car(2, 0, load=Kind.BLOCK), car(2, 1)])
    (step,) = make_schedule(grid, [[(0, RIGHT)]], RULES).steps
    assert step.free_side == (0, -1), "outside of the map nothing stands"
