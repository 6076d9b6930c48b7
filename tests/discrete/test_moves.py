"""Moves: on the flat, under objects, with loads, and up and down slopes."""

import pytest

from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import MOVE_DIRECTION, Action
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
MOVES = tuple(MOVE_DIRECTION)
RIGHT, FORWARD, LEFT, BACK = Action.MOVE_RIGHT, Action.MOVE_FORWARD, Action.MOVE_LEFT, Action.MOVE_BACK


def legal_moves(rules, grid, car=0):
    return {move for move in MOVES if rules.legal(grid, car, move)}


@BOTH
@pytest.mark.parametrize("yaw", range(4))
def test_an_empty_car_on_open_ground_moves_in_map_directions_whatever_its_yaw(rules, scene, car, yaw):
    grid = scene([], [car(3, 3, yaw=yaw)])
    for move, (x, y) in {RIGHT: (4, 3), FORWARD: (3, 4), LEFT: (2, 3), BACK: (3, 2)}.items():
        assert rules.apply(grid, 0, move).cars[0].tolist() == [x, y, 1, yaw, 0, 0, 0]


@BOTH
def test_the_border_is_wall(rules, scene, car):
    assert legal_moves(rules, scene([], [car(0, 0)])) == {RIGHT, FORWARD}
    assert legal_moves(rules, scene([], [car(6, 6)])) == {LEFT, BACK}


@BOTH
def test_a_car_does_not_drive_over_an_edge(rules, scene, car):
    grid = scene([(BLOCK, (3, 3, 1)), (BLOCK, (4, 3, 1))], [car(3, 3, 2)])
    assert legal_moves(rules, grid) == {RIGHT}


@BOTH
def test_flags_and_folded_slopes_cannot_be_stood_on(rules, scene, car):
    grid = scene([(BLOCK, (3, 3, 1)), (FLAG, (4, 3, 1)), (FSLOPE, (3, 4, 1), 1)], [car(3, 3, 2)])
    assert legal_moves(rules, grid) == set()


@BOTH
def test_two_cars_do_not_share_a_cell_but_may_be_over_each_other(rules, scene, car):
    assert RIGHT not in legal_moves(rules, scene([], [car(3, 3), car(4, 3)]))
    blocks = [(BLOCK, (3, 3, 1)), (BLOCK, (4, 3, 1))]
    assert RIGHT in legal_moves(rules, scene(blocks, [car(3, 3), car(4, 3, 2)]))


@BOTH
@pytest.mark.parametrize("kind", [BLOCK, FLAG])
def test_a_car_gets_under_and_out_from_under_blocks_and_flags_along_its_yaw_only(rules, scene, car, kind):
    around = [(kind, (4, 3, 1)), (kind, (3, 4, 1)), (kind, (2, 3, 1)), (kind, (3, 2, 1))]
    assert legal_moves(rules, scene(around, [car(3, 3, yaw=0)])) == {RIGHT, LEFT}
    assert legal_moves(rules, scene(around, [car(3, 3, yaw=1)])) == {FORWARD, BACK}
    assert legal_moves(rules, scene(around, [car(3, 3, load=BLOCK)])) == set()
    assert legal_moves(rules, scene([(kind, (3, 3, 1))], [car(3, 3, yaw=1)])) == {FORWARD, BACK}


@BOTH
@pytest.mark.parametrize("kind", [FSLOPE, BODY])
def test_a_car_backs_in_under_a_slope_from_its_top_side_and_leaves_forward(rules, scene, car, kind):
    slope = [(kind, (3, 3, 1), 0)]
    for yaw, moves in ((2, {RIGHT}), (0, set()), (1, set()), (3, set())):
        assert legal_moves(rules, scene(slope, [car(2, 3, yaw=yaw)])) & {RIGHT} == moves
    assert RIGHT not in legal_moves(rules, scene(slope, [car(2, 3, yaw=2, load=BLOCK)]))
    assert BACK not in legal_moves(rules, scene(slope, [car(3, 4, yaw=1)]))
    assert legal_moves(rules, scene(slope, [car(3, 3, yaw=2)])) == {LEFT}


@BOTH
def test_only_an_empty_car_drives_through_a_gear(rules, scene, car):
    gear = [(FSLOPE, (3, 5, 1), 3)]
    assert FORWARD in legal_moves(rules, scene(gear, [car(3, 3)]))
    assert FORWARD not in legal_moves(rules, scene(gear, [car(3, 3, load=BLOCK)]))


