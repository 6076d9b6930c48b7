"""Each correction of the physical rules: what published allows and physical forbids, and what both still allow."""

import pytest

from craftsim.discrete.grid import CarField, Kind
from craftsim.discrete.kinds import Action, Correction
from craftsim.discrete.rules import RULE_SETS, Rules

PUBLISHED, PHYSICAL = Rules("published"), Rules("physical")
AIR, BLOCK, FLAG, FSLOPE, GEAR, BODY, FOOT, WALL = (
    Kind.AIR,
    Kind.BLOCK,
    Kind.FLAG,
    Kind.FSLOPE,
    Kind.GEAR,
    Kind.BODY,
    Kind.FOOT,
    Kind.WALL,
)
UP, DOWN, LEFT, RIGHT = Action.MOVE_FORWARD, Action.MOVE_BACK, Action.MOVE_LEFT, Action.MOVE_RIGHT
LOADS = (BLOCK, FLAG, FSLOPE)
TURNS = (Action.ROTATE_LEFT, Action.ROTATE_RIGHT)
SWINGS = pytest.mark.parametrize(("kind", "action"), [(FSLOPE, Action.UNFOLD), (BODY, Action.FOLD)])
RAMP = [(BLOCK, (1, 3, 1)), (BODY, (2, 3, 1), 0)]
"""A ramp that falls in +x from the block at (1, 3) to its foot at (3, 3)."""


def allows(grid, car, action, without=None):
    """Return whether published allows an action, and whether physical does, but for one switch."""
    flags = ~Correction[without] if without else None
    return tuple(bool(r.legal(grid, car, action)) for r in (PUBLISHED, Rules("physical", flags)))


def corrected(grid, car, action, switch):
    """Return whether only published allows an action, because of this switch alone."""
    with_it, without = allows(grid, car, action), allows(grid, car, action, without=switch)
    return with_it == (True, False) and without == (True, True)


def test_published_has_no_correction_and_physical_has_all():
    assert not RULE_SETS["published"]
    assert set(RULE_SETS["physical"]) == set(Correction)


@SWINGS
def test_a_flap_needs_the_cell_beyond_the_foot(scene, car, kind, action):
    slope = (kind, (4, 3, 1), 2)
    for thing in ((BLOCK,), (FLAG,), (WALL,), (FSLOPE, 2), (BODY, 2), (BODY, 1)):
        grid = scene([slope, (thing[0], (2, 3, 1), *thing[1:])], [car(4, 3)])
        assert corrected(grid, 0, action, "swinging_flap"), thing
        assert allows(scene([slope, (thing[0], (1, 3, 1), *thing[1:])], [car(4, 3)]), 0, action)[0]
    assert allows(scene([slope, (BLOCK, (1, 3, 1))], [car(4, 3)]), 0, action) == (True, True)
    # Two ramps may meet at their feet, whose low ends are below the lip; at a right angle a foot's side is not.
    assert allows(scene([slope, (BODY, (1, 3, 1), 0)], [car(4, 3)]), 0, action) == (True, True)
    assert corrected(scene([slope, (BODY, (2, 4, 1), 3)], [car(4, 3)]), 0, action, "swinging_flap")
    # Outside the map nothing stands.
    assert allows(scene([(kind, (1, 3, 1), 2)], [car(1, 3)]), 0, action) == (True, True)


@SWINGS
def test_a_flap_passes_over_a_car_beyond_the_foot_but_not_over_a_load(scene, car, kind, action):
    slope = [(kind, (4, 3, 1), 2)]
    assert allows(scene(slope, [car(4, 3), car(2, 3)]), 0, action) == (True, True)
    for load in (BLOCK, FLAG):
        grid = scene(slope, [car(4, 3), car(2, 3, load=load)])
        assert corrected(grid, 0, action, "swinging_flap")
    leaning = scene([*slope, (BODY, (2, 5, 1), 3)], [car(4, 3), car(2, 4, yaw=1, load=BLOCK, slope=1)])
    assert corrected(leaning, 0, action, "swinging_flap")


def test_no_slope_is_unfolded_onto_a_car(scene, car):
    grid = scene([(FSLOPE, (4, 3, 1), 2)], [car(4, 3), car(3, 3)])
    assert corrected(grid, 0, Action.UNFOLD, "swinging_flap")


