"""A quick look tries what the rules differ in; ``plants.py`` shows that it finds unsound rules in physics."""

import pytest

from craftsim.audit.plan import MOST_ROWS, PlanRow, audit_plan, covering, quick_rows
from craftsim.audit.situation import Row
from craftsim.discrete.kinds import Correction
from craftsim.discrete.rules import REASONS, Rules


@pytest.fixture(scope="module")
def plan():
    return audit_plan("physical")


@pytest.fixture(scope="module")
def quick(plan):
    return quick_rows(plan, "physical")


def test_it_is_a_part_of_the_plan_one_situation_a_row(plan, quick):
    members = {(row.name, row.legal): row.members for row in plan}
    assert 100 < len(quick) <= MOST_ROWS < len(plan)
    assert all(
        row.members == members[row.name, row.legal][:1] and not row.no_prediction for row in quick
    )
    assert quick == quick_rows(plan, "physical")


def test_every_pair_of_properties_of_what_is_allowed_is_tried(plan, quick):
    def pairs(rows):
        for row in rows:
            said = [(key, word) for key, word in row.row._asdict().items() if word]
            yield from (
                (row.row.action, one, other)
                for one in said
                for other in said
                if row.legal and one < other
            )

    tried = [row for row in plan if not row.no_prediction]
    assert set(pairs(quick)) == set(pairs(tried))
    assert {row.name for row in plan if row.legal and row.row.scene} <= {
        row.name for row in quick if row.legal
    }


def test_each_flag_that_forbids_has_rows_on_both_sides(plan, quick):
    def forbidding(rows):
        starts = [row.members[0] for row in rows if not row.legal]
        return {Rules("physical").explain(one.grid, 0, one.acts[0]).correction for one in starts}

    assert forbidding(quick) == forbidding([row for row in plan if not row.no_prediction])


@pytest.mark.parametrize(
    "flag",
    [reason.correction.name for reason in REASONS.values() if reason.correction is not None][::4],
)
def test_a_rule_flag_switched_off_shows_in_what_is_tried(plan, flag):
    """The plan of a rule set without the flag, made from the one with it: the rows it would allow are allowed."""
    rules = Rules("physical", ~Correction[flag])
    changed, rows = set(), []
    for row in plan:
        freed = set() if row.legal else {member for member in row.members if member.legal(rules)}
        if freed:
            named = (
                row.row if not row.no_prediction else min((member.row for member in freed), key=str)
            )
            changed.add(named)
            allowed = tuple(member for member in row.members if member in freed)
            rows.append(PlanRow(named, True, allowed))
        if rest := tuple(member for member in row.members if member not in freed):
            rows.append(row._replace(members=rest))
    if not changed:
        pytest.skip("no row changes")
    tried = {row.row for row in quick_rows(rows, "physical") if row.legal}
    assert len(tried & changed) >= min(3, len(changed))


def test_a_cover_takes_no_more_than_it_may_and_nothing_in_vain():
    rows = [Row("GO", level=a, own=b, load=c) for a in "12" for b in "12" for c in "12"]
    assert covering(rows, [], 99, strength=1) == [rows[0], rows[-1]]
    assert len(covering(rows, [], 99, strength=2)) < len(rows)
    assert sorted(covering(rows, [], 99, strength=3)) == rows
    assert len(covering(rows, [], 3)) == 3
    assert covering(rows, rows, 99) == []
