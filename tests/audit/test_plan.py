"""The audit's rows cover every situation once, and forbidden actions have an intended effect or a reason for none."""

from collections import Counter

import numpy as np
import pytest

from craftsim.audit.audit import trials_of
from craftsim.audit.neighbours import nearby
from craftsim.audit.plan import audit_plan, distribute_trials
from craftsim.audit.situation import ImpossibleError, intended, scenes
from craftsim.audit.survey import survey
from craftsim.checking.setup import setup_of
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.rules import Rules

RULES = ("published", "physical")
BOTH = pytest.mark.parametrize("rules", RULES)


@BOTH
def test_every_situation_is_in_exactly_one_row(rules):
    members = [member.row for row in audit_plan(rules) for member in row.members]
    every = [*(one for one, _ in survey(rules)), *scenes(), *(near for near, _, _ in nearby(rules))]
    assert Counter(members) == Counter(situation.row for situation in every)
    rows = audit_plan(rules)
    assert len({row.row for row in rows}) == len({row.name for row in rows}) == len(rows)
    assert len({member.id for row in rows for member in row.members}) == len(members)


@BOTH
def test_what_a_row_says_of_legality_holds_for_all_its_members(rules):
    for row in audit_plan(rules)[::7]:
        for member in row.members[:4]:
            assert member.placed(np.random.default_rng(3)).legal(Rules(rules)) == row.legal


def test_what_is_legal_has_its_effect_intended():
    for row in audit_plan("physical"):
        placed = row.members[0].placed(np.random.default_rng(5))
        if row.legal and not row.row.scene:
            after = Rules("physical").apply(placed.grid, 0, placed.acts[0])
            assert intended(placed.grid, 0, placed.acts[0]).same_visible(after), row.members[0].id


def test_physical_allows_nothing_that_published_forbids():
    allowed = {
        rules: {one.row for one, legal in survey(rules) if legal and one.row.room != "tight"}
        for rules in RULES
    }
    assert allowed["physical"] < allowed["published"]


def test_what_the_physical_rules_allow_begins_where_their_play_can_lead():
    close = [
        near.clearance_mm
        for near, legal, _ in nearby("physical")
        if legal and near.clearance_mm is not None
    ]
    assert min(close, default=1) > 0


@BOTH
def test_a_full_audit_tries_each_row_often_and_each_context_and_stays_within_its_time(rules):
    items = trials_of(audit_plan(rules), 20, 0, setup_of("mild", rules))
    assert len({item.key for item in items}) == len(items) < 30_000
    tried = Counter(item.group for item in items if item.job is not None)
    assert min(tried.values()) >= 20
    assert set(tried) == {row.name for row in audit_plan(rules) if not row.no_prediction}
    contexts = {item.context for item in items if item.job is not None}
    assert contexts == {
        m.id for row in audit_plan(rules) if not row.no_prediction for m in row.members
    }


def test_where_nothing_is_drawn_each_situation_is_tried_once_for_all_its_trials():
    drawn, fixed = (
        [
            item
            for item in trials_of(audit_plan("physical"), 20, 0, setup_of(how))
            if item.job is not None
        ]
        for how in ("mild", "none")
    )
    assert len(fixed) == len({item.context for item in drawn}) < len(drawn)
    assert {item.key for item in fixed} <= {item.key for item in drawn}
    assert sum(item.job.identical for item in fixed) == len(drawn)


def test_trials_are_spread_evenly_over_the_members_of_a_row():
    row = max(audit_plan("published"), key=lambda row: (not row.no_prediction, len(row.members)))
    counts = Counter(member.id for member, _ in distribute_trials(row, 2 * len(row.members) + 1))
    assert sorted(set(counts.values())) == [2, 3]
    assert len(list(distribute_trials(row, 1))) == len(row.members)


def _alone(car, *things) -> Grid:
    grid = Grid.empty((4, 4, 3), 1)
    grid.cars[0] = car
    for kind, cell in things:
        grid.kind[cell] = kind
    grid.derive_marks()
    return grid


def test_where_nothing_is_intended_there_is_a_reason_and_else_the_next_cell():
    bare, car, block = (
        (1, 1, 1, 0, 0, 0, 0),
        (1, 1, 1, 0, Kind.BLOCK, 0, 0),
        (Kind.BLOCK, (2, 1, 1)),
    )
    for grid, action, reason in (
        (_alone(bare), Action.LIFT, "nothing to lift"),
        (_alone(bare), Action.UNFOLD, "nothing to unfold"),
        (_alone((0, 1, 1, 0, 0, 0, 0)), Action.MOVE_LEFT, "the map ends there"),
        (_alone(bare, (Kind.WALL, (2, 1, 1))), Action.MOVE_RIGHT, "a wall is there"),
        (_alone(car, block), Action.MOVE_RIGHT, "share a cell"),
        (_alone((1, 1, 2, 0, 0, 0, 0), (Kind.BLOCK, (1, 1, 1))), Action.MOVE_RIGHT, "no ground"),
    ):
        with pytest.raises(ImpossibleError, match=reason):
            intended(grid, 0, action)
    under = _alone(bare, (Kind.BLOCK, (1, 1, 1)))
    assert not Rules("physical").legal(under, 0, Action.MOVE_FORWARD)
    assert intended(under, 0, Action.MOVE_FORWARD).cars[0, :2].tolist() == [1, 2]