@SWINGS
@pytest.mark.parametrize(("cell", "level"), [((4, 4), 2), ((3, 4), 2), ((3, 2), 2), ((2, 4), 1)])
def test_a_flap_meets_gears_that_reach_in_from_the_side(scene, car, kind, action, cell, level):
    slope, yaw = (kind, (4, 3, 1), 2), 3 if cell[1] == 4 else 1
    below = [(BLOCK, (*cell, 1))] if level == 2 else []
    standing = scene([slope, *below, (FSLOPE, (*cell, level), yaw)], [car(4, 3)])
    carried = scene([slope, *below], [car(4, 3), car(*cell, level, yaw=(yaw + 2) % 4, load=FSLOPE)])
    away = scene([slope, *below, (FSLOPE, (*cell, level), (yaw + 1) % 4)], [car(4, 3)])
    assert corrected(standing, 0, action, "swinging_flap")
    assert corrected(carried, 0, action, "swinging_flap")
    assert allows(away, 0, action) == (True, True)


@SWINGS
def test_a_flap_does_not_meet_a_gear_that_hangs_over_the_body_from_the_landing(scene, car, kind, action):
    grid = scene([(kind, (4, 3, 1), 2), (BLOCK, (5, 3, 1)), (FSLOPE, (5, 3, 2), 2)], [car(4, 3)])
    assert allows(grid, 0, action) == (True, True)


@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("turn", TURNS)
def test_a_load_turns_beside_no_car_but_past_a_corner(scene, car, load, turn):
    for cell in ((4, 3), (2, 3), (3, 4), (3, 2)):
        grid = scene([], [car(3, 3, load=load), car(*cell)])
        assert corrected(grid, 0, turn, "turning_load")
    for cell in ((4, 4), (2, 4), (4, 2), (2, 2), (5, 3)):
        assert allows(scene([], [car(3, 3, load=load), car(*cell)]), 0, turn) == (True, True)
    assert allows(scene([], [car(3, 3), car(4, 3)]), 0, turn) == (True, True)


@pytest.mark.parametrize("turn", TURNS)
def test_a_load_does_not_turn_where_another_leans_past_its_side(scene, car, turn):
    climber = car(3, 3, yaw=2, load=BLOCK, slope=1)
    for cell, free in (((4, 4), False), ((4, 2), False), ((5, 3), True)):
        grid = scene(RAMP, [car(*cell, load=BLOCK), climber])
        assert allows(grid, 0, turn) == (True, free), cell
        bare = scene(RAMP, [car(*cell, load=BLOCK), car(3, 3, yaw=2, slope=1)])
        assert allows(bare, 0, turn) == (True, True)


@pytest.mark.parametrize("load", LOADS)
def test_no_load_comes_where_another_leans(scene, car, load):
    climber = car(3, 3, yaw=2, load=BLOCK, slope=1)
    assert corrected(scene(RAMP, [car(5, 3, yaw=2, load=load), climber]), 0, LEFT, "leaning_load")
    assert allows(scene(RAMP, [car(5, 3, yaw=2), climber]), 0, LEFT) == (True, True)
    bare = scene(RAMP, [car(5, 3, yaw=2, load=load), car(3, 3, yaw=2, slope=1)])
    assert allows(bare, 0, LEFT) == (True, True)


def test_no_gear_comes_where_a_load_leans_unless_straight_towards_it(scene, car):
    climber = car(3, 3, yaw=2, load=BLOCK, slope=1)
    across = scene(RAMP, [car(4, 5, yaw=1, load=FSLOPE), climber])
    towards = scene(RAMP, [car(6, 3, yaw=0, load=FSLOPE), climber])
    assert corrected(across, 0, DOWN, "leaning_load")
    assert allows(towards, 0, LEFT) == (True, True)


@pytest.mark.parametrize("load", LOADS)
def test_a_load_comes_down_only_to_where_it_can_lean(scene, car, load):
    falling = car(2, 3, 2, yaw=0, load=load, slope=2)
    for taken in (
        scene(RAMP, [falling, car(4, 3, yaw=2, load=BLOCK)]),
        scene([*RAMP, (BLOCK, (4, 3, 1))], [falling]),
        scene([*RAMP, (WALL, (4, 3, 1))], [falling]),
        scene([*RAMP, (FSLOPE, (4, 4, 1), 3)], [falling]),
        scene(RAMP, [falling, car(4, 4, yaw=1, load=FSLOPE)]),
    ):
        assert corrected(taken, 0, RIGHT, "leaning_load")
    for free in (
        scene(RAMP, [falling]),
        scene(RAMP, [falling, car(4, 3, yaw=2)]),
        scene([*RAMP, (FSLOPE, (5, 3, 1), 2)], [falling]),
    ):
        assert allows(free, 0, RIGHT) == (True, True)
    bare = scene([*RAMP, (BLOCK, (4, 3, 1))], [car(2, 3, 2, slope=2)])
    assert allows(bare, 0, RIGHT) == (True, True)