@BOTH
def test_a_loaded_car_keeps_out_of_carried_gears(rules, scene, car):
    carrier = car(5, 3, yaw=0, load=FSLOPE)
    assert RIGHT not in legal_moves(rules, scene([], [car(3, 3, load=BLOCK), carrier]))
    assert RIGHT in legal_moves(rules, scene([], [car(3, 3), carrier]))


@BOTH
@pytest.mark.parametrize("load", [BLOCK, FLAG])
def test_a_carried_block_needs_no_room_beside_it(rules, scene, car, load):
    corners = [(BLOCK, (x, y, 1)) for x in (2, 4) for y in (2, 4)]
    assert legal_moves(rules, scene(corners, [car(3, 3, load=load)])) == {FORWARD, BACK, LEFT, RIGHT}


@BOTH
@pytest.mark.parametrize("kind", [FSLOPE, BODY])
def test_a_car_under_a_slope_is_on_the_floor(rules, scene, car, kind):
    after = rules.apply(scene([(kind, (3, 3, 1), 0)], [car(2, 3, yaw=2)]), 0, RIGHT)
    assert after.cars[0].tolist() == [3, 3, 1, 2, Kind.AIR, 0, 0]


@BOTH
def test_a_carried_gear_needs_room_beside_it(rules, scene, car):
    for kind, yaw, free in ((BLOCK, 0, False), (GEAR, 0, True), (GEAR, 2, False), (GEAR, 1, False)):
        grid = scene([(kind, (2, 4, 1), yaw)], [car(3, 3, yaw=0, load=FSLOPE)])
        assert (FORWARD in legal_moves(rules, grid)) == free, (kind, yaw)
    loaded = scene([], [car(3, 3, yaw=0, load=FSLOPE), car(2, 4, load=BLOCK)])
    assert FORWARD not in legal_moves(rules, loaded)
    mine = car(3, 3, yaw=0, load=FSLOPE)
    for other, free in ((car(1, 4, yaw=2, load=FSLOPE), True), (car(2, 5, yaw=1, load=FSLOPE), False)):
        assert (FORWARD in legal_moves(rules, scene([], [mine, other]))) == free


UP = [(BODY, (3, 3, 1), 2), (BLOCK, (4, 3, 1))]
"""A ramp that is climbed in direction +x: foot at (2, 3), landing on the block at (4, 3)."""


@BOTH
def test_a_climb_is_three_moves_and_a_descent_the_same_three_back(rules, scene, car):
    grid = scene(UP, [car(1, 3)])
    states = []
    for _ in range(3):
        assert rules.legal(grid, 0, RIGHT)
        grid = rules.apply(grid, 0, RIGHT)
        states.append([int(grid.cars[0, field]) for field in (CarField.X, CarField.Z, CarField.SLOPE)])
    assert states == [[2, 1, 1], [3, 2, 2], [4, 2, 0]]
    grid.cars[0, CarField.YAW] = 2
    states = []
    for _ in range(3):
        assert rules.legal(grid, 0, LEFT)
        grid = rules.apply(grid, 0, LEFT)
        states.append([int(grid.cars[0, field]) for field in (CarField.X, CarField.Z, CarField.SLOPE)])
    assert states == [[3, 2, 2], [2, 1, 1], [1, 1, 0]]


@BOTH
@pytest.mark.parametrize(
    ("extra", "others", "yaw", "load", "free"),
    [
        ([], [], 0, Kind.AIR, True),
        ([], [], 0, BLOCK, True),
        ([], [], 2, Kind.AIR, False),
        ([], [], 1, Kind.AIR, False),
        ([], [(2, 3, 1, 0, 1)], 0, Kind.AIR, False),
        ([], [(3, 3, 2, 0, 2)], 0, Kind.AIR, False),
        ([], [(4, 3, 2, 0, 0)], 0, Kind.AIR, False),
        ([], [(4, 3, 1, 0, 0)], 0, Kind.AIR, True),
        ([(BLOCK, (4, 3, 2))], [], 0, Kind.AIR, True),
        ([(BLOCK, (4, 3, 2))], [], 0, BLOCK, False),
        ([(WALL, (4, 3, 2))], [], 0, Kind.AIR, False),
        ([(BLOCK, (1, 3, 1))], [], 0, Kind.AIR, False),
    ],
    ids=[
        "free",
        "loaded",
        "backwards",
        "sideways",
        "car on the foot",
        "car on the body",
        "car on the landing",
        "car under the landing",
        "block on the landing",
        "block on the landing, loaded",
        "wall on the landing",
        "from under a block",
    ],
)
def test_a_climb_begins_only_facing_a_free_ramp(rules, scene, car, extra, others, yaw, load, free):
    cars = [car(1, 3, yaw=yaw, load=load)] + [car(x, y, z, yaw=w, slope=s) for x, y, z, w, s in others]
    assert rules.legal(scene([*UP, *extra], cars), 0, RIGHT) == free


