"""Observations: the 13 numbers of each entity, the vectors made of them, plain arrays."""

import pytest

from craftsim.discrete.grid import Kind
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.batches import NO_TARGETS
from craftsim.discrete.tasks.episodes import GridEpisode
from craftsim.discrete.tasks.observation import Layout, as_arrays, design_rows
from craftsim.discrete.tasks.worlds import Worlds
from craftsim.errors import CraftsimError

RULES = Rules("published")


def rows_of(grid, layout):
    return Worlds(RULES, [grid]).entity_rows(layout, NO_TARGETS)[0].tolist()


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


@pytest.mark.parametrize("kind", [Kind.BLOCK, Kind.FSLOPE])
def test_more_things_than_rows_are_told(scene, kind):
    with pytest.raises(CraftsimError, match="more than the 0 slopes and 0 blocks announced"):
        rows_of(scene([(kind, (3, 3, 1), 0)]), Layout(0, 0, 0, None, shows_flag=False))


def test_a_cars_vector_is_its_own_row_and_then_all_rows(rng):
    episode = GridEpisode(make_task("complex_two_story"), rng)
    vectors, layout = episode.vectors(), episode.batch.layout
    assert vectors.shape == (4, layout.vector_length) == (4, 13 * (1 + 4 + 3 * 2 + 6 + 2))
    rows = episode.batch.entity_rows()[0]
    for car in range(4):
        assert vectors[car].tolist() == [*rows[car], *rows.ravel()]


def test_a_design_lists_bodies_feet_as_bodies_and_blocks():
    rows = design_rows(make_task("simple_two_story").design).tolist()
    assert rows == [
        [2, 2, 1, 0, 0, 1, 0, 0, 0, 0, 1, 1, 0],
        [2, 1, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0],
        [2, 3, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0],
        [2, 3, 2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0],
    ]


def test_plain_arrays_show_the_world_and_share_nothing_with_it(scene, car):
    grid = scene([(Kind.BLOCK, (1, 2, 1))], [car(3, 4, yaw=1, load=Kind.FSLOPE)])
    arrays = as_arrays(grid)
    assert arrays["kind"].shape == (7, 7, 3)
    assert arrays["kind"][1, 2, 0] == Kind.BLOCK
    assert [arrays[name].tolist() for name in ("position", "heading", "load", "load_yaw", "slope")] == [
        [[3, 4, 1]],
        [1],
        [Kind.FSLOPE],
        [3],
        [0],
    ]
    for array in arrays.values():
        array[:] = 99
    assert grid.kind[1, 2, 1] == Kind.BLOCK
    assert grid.cars[0, 0] == 3