def test_a_load_leaves_a_ramp_only_where_no_gear_is_carried(scene, car):
    for other in (car(4, 4, yaw=1, load=FSLOPE), car(5, 3, yaw=0, load=FSLOPE)):
        grid = scene(RAMP, [car(3, 3, yaw=0, load=BLOCK, slope=1), other])
        assert corrected(grid, 0, RIGHT, "leaning_load")
    above = [*RAMP, (BLOCK, (1, 4, 1))]
    grid = scene(above, [car(2, 3, 2, yaw=2, load=BLOCK, slope=2), car(1, 4, 2, yaw=1, load=FSLOPE)])
    assert corrected(grid, 0, LEFT, "leaning_load")


@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("hangs_over", [(2, 4), (3, 4)], ids=["body", "foot"])
def test_no_load_passes_the_upper_half_below_a_gear_from_the_side(scene, car, load, hangs_over):
    world = [*RAMP, (BLOCK, (*hangs_over, 1)), (FSLOPE, (*hangs_over, 2), 3)]
    for state, move in (
        (car(3, 3, yaw=2, load=load, slope=1), LEFT),
        (car(2, 3, 2, yaw=2, load=load, slope=2), LEFT),
        (car(2, 3, 2, yaw=0, load=load, slope=2), RIGHT),
    ):
        assert corrected(scene(world, [state]), 0, move, "leaning_load")
        assert allows(scene(world, [state | {"load": AIR, "load_yaw": 0}]), 0, move) == (True, True)
    # On the lower half the load is still below it.
    assert allows(scene(world, [car(4, 3, yaw=2, load=load)]), 0, LEFT) == (True, True)
    assert allows(scene(world, [car(3, 3, yaw=0, load=load, slope=1)]), 0, RIGHT) == (True, True)


def test_no_car_drives_over_the_crest_of_two_ramps(scene, car):
    grid = scene([(BODY, (3, 3, 1), 0), (BODY, (2, 3, 1), 2)], [car(3, 3, 2, yaw=2, slope=2)])
    assert corrected(grid, 0, LEFT, "own_ramp")


def test_no_car_takes_the_body_or_the_foot_of_another_slope_for_its_own(scene, car):
    before_body = scene([*RAMP, (BLOCK, (5, 3, 1)), (BODY, (4, 3, 1), 0)], [car(3, 3, yaw=0, slope=1)])
    over_edge = scene([(BODY, (3, 3, 1), 0), (BODY, (2, 4, 1), 3)], [car(3, 3, 2, yaw=2, slope=2)])
    assert corrected(before_body, 0, RIGHT, "own_ramp")
    assert corrected(over_edge, 0, LEFT, "own_ramp")


def test_no_car_drives_into_another_on_its_own_ramp(scene, car):
    up = scene(RAMP, [car(3, 3, yaw=2, slope=1), car(2, 3, 2, yaw=2, slope=2)])
    down = scene(RAMP, [car(2, 3, 2, yaw=0, slope=2), car(3, 3, yaw=0, slope=1)])
    assert corrected(up, 0, LEFT, "own_ramp")
    assert corrected(down, 0, RIGHT, "own_ramp")


def test_from_a_top_onto_a_second_foot_a_car_is_on_the_second_ramp(scene, car):
    stairs = [(BODY, (4, 3, 1), 0), *[(BLOCK, (x, 3, 1)) for x in (1, 2, 3)], (BODY, (2, 3, 2), 0)]
    grid = scene([*stairs, (BLOCK, (1, 3, 2))], [car(4, 3, 2, yaw=2, slope=2)])
    assert allows(grid, 0, LEFT) == (True, True)
    for rules, slope in ((PUBLISHED, 0), (PHYSICAL, 1)):
        after = rules.apply(grid, 0, LEFT)
        assert after.cars[0, [CarField.X, CarField.Z, CarField.SLOPE]].tolist() == [3, 2, slope]


def test_off_a_ramp_no_car_drives_right_under_something(scene, car):
    for thing in (BLOCK, FLAG):
        grid = scene([*RAMP, (thing, (4, 3, 1))], [car(3, 3, yaw=0, slope=1)])
        assert corrected(grid, 0, RIGHT, "run_out")
        away = scene([*RAMP, (thing, (5, 3, 1))], [car(3, 3, yaw=0, slope=1)])
        assert allows(away, 0, RIGHT) == (True, True)
    top = scene([*RAMP, (BLOCK, (1, 3, 2))], [car(2, 3, 2, yaw=2, slope=2)])
    assert allows(top, 0, LEFT) == (True, True)


