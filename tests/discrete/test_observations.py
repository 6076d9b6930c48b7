"""Observations: the 13 numbers of each entity, and the vectors made of them."""

import pytest

from craftsim.discrete.grid import Kind
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.observation import Layout, entity_rows, target_rows
from craftsim.discrete.tasks.starts import targets_of
from craftsim.errors import CraftsimError


def rows_of(grid, layout):
    return entity_rows(grid[None], layout, targets_of(None)[None])[0].tolist()


def test_rows_list_carried_things_first_then_the_grid_in_scan_order(scene, car):
    grid = scene(
        [(Kind.BLOCK, (5, 1, 1)), (Kind.BLOCK, (1, 5, 1)), (Kind.BODY, (3, 3, 1), 2), (Kind.FLAG, (6, 6, 1))],
        [car(0, 0, yaw=1, load=Kind.FSLOPE), car(4, 4, yaw=2, load=Kind.BLOCK)],
    )
    rows = rows_of(grid, Layout(2, 2, 4, (6, 0, 1), shows_flag=True))
    assert rows == [
        [0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 1, 1],
        [4, 4, 1, 1, 0, 0, 0, 0, 0, 0, 1, 0, 1],
        [0, 0, 1, 0, 1, 0, 0, 0, 0, 0, 1, 1, 0],
        [0] * 13,
        [3, 3, 1, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0],
        [0] * 13,
        [2, 3, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0],
        [0] * 13,
        [4, 4, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0],
        [1, 5, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0],
        [5, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0],
        [0] * 13,
        [6, 6, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0],
        [6, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0],
    ]


def test_where_the_flag_is_not_shown_its_row_repeats_the_goal(scene):
    rows = rows_of(scene([(Kind.FLAG, (6, 6, 1))]), Layout(0, 0, 0, None, shows_flag=False))
    assert rows == [[-1, -2, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]] * 2


def test_a_carried_flag_is_where_its_car_is(scene, car):
    grid = scene([], [car(2, 3, load=Kind.FLAG)])
    assert rows_of(grid, Layout(1, 0, 0, None, shows_flag=True))[1][:9] == [2, 3, 1, 0, 0, 0, 0, 0, 1]


def test_more_things_than_rows_are_told(scene):
    for kind in (Kind.BLOCK, Kind.FSLOPE):
        with pytest.raises(CraftsimError, match="more than the 0 slopes and 0 blocks announced"):
            rows_of(scene([(kind, (3, 3, 1), 0)]), Layout(0, 0, 0, None, shows_flag=False))


def test_a_cars_vector_is_its_own_row_and_then_all_rows(rng):
    episodes = Episodes(make_task("complex_two_story"), rng)
    vectors, layout = episodes.vectors()[0], episodes.layout
    assert vectors.shape == (4, layout.vector_length) == (4, 13 * (1 + 4 + 3 * 2 + 6 + 2))
    rows = episodes.entity_rows()[0]
    for car in range(4):
        assert vectors[car].tolist() == [*rows[car], *rows.ravel()]


def test_what_is_to_be_built_has_rows_as_things_there_would_have_and_is_marked():
    design = make_task("simple_two_story").design
    rows = dict(zip(design.targets, target_rows(targets_of(design)).tolist(), strict=True))
    assert {(target.kind, *row) for target, row in rows.items()} == {
        (Kind.BODY, 2, 2, 1, 0, 0, 1, 0, 0, 0, 1, 1, 1, 0),
        (Kind.FOOT, 2, 1, 1, 0, 0, 0, 1, 0, 0, 1, 1, 1, 0),
        (Kind.BLOCK, 2, 3, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0),
        (Kind.BLOCK, 2, 3, 2, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0),
    }
