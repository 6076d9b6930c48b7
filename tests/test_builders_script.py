"""Builders: the designs are fixed, answers are judged, and errors are tried again."""

import json

import builders
import pytest
from builders import BuilderCase, build, builder_figures, chosen_rows, main
from running import RunOptions

from craftsim.designs.tasks import shape_digest
from craftsim.tasks.starts import read_split

DIGEST = "b0ab9f3d7221a99eb270dd6c565ae3e49dd416f1518a4d807299f6c74b801fb7"
"""Of the 30 designs and their starts: tables of other ones cannot be compared."""
ANSWERS = """
from pathlib import Path

def answer(instructions, text):
    if not Path("served").exists():
        raise ConnectionError("the service does not answer")
    assert "Goal:" in instructions
    return "Think first. ANSWER: car_0: fold" if "After tick 0 " in text else "I give up"
"""


def test_the_designs_are_thirty_of_different_shapes():
    starts, ticks = read_split("designs", "test")
    rows = [row for found in chosen_rows().values() for row in found]
    assert [len(found) for found in chosen_rows().values()] == [10, 10, 10]
    assert len({shape_digest(starts.designs[row]) for row in rows}) == 30
    assert all(ticks[row] > 0 for row in rows)


def test_the_planner_that_speaks_builds_within_the_budget():
    done = build(BuilderCase("planner", "grid", chosen_rows()["one level"][0], 0))
    assert done.agrees
    assert done.extra["in_place"] == 1.0
    assert done.extra["acted"] == done.extra["predicted"] > 0
    assert len(done.attempts) <= 20


def test_a_builder_is_judged_in_physics_and_tried_again_after_an_exception(
    tmp_path, monkeypatch, capsys
):
    row = chosen_rows()["one level"][0]
    monkeypatch.setattr(builders, "chosen_rows", lambda: {"one level": [row]})
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own_builder.py").write_text(ANSWERS, encoding="utf-8")
    command = ["own_builder:answer", "--out", "out"]
    assert main(command) == 0
    assert "1 without a result, which --resume tries again" in capsys.readouterr().out
    (tmp_path / "served").touch()
    assert main([*command, "--resume"]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    (found,) = report["figures"]["builders"].values()
    one = found["physics"]["all"]
    assert (one["errors"], one["built"]["successes"], one["built"]["trials"]) == (0, 0, 1)
    assert (one["turns"], one["unreadable"], one["acted"], one["forbidden"]) == (20, 19, 1, 1)
    (turn, *_) = json.loads((tmp_path / "out" / "trials.jsonl").read_text())["attempts"]
    assert turn["answer"] == " car_0: fold"
    assert "car_0: fold: forbidden" in turn["feedback"][0]


@pytest.mark.parametrize("name", ["nobody", "nowhere:answer", "random_strip"])
def test_a_builder_that_there_is_not_is_refused_before_anything_is_built(name, tmp_path, capsys):
    assert main([name, "--out", str(tmp_path / "out")]) == 2
    assert name in capsys.readouterr().err or name == "random_strip"
    assert not (tmp_path / "out" / "session.db").exists()


def test_a_table_of_the_protocol_is_of_these_designs(tmp_path, monkeypatch):
    monkeypatch.setattr(builders, "build", _built)
    report = builders.builders_report(["random"], 10, 0, tmp_path / "out", RunOptions())
    assert report.document["config"]["designs"] == {"each": 10, "digest": DIGEST}
    found = report.document["figures"]["builders"]["random"]["grid"]
    assert found["two levels"]["built"].trials == 10
    assert found["all"]["in_place"].value == pytest.approx(0.5)


def _built(case):
    counts = dict.fromkeys(("predicted", "allowed", "acted", "unreadable", "turns"), 1)
    return builders.Result(
        case.row % 2 == 0, extra={"built": case.row % 2 == 0, "in_place": 0.5, **counts}
    )


def test_a_design_without_a_result_counts_as_not_built():
    counts = dict.fromkeys(("predicted", "allowed", "acted", "unreadable", "turns"), 2)
    done = {"error": None, "extra": {"built": True, "in_place": 1.0, **counts}}
    found = builder_figures([done, {"error": "no answer", "extra": {}}])
    assert (found["built"].successes, found["built"].trials, found["errors"]) == (1, 2, 1)
    assert found["in_place"].value == pytest.approx(0.5)