def test_below_a_gear_a_ramp_is_driven_down_in_its_own_direction_only(scene, car):
    world = [*RAMP, (BLOCK, (2, 4, 1)), (FSLOPE, (2, 4, 2), 3), (BLOCK, (2, 2, 1))]
    assert allows(scene(world, [car(1, 3, 2, yaw=0)]), 0, RIGHT) == (True, True)
    assert corrected(scene(world, [car(2, 2, 2, yaw=0)]), 0, UP, "ramp_below_gear")


def test_a_gear_lasts_as_long_as_its_slope_and_gives_way_to_what_stands(scene, car):
    facing = [(FSLOPE, (1, 3, 1), 0), (FSLOPE, (3, 3, 1), 2)]
    grid = scene(facing, [car(3, 3)])
    lifted = {rules.rule_set: rules.apply(grid, 0, Action.LIFT) for rules in (PUBLISHED, PHYSICAL)}
    assert lifted["published"].kind[2, 3, 1] == AIR
    assert (lifted["physical"].kind[2, 3, 1], lifted["physical"].yaw[2, 3, 1]) == (GEAR, 0)
    for yaw, rules in ((2, PUBLISHED), (0, PHYSICAL)):
        assert rules.apply(lifted["physical"], 0, Action.DROP).yaw[2, 3, 1] == yaw
    alone = PHYSICAL.apply(scene([(FSLOPE, (3, 3, 1), 2)], [car(3, 3)]), 0, Action.LIFT)
    assert not (alone.kind == GEAR).any()
    behind_ramp = scene(RAMP, [car(4, 3, yaw=0, load=FSLOPE)])
    assert PUBLISHED.apply(behind_ramp, 0, Action.DROP).kind[3, 3, 1] == GEAR
    assert PHYSICAL.apply(behind_ramp, 0, Action.DROP).kind[3, 3, 1] == FOOT


@pytest.mark.parametrize("turn", TURNS)
def test_a_load_turns_above_no_load_that_reaches_up(scene, car, turn):
    """Beside a car on the foot with any load, and beside a carried load that is as high as its own legs."""
    for load in LOADS:
        climber = car(3, 3, yaw=2, load=load, slope=1)
        for side in (2, 4):
            world = [*RAMP, (BLOCK, (3, side, 1))]
            turning = scene(world, [car(3, side, 2, load=BLOCK), climber])
            assert corrected(turning, 0, turn, "reaching_load")
            bare = scene(world, [car(3, side, 2, load=BLOCK), car(3, 3, yaw=2, slope=1)])
            assert allows(bare, 0, turn) == (True, True)
    for above in LOADS:
        for below in (*LOADS, AIR):
            grid = scene([(BLOCK, (3, 4, 1))], [car(3, 4, 2, load=above), car(3, 3, load=below)])
            free = below == AIR or (above == FSLOPE and below != FSLOPE)
            assert allows(grid, 0, turn) == (True, free), (above, below)


@SWINGS
def test_a_flap_swings_above_no_load_that_reaches_up(scene, car, kind, action):
    world = [(BLOCK, (4, 3, 1)), (BLOCK, (3, 3, 1)), (kind, (4, 3, 2), 2), (BODY, (2, 4, 1), 3)]
    for load in LOADS:
        grid = scene(world, [car(4, 3, 2), car(2, 3, yaw=1, load=load, slope=1)])
        assert corrected(grid, 0, action, "reaching_load")
    assert allows(scene(world, [car(4, 3, 2), car(2, 3, yaw=1, slope=1)]), 0, action) == (True, True)


def test_a_wall_overhead_keeps_loads_away(scene, car):
    over = (WALL, (3, 3, 2))
    assert corrected(scene([over, (BLOCK, (3, 3, 1))], [car(3, 3)]), 0, Action.LIFT, "overhead_wall")
    for load in LOADS:
        assert corrected(scene([over], [car(2, 3, load=load)]), 0, RIGHT, "overhead_wall")
        for turn in TURNS:
            assert corrected(scene([over], [car(2, 3, load=load)]), 0, turn, "overhead_wall")
        for cell in ((3, 3, 2), (4, 3, 2)):
            onto_foot = scene([*RAMP, (WALL, cell)], [car(4, 3, yaw=2, load=load)])
            assert corrected(onto_foot, 0, LEFT, "overhead_wall")
        down = scene([*RAMP, (WALL, (4, 3, 2))], [car(2, 3, 2, yaw=0, load=load, slope=2)])
        assert corrected(down, 0, RIGHT, "overhead_wall")
    assert allows(scene([over], [car(2, 3)]), 0, RIGHT) == (True, True)
    assert allows(scene([over, (BLOCK, (3, 3, 1))], [car(2, 3)]), 0, RIGHT) == (True, True)


