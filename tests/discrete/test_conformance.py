"""The published rules agree with recordings of CraftEnv, and the checker notices when something does not."""

import copy
import gzip
import json
from collections import Counter
from pathlib import Path

import pytest

from craftsim.audit.conformance import QUIRK_TAGS, Checker, read_records
from craftsim.discrete.kinds import Correction
from craftsim.discrete.rules import Rules

DATA = Path(__file__).parents[1] / "data"
DERIVED = Correction.derived_marks
FILES = (DATA / "traces.jsonl.gz", DATA / "plans.jsonl.gz")
RECORDED = {"swinging_flap", "turning_load", "reaching_load", "ramp_below_gear", "lasting_gears"}
"""Corrections of what happens in the recordings at all."""


@pytest.fixture(scope="module")
def records():
    return [record for file in FILES for record in read_records(file)]


@pytest.fixture(scope="module")
def ticks(records):
    return [(line, record) for line, record in records if "joint" in record]


def tally_of(records, rule_set):
    checker = Checker(Rules(rule_set))
    for line, record in records:
        checker.check(line, record)
    return checker


def test_published_rules_agree_with_every_record(records):
    tally = tally_of(records, "published")
    assert not tally.mismatches
    assert tally.records == len(records) > 1500
    assert set(tally.checks) == {*TAMPERINGS, "reachable"}
    assert min(tally.checks.values()) > 300
    assert all(tally.applied[name] > 30 for name in ("LIFT", "DROP", "FOLD", "UNFOLD"))


@pytest.fixture(scope="module")
def physical(ticks):
    """The physical rules' count, and the ticks that some correction changes."""
    checker, changed = Checker(Rules("physical")), []
    for line, record in ticks:
        before = checker.corrected
        checker.check(line, record)
        if checker.corrected > before:
            changed.append((line, record))
    return checker, changed


def test_physical_rules_agree_with_every_record_without_a_quirk_that_no_correction_changes(
    ticks, physical
):
    tally, _ = physical
    assert not tally.mismatches
    assert tally.skipped == sum(bool(QUIRK_TAGS & set(record["tags"])) for _, record in ticks) > 50
    assert 20 < tally.corrected < 0.1 * tally.records


def test_each_correction_leaves_all_records_that_it_does_not_change_as_they_are(ticks, physical):
    for switch in (None, *list(Correction.__members__)[1:]):
        checker = Checker(Rules("physical", DERIVED | Correction[switch] if switch else DERIVED))
        for line, record in [*physical[1], *ticks[::24]]:
            checker.check(line, record)
        assert not checker.mismatches, switch
        assert (checker.corrected > 0) == (switch in RECORDED), switch


def test_physical_rules_disagree_exactly_where_marks_drifted(records):
    for line, record in records:
        if "devdep" in record.get("tags", ()):
            checker = Checker(Rules("physical", DERIVED))
            checker.check(line, dict(record, tags=[]))
            assert checker.mismatches.total() > 0


TAMPERINGS = {
    "mask": lambda r: r["mask"].__setitem__(0, "1" * 15),
    "applied": lambda r: r["applied"].__setitem__(0, 1 - r["applied"][0]),
    "objects": lambda r: r["after"]["objs"].pop(),
    "cars": lambda r: r["after"]["cars"][0].__setitem__(
        "yaw", (r["after"]["cars"][0]["yaw"] + 1) % 4
    ),
    "marks": lambda r: r["after"]["dev"]["on"].append([0, 0, 0, -2]),
    "reward": lambda r: r.__setitem__("reward", r["reward"] + 1),
    "done": lambda r: r.__setitem__("done", not r["done"]),
    "observation": lambda r: r["obs"][0].__setitem__(0, r["obs"][0][0] + 1),
    "plan": lambda r: r["cars"][0]["plans"].__setitem__("6", [4]),
}


def test_a_tampered_record_is_a_mismatch_of_its_kind(records):
    whole = next(
        one for one in records if one[1].get("task") == "simple_twolayer" and one[1]["t"] > 3
    )
    planned = next(one for one in records if "depth" in one[1])
    for what, tamper in TAMPERINGS.items():
        line, record = copy.deepcopy(planned if what == "plan" else whole)
        tamper(record)
        assert tally_of([(line, record)], "published").mismatches == Counter({what: 1})


def test_command_draws_the_first_mismatch_and_exits_one(records, tmp_path, capsys):
    from craftsim.cli import main

    record = copy.deepcopy(records[0][1])
    TAMPERINGS["cars"](record)
    (tmp_path / "wrong.jsonl.gz").write_bytes(gzip.compress(json.dumps(record).encode()))
    assert main(["conformance", str(tmp_path / "wrong.jsonl.gz")]) == 1
    out = capsys.readouterr().out
    assert "expected after" in out
    assert "level 1" in out
    assert out.splitlines()[-1].endswith("1 mismatches")
