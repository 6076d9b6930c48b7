"""Each skill, in each place where it is allowed, does in physics what the rules predict, on either drive.

Bands: a car ends within 1 mm and 3 mrad of its cell, a thing is set down within 2 mm of its cell's centre, and nothing
that the action does not concern moves more than 1 mm.
"""

import pytest

from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import MOVE_DIRECTION, Action

MOVE = {direction: action for action, direction in MOVE_DIRECTION.items()}
RIGHT, FORWARD, LEFT, BACK = (MOVE[direction] for direction in range(4))
LIFT, DROP, FOLD, UNFOLD, STOP = Action.LIFT, Action.DROP, Action.FOLD, Action.UNFOLD, Action.STOP
TURN, TURN_BACK = Action.ROTATE_LEFT, Action.ROTATE_RIGHT
ROLLERS, REDUCED = "rollers", "reduced"


def _on_both(*cases):
    """Return cases, whose last value is a drive, and each on the other drive as a slow one."""
    other = {REDUCED: ROLLERS, ROLLERS: REDUCED}
    slow = (pytest.param(*case, other[drive], marks=pytest.mark.slow) for *case, drive in cases)
    return [*cases, *slow]


def _perform(judge, actions):
    """Perform actions one by one; each agrees, whose limits are the bands."""
    for action in actions:
        attempt = judge.perform(0, action)
        assert attempt.agrees, f"{action.name}: {attempt}"
        assert action not in (DROP, FOLD, UNFOLD) or attempt.placed_error_m is not None, attempt


def _loaded(cell, yaw, load):
    """Return the row of a car with a load; a carried slope faces backwards."""
    return (*cell, yaw, load, (yaw + 2) % 4 if load == Kind.FSLOPE else 0)


@pytest.mark.parametrize(("yaw", "drive"), _on_both((0, ROLLERS), (1, REDUCED), (2, REDUCED), (3, ROLLERS)))
def test_moves_in_all_directions_and_turns_both_ways(make_checked, yaw, drive):
    judge = make_checked((3, 3, 1), [(1, 1, 1, yaw)], drive=drive)
    _perform(judge, [RIGHT, LEFT, FORWARD, BACK, TURN, TURN_BACK, STOP])


@pytest.mark.parametrize(
    ("load", "drive"), _on_both((Kind.BLOCK, REDUCED), (Kind.FLAG, REDUCED), (Kind.FSLOPE, ROLLERS))
)
def test_carries_a_load_in_all_directions_turns_with_it_and_sets_it_down(make_checked, load, drive):
    judge = make_checked((5, 5, 2), [_loaded((2, 2, 1), 0, load)], drive=drive)
    _perform(
        judge, [RIGHT, LEFT, LEFT, RIGHT, FORWARD, BACK, BACK, FORWARD, TURN, TURN_BACK, TURN_BACK, DROP]
    )


@pytest.mark.parametrize(("kind", "drive"), _on_both((Kind.BLOCK, ROLLERS), (Kind.FLAG, REDUCED)))
def test_drives_in_and_out_under_a_table_turns_lifts_and_sets_it_down_again(make_checked, kind, drive):
    judge = make_checked((3, 3, 2), [(0, 1, 1, 0)], [(kind, (1, 1, 1))], drive)
    _perform(judge, [RIGHT, RIGHT, LEFT, TURN, TURN_BACK, LIFT, DROP, LIFT, DROP, LEFT])


@pytest.mark.parametrize("kind", [Kind.FSLOPE, Kind.BODY])
def test_backs_in_under_a_slope_from_its_high_side_and_leaves_forward(make_checked, kind):
    _perform(make_checked((5, 5, 2), [(1, 2, 1, 2)], [(kind, (2, 2, 1), 0)]), [RIGHT, LEFT])


def test_lifts_brings_unfolds_and_folds_a_slope(make_checked):
    judge = make_checked((5, 3, 2), [(1, 1, 1, 0)], [(Kind.FSLOPE, (1, 1, 1), 2)])
    _perform(judge, [LIFT, DROP, UNFOLD, FOLD, LIFT, RIGHT, DROP, UNFOLD, RIGHT])


@pytest.mark.parametrize(
    ("direction", "load", "drive"),
    _on_both(
        (0, Kind.BLOCK, ROLLERS),
        (1, Kind.FLAG, REDUCED),
        (2, Kind.FSLOPE, REDUCED),
        (3, Kind.FSLOPE, ROLLERS),
        (3, Kind.BLOCK, REDUCED),
        (2, Kind.AIR, ROLLERS),
        (1, Kind.AIR, REDUCED),
    ),
)
def test_climbs_a_ramp_works_on_top_and_comes_back_down(make_checked, direction, load, drive):
    """Two cells of floor, foot and body of a slope, and three blocks, in each direction and with each load."""
    lengthwise = direction in (0, 2)
    cells = [
        (i, 2, 1) if lengthwise else (2, i, 1) for i in (range(7) if direction < 2 else range(6, -1, -1))
    ]
    blocks = [(Kind.BLOCK, cell) for cell in cells[4:]]
    objects = [(Kind.BODY, cells[3], (direction + 2) % 4), *blocks]
    up, down = MOVE[direction], MOVE[(direction + 2) % 4]
    begin = _loaded(cells[1], direction, load)
    judge = make_checked((7, 5, 3) if lengthwise else (5, 7, 3), [begin], objects, drive)
    on_top, after = ([DROP, LIFT, TURN_BACK, TURN_BACK], [DROP]) if load else ([up, TURN, TURN, down], [])
    _perform(judge, [up] * 4 + on_top + [down] * 5 + after)


def test_works_beside_neighbours_without_touching_them(make_checked):
    cells = [(x, y, 1) for x in range(3) for y in range(3) if (x, y) != (2, 1)]
    judge = make_checked((4, 3, 2), [(1, 1, 1, 0)], [(Kind.BLOCK, cell) for cell in cells])
    _perform(judge, [LIFT, RIGHT, LEFT, DROP])