def test_no_car_climbs_onto_a_body_right_below_a_wall(scene, car):
    world = [*RAMP, (WALL, (2, 3, 2))]
    assert corrected(scene(world, [car(4, 3, yaw=2)]), 0, LEFT, "overhead_wall")
    assert corrected(scene(world, [car(3, 3, yaw=2, slope=1)]), 0, LEFT, "overhead_wall")


@SWINGS
def test_a_flap_needs_the_two_levels_above_it_free_of_walls(scene, car, kind, action):
    slope = (kind, (4, 3, 1), 2)
    for cell in ((4, 3, 2), (3, 3, 2), (4, 3, 3), (3, 3, 3)):
        assert corrected(scene([slope, (WALL, cell)], [car(4, 3)]), 0, action, "overhead_wall")
    for cell in ((5, 3, 2), (2, 3, 2), (3, 4, 2)):
        assert allows(scene([slope, (WALL, cell)], [car(4, 3)]), 0, action) == (True, True)


def test_a_slope_is_lifted_and_set_down_where_its_gear_crosses_nothing(scene, car):
    across, towards = (FSLOPE, (2, 4, 1), 3), (FSLOPE, (1, 3, 1), 0)
    carrying = [car(3, 3, load=FSLOPE)]
    assert corrected(scene([across], carrying), 0, Action.DROP, "crossing_gear")
    assert corrected(scene([(BODY, (2, 4, 1), 3)], carrying), 0, Action.DROP, "crossing_gear")
    assert corrected(scene([], [*carrying, car(2, 3, load=BLOCK)]), 0, Action.DROP, "crossing_gear")
    assert allows(scene([towards], carrying), 0, Action.DROP) == (True, True)
    assert allows(scene([(BODY, (1, 3, 1), 0)], carrying), 0, Action.DROP) == (True, True)
    slope = (FSLOPE, (3, 3, 1), 2)
    carried = [car(3, 3), car(2, 4, yaw=1, load=FSLOPE)]
    assert corrected(scene([slope], carried), 0, Action.LIFT, "crossing_gear")
    assert allows(scene([slope], [car(3, 3), car(2, 4, yaw=1)]), 0, Action.LIFT) == (True, True)


HIGH_RAMP = [(BLOCK, (3, 5, 1)), (BLOCK, (3, 4, 1)), (BODY, (3, 5, 2), 3)]
"""A ramp on level 2 that falls in -y to its foot at (3, 4), beyond which, at (3, 3), nothing is to stand on."""


@pytest.mark.parametrize("load", LOADS)
def test_no_load_passes_below_one_that_leans_over_it(scene, car, load):
    leaning, bare = (car(3, 4, 2, yaw=1, load=kind, slope=1) for kind in (BLOCK, AIR))
    for start, action in ((2, RIGHT), (3, RIGHT)):
        assert corrected(scene(HIGH_RAMP, [car(start, 3, load=load), leaning]), 0, action, "reaching_load")
        assert allows(scene(HIGH_RAMP, [car(start, 3, load=load), bare]), 0, action) == (True, True)
    things = [*HIGH_RAMP, (load, (3, 3, 1), 2) if load == FSLOPE else (load, (3, 3, 1))]
    assert corrected(scene(things, [car(3, 3), leaning]), 0, Action.LIFT, "reaching_load")
    assert allows(scene(things, [car(3, 3), bare]), 0, Action.LIFT) == (True, True)


def test_no_gear_passes_above_a_slope_on_a_foot(scene, car):
    world = [*RAMP, (BLOCK, (4, 4, 1)), (BLOCK, (4, 5, 1))]
    for load, free in ((FSLOPE, False), (BLOCK, True)):
        climber = car(3, 3, yaw=2, load=load, slope=1)
        grid = scene(world, [car(4, 4, 2, yaw=0, load=FSLOPE), climber])
        assert allows(grid, 0, UP) == (True, True)
        below = scene([*world, (BLOCK, (4, 3, 1))], [car(4, 4, 2, yaw=0, load=FSLOPE), climber])
        assert allows(below, 0, DOWN) == (True, free)
