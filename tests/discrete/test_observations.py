"""Observations: vectors of rows, and rows of a design. Rows of worlds are recorded: test_conformance."""

import pytest

from craftsim.discrete.grid import Kind
from craftsim.discrete.tasks import make_task
from craftsim.discrete.tasks.episodes import Episodes
from craftsim.discrete.tasks.observation import Layout, entity_rows, target_rows
from craftsim.discrete.tasks.starts import targets_of
from craftsim.errors import CraftsimError


def test_more_things_than_rows_are_told(scene):
    for kind in (Kind.BLOCK, Kind.FSLOPE):
        with pytest.raises(CraftsimError, match="more than the 0 slopes and 0 blocks announced"):
            entity_rows(
                scene([(kind, (3, 3, 1), 0)])[None],
                Layout(0, 0, 0, None, shows_flag=False),
                targets_of(None)[None],
            )


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