@BOTH
def test_a_ramp_without_a_landing_is_not_climbed(rules, scene, car):
    assert not rules.legal(scene([UP[0]], [car(1, 3)]), 0, RIGHT)


@BOTH
@pytest.mark.parametrize(
    ("extra", "others", "yaw", "free"),
    [
        ([], [], 2, True),
        ([], [], 0, False),
        ([], [], 1, False),
        ([], [(3, 3, 2, 2, 2)], 2, False),
        ([], [(2, 3, 1, 2, 1)], 2, False),
        ([], [(1, 3, 1, 0, 0)], 2, False),
        ([(BLOCK, (1, 3, 1))], [], 2, False),
        ([(BLOCK, (4, 3, 2))], [], 2, True),
    ],
    ids=[
        "free",
        "backwards",
        "sideways",
        "car on the body",
        "car on the foot",
        "car at the exit",
        "block at the exit",
        "from under a block",
    ],
)
def test_a_descent_begins_only_facing_down_a_free_ramp(rules, scene, car, extra, others, yaw, free):
    cars = [car(4, 3, 2, yaw=yaw)] + [car(x, y, z, yaw=w, slope=s) for x, y, z, w, s in others]
    assert rules.legal(scene([*UP, *extra], cars), 0, LEFT) == free


@BOTH
def test_a_descent_needs_ground_at_its_exit(rules, scene, car):
    ramp = [(BODY, (1, 3, 1), 2), (BLOCK, (2, 3, 1))]
    assert not rules.legal(scene(ramp, [car(2, 3, 2, yaw=2)]), 0, LEFT)


@BOTH
def test_the_level_above_the_top_is_air(rules, scene, car):
    grid = scene(UP, [car(1, 3)], size=(7, 7, 1))
    for _ in range(3):
        assert rules.legal(grid, 0, RIGHT)
        grid = rules.apply(grid, 0, RIGHT)
    assert grid.cars[0, CarField.Z] == 2


@BOTH
def test_cars_act_one_after_the_other_on_what_the_earlier_ones_left(rules, scene, car):
    grid = scene([], [car(3, 3), car(4, 3)])
    after, applied = rules.tick(grid, [(1, RIGHT), (0, RIGHT)])
    assert applied.tolist() == [True, True]
    assert after.cars[:, CarField.X].tolist() == [4, 5]
    after, applied = rules.tick(grid, [(0, RIGHT), (1, RIGHT)])
    assert applied.tolist() == [False, True]
    assert after.cars[:, CarField.X].tolist() == [3, 5]


@BOTH
def test_a_tick_leaves_the_world_it_was_given_alone(rules, scene, car):
    grid = scene([(BLOCK, (3, 3, 1))], [car(3, 3)])
    kept = grid.copy()
    rules.tick(grid, [(0, Action.LIFT)])
    assert grid.same_visible(kept)
    assert grid.same_marks(kept)


@BOTH
@pytest.mark.parametrize("number", [-1, 1, 99])
def test_a_car_that_is_not_there_is_refused(rules, scene, car, number):
    grid = scene([], [car(3, 3)])
    calls = [
        lambda: rules.legal(grid, number, Action.STOP),
        lambda: rules.tick(grid, [(number, Action.STOP)]),
        lambda: rules.plan_move(grid, number, RIGHT),
    ]
    for call in calls:
        with pytest.raises(ValueError, match=f"no car {number}; the world has 1"):
            call()


@BOTH
@pytest.mark.parametrize("action", [-1, 15, 10**6])
def test_an_action_that_does_not_exist_is_never_legal(rules, scene, car, action):
    grid = scene([], [car(3, 3)])
    assert not rules.legal(grid, 0, action)
    assert rules.apply(grid, 0, action).same_visible(grid)
