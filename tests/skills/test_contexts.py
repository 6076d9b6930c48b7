"""Each skill, in each place where it is allowed, does in physics what the rules predict.

Bands: a car ends within 1 mm and 3 mrad of its cell, a thing is set down within 2 mm of its cell's centre, and nothing
that the action does not concern moves more than 1 mm.
"""

import pytest

from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import MOVE_DIRECTION, Action

CAR_M, HEADING_RAD, PLACED_M, OTHERS_M = 1e-3, 3e-3, 2e-3, 1e-3
MOVE = {direction: action for action, direction in MOVE_DIRECTION.items()}
RIGHT, FORWARD, LEFT, BACK = (MOVE[direction] for direction in range(4))
LIFT, DROP, FOLD, UNFOLD, STOP = Action.LIFT, Action.DROP, Action.FOLD, Action.UNFOLD, Action.STOP
TURNS = [Action.ROTATE_LEFT, Action.ROTATE_RIGHT]
MOVES = [RIGHT, LEFT, FORWARD, BACK]
LOADS = [Kind.BLOCK, Kind.FLAG, Kind.FSLOPE]


def _perform(judge, actions, car=0):
    """Perform actions one by one and hold each against the bands."""
    for action in actions:
        attempt = judge.perform(car, action)
        what = f"{action.name}: {attempt}"
        assert attempt.legal, what
        assert attempt.skill == "succeeded", what
        assert attempt.agrees, what
        assert attempt.car_error_m <= CAR_M, what
        assert attempt.heading_error_rad <= HEADING_RAD, what
        assert attempt.bystander_displacement_m <= OTHERS_M, what
        if action in (DROP, FOLD, UNFOLD):
            assert attempt.placed_error_m is not None, what
        if attempt.placed_error_m is not None:
            assert attempt.placed_error_m <= PLACED_M, what


def _loaded(cell, yaw, load):
    """Return the row of a car with a load; a carried slope faces backwards."""
    return (*cell, yaw, load, (yaw + 2) % 4 if load == Kind.FSLOPE else 0)


def test_moves_in_all_directions_and_turns_both_ways_at_each_heading(make_checked):
    for yaw in range(4):
        _perform(make_checked((3, 3, 1), [(1, 1, 1, yaw)]), [*MOVES, *TURNS, TURNS[1], TURNS[0], STOP])


@pytest.mark.parametrize("load", LOADS)
def test_carries_a_load_in_all_directions_turns_with_it_and_sets_it_down_in_place(make_checked, load):
    judge = make_checked((5, 5, 2), [_loaded((2, 2, 1), 0, load)])
    _perform(
        judge, [RIGHT, LEFT, LEFT, RIGHT, FORWARD, BACK, BACK, FORWARD, *TURNS, TURNS[1], TURNS[1], DROP]
    )


@pytest.mark.parametrize("kind", [Kind.BLOCK, Kind.FLAG])
def test_drives_in_and_out_under_a_table_turns_lifts_and_sets_it_down_time_and_again(make_checked, kind):
    judge = make_checked((3, 3, 2), [(0, 1, 1, 0)], [(kind, (1, 1, 1))])
    _perform(judge, [RIGHT, RIGHT, LEFT, *TURNS, TURNS[0], TURNS[0], LIFT, DROP, LIFT, DROP, LEFT])


@pytest.mark.parametrize("kind", [Kind.FSLOPE, Kind.BODY])
def test_backs_in_under_a_slope_from_its_high_side_and_leaves_forward(make_checked, kind):
    _perform(make_checked((5, 5, 2), [(1, 2, 1, 2)], [(kind, (2, 2, 1), 0)]), [RIGHT, LEFT])


def test_lifts_brings_unfolds_and_folds_a_slope(make_checked):
    judge = make_checked((5, 3, 2), [(1, 1, 1, 0)], [(Kind.FSLOPE, (1, 1, 1), 2)])
    _perform(judge, [LIFT, DROP, UNFOLD, FOLD, LIFT, RIGHT, DROP, UNFOLD, RIGHT])


def _ramp(direction):
    """Return the map's size, the cells of a way that climbs in a direction, and what stands there.

    Two cells of floor, foot and body of a slope, and three blocks on a line in the middle of the map.
    """
    lengthwise = direction in (0, 2)
    at = range(7) if direction in (0, 1) else range(6, -1, -1)
    cells = [(i, 2, 1) if lengthwise else (2, i, 1) for i in at]
    size = (7, 5, 3) if lengthwise else (5, 7, 3)
    landing = [(Kind.BLOCK, cell) for cell in cells[4:]]
    return size, cells, [(Kind.BODY, cells[3], (direction + 2) % 4), *landing]


@pytest.mark.parametrize("direction", [1, 2])
def test_climbs_a_ramp_drives_and_turns_on_top_and_comes_back_down(make_checked, direction):
    size, cells, objects = _ramp(direction)
    up, down = MOVE[direction], MOVE[(direction + 2) % 4]
    judge = make_checked(size, [(*cells[0], direction)], objects)
    _perform(judge, [up] * 6 + [TURNS[0], TURNS[0]] + [down] * 6)


@pytest.mark.parametrize(
    ("direction", "load"),
    [(0, Kind.BLOCK), (1, Kind.FLAG), (2, Kind.FSLOPE), (3, Kind.BLOCK), (3, Kind.FSLOPE)],
)
def test_carries_a_load_up_a_ramp_sets_it_down_there_and_brings_it_back_down(make_checked, direction, load):
    """In each direction of the map, and with each load."""
    size, cells, objects = _ramp(direction)
    up, down = MOVE[direction], MOVE[(direction + 2) % 4]
    judge = make_checked(size, [_loaded(cells[1], direction, load)], objects)
    _perform(judge, [up] * 4 + [DROP, LIFT, TURNS[1], TURNS[1]] + [down] * 5 + [DROP])


def test_works_beside_neighbours_without_touching_them(make_checked):
    ring = [(x, y) for x in range(3) for y in range(3) if (x, y) != (1, 1) and (x, y) != (2, 1)]
    judge = make_checked(
        (4, 3, 2), [(1, 1, 1, 0)], [(Kind.BLOCK, (1, 1, 1))] + [(Kind.BLOCK, (x, y, 1)) for x, y in ring]
    )
    _perform(judge, [LIFT, RIGHT, LEFT, DROP])
