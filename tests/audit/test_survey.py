"""What a car can be in: found by walking the product, legal each one, and worlds that stand in physics."""

from collections import Counter

import numpy as np
import pytest

from craftsim.audit.situation import Row
from craftsim.audit.survey import GROUNDS, LOAD_KINDS, acts, row_of, situation_of, survey
from craftsim.discrete.actions import verbs
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import MOVE_DIRECTION
from craftsim.discrete.readback import read_grid
from craftsim.discrete.rules import Rules
from craftsim.errors import CraftsimError
from craftsim.models.world import PhysicsWorld

RULES = Rules("physical")


def _allowed():
    return [one for one, legal in survey() if legal]


def _rows():
    return {one.row for one in _allowed()}


def _placed(situation, seed=0):
    return situation.placed(np.random.default_rng(seed))


def test_what_the_rules_allow_and_forbid_are_apart_and_everything_that_differs_occurs():
    rows = _rows()
    # A change of this number is to be looked at: it says that the rules changed.
    assert len(_allowed()) == len(rows) == 1406
    forbidden = {one.row for one, legal in survey() if not legal}
    assert not rows & forbidden
    assert ("LIFT", True) in {(row.action, row.ground != "flat") for row in forbidden}
    assert {row.action for row in rows} == set(acts())
    assert {spec.verb for spec, _ in acts().values()} == set(verbs())
    assert {row.load for row in rows} == set(LOAD_KINDS)
    assert {row.ground for row in rows} == set(GROUNDS)
    kinds = {"air", "block", "flag", "fslope", "body", "gear", "foot"}
    assert {row.own.split("-")[0] for row in rows} == kinds


def test_the_sides_of_a_car_are_alike_and_so_are_levels_above_the_first():
    rows = _rows()
    counts = Counter(row.action for row in rows) + Counter(row.level for row in rows)
    assert counts["MOVE-left"] == counts["MOVE-right"]
    assert counts["ROTATE_LEFT"] == counts["ROTATE_RIGHT"]
    assert counts["2"] == counts["3"] > counts["1"]  # on level 1 there is no ramp down


def test_a_world_is_what_its_row_says():
    for situation in _allowed():
        row, placed = situation.row, _placed(situation, 1)
        assert placed.legal(RULES), row
        x, y, z, yaw, load, _, slope = (int(v) for v in placed.grid.cars[0])
        assert (z, load, slope) == (int(row.level), LOAD_KINDS[row.load], GROUNDS[row.ground][0]), (
            row
        )
        assert placed.grid.kind[x, y, z].item() == Kind[row.own.split("-")[0].upper()], row
        if row.next:
            way = acts()[row.action][1]
            dx, dy = ((1, 0), (0, 1), (-1, 0), (0, -1))[(yaw + way) % 4]
            assert MOVE_DIRECTION[placed.acts[0]] == (yaw + way) % 4
            there = placed.grid.kind[x + dx, y + dy, z - row.next.startswith("above-")]
            assert there == Kind[row.next.removeprefix("above-").split("-")[0].upper()], row


def test_each_world_stands_in_physics_as_drawn():
    for situation in _allowed()[::47]:
        grid = _placed(situation, 2).grid
        physics = PhysicsWorld(grid)
        reading = read_grid(physics.poses(), physics.size, physics.walls)
        assert reading.problems == (), situation.id
        assert reading.grid.same_visible(grid), situation.id


def test_a_row_gives_the_situation_that_the_survey_found():
    for one in _allowed()[::17]:
        same = situation_of(one.row, "physical")
        assert same == one
        assert same.grid.same_visible(one.grid)


def test_a_combination_that_is_none_says_why():
    with pytest.raises(
        CraftsimError, match="a load and what the car stands under would share a cell"
    ):
        situation_of(row_of({"action": "LIFT", "own": "block", "load": "block"}), "physical")
    with pytest.raises(CraftsimError, match="the rules forbid it"):
        situation_of(row_of({"action": "LIFT"}), "physical")


def test_a_file_says_what_is_not_usual():
    said = {"action": "MOVE-forward", "level": 2, "then": ["LIFT"]}
    assert row_of(said) == Row(
        "MOVE-forward", "2", "flat", "air", "none", "air", room="free", then=("LIFT",)
    )
    assert row_of({"action": "FOLD", "scene": "cars beside"}) == Row("FOLD", scene="cars beside")
