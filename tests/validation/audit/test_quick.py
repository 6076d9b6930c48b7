"""A quick look tries what the rules differ in; ``make plants`` shows that it finds unsound rules in physics."""

from dataclasses import replace

import pytest

from craftsim.discrete.kinds import Correction
from craftsim.discrete.reasons import REASONS
from craftsim.discrete.rules import Rules
from craftsim.validation.audit.corrections import start_of
from craftsim.validation.audit.quick import MOST_ROWS, covering, properties, quick_rows
from craftsim.validation.audit.rows import audit_plan


@pytest.fixture(scope="module")
def plan():
    return audit_plan("physical")


@pytest.fixture(scope="module")
def quick(plan):
    return quick_rows(plan, "physical")


def test_it_is_a_part_of_the_plan_one_situation_a_row(plan, quick):
    members = {(row.name, row.legal): row.members for row in plan}
    assert 100 < len(quick) <= MOST_ROWS < len(plan)
    assert all(row.members == members[row.name, row.legal][:1] and not row.no_prediction for row in quick)
    assert quick == quick_rows(plan, "physical")


def test_every_pair_of_properties_of_what_is_allowed_is_tried(plan, quick):
    def pairs(rows):
        for row in rows:
            found = properties(row.name)
            yield from (
                (found["action"], key, found[key], other, found[other])
                for key in found
                for other in found
                if row.legal and key < other
            )

    tried = [row for row in plan if not row.no_prediction]
    assert set(pairs(quick)) == set(pairs(tried))


def test_all_scenes_that_are_allowed_are_tried(plan, quick):
    scenes = {row.name for row in plan if row.legal and "/scene=" in row.name}
    assert scenes <= {row.name for row in quick if row.legal}


def test_each_flag_that_forbids_has_rows_on_both_sides(plan, quick):
    def forbidding(rows):
        starts = [start_of(row.members[0], "physical") for row in rows if not row.legal]
        return {Rules("physical").explain(grid, 0, actions[0]).correction for grid, actions in starts}

    assert forbidding(quick) == forbidding([row for row in plan if not row.no_prediction])


@pytest.mark.parametrize(
    "flag", [reason.correction.name for reason in REASONS.values() if reason.correction is not None]
)
def test_a_rule_flag_switched_off_shows_in_what_is_tried(plan, flag):
    """The plan of a rule set without the flag, made from the one with it: the rows it would allow are allowed."""
    rules = Rules("physical", ~Correction[flag])
    changed, rows = set(), []
    for row in plan:
        freed = set() if row.legal else {member for member in row.members if _allows(rules, member)}
        if freed:
            name = row.name if not row.no_prediction else sorted(member.id for member in freed)[0]
            changed.add(name)
            allowed = tuple(member for member in row.members if member in freed)
            rows.append(replace(row, name=name, legal=True, members=allowed, no_prediction=""))
        if rest := tuple(member for member in row.members if member not in freed):
            rows.append(replace(row, members=rest))
    if not changed:
        pytest.skip("no row changes")
    tried = {row.name for row in quick_rows(rows, "physical") if row.legal}
    assert len(tried & changed) >= min(3, len(changed))


def _allows(rules, situation):
    grid, actions = start_of(situation, "physical")
    return bool(rules.tick(grid, [(car, int(a)) for car, a in enumerate(actions)])[1].all())


def test_a_cover_takes_no_more_than_it_may_and_nothing_in_vain():
    names = [f"GO/a={a}/b={b}/c={c}" for a in "12" for b in "12" for c in "12"]
    assert covering(names, [], 99, strength=1) == ["GO/a=1/b=1/c=1", "GO/a=2/b=2/c=2"]
    assert len(covering(names, [], 99, strength=2)) < len(names)
    assert sorted(covering(names, [], 99, strength=3)) == names
    assert len(covering(names, [], 3)) == 3
    assert covering(names, names, 99) == []


def test_a_neighbours_column_and_level_are_properties():
    assert properties("LIFT/load=none/near=car+block-low-left@(1,0,-1)") == {
        "action": "LIFT",
        "load": "none",
        "near": "car+block-low-left",
        "column": "1,0",
        "above": "-1",
    }
    assert properties("MOVE-left/near=car/allowed out of reach") == {
        "action": "MOVE-left",
        "near": "car",
        "kind": "allowed out of reach",
    }
