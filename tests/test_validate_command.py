"""``craftsim validate``: what it runs, what it writes, its exit status, and what it refuses."""

import json
import textwrap

import pytest

from craftsim import cli

CROWDED = """
    area_length: 6
    area_width: 3
    area_height: 2
    block_num: 1
    slope_num: 1
    smartcar_num: 1
    block:
      - {id: 0, x: 4, y: 1, z: 1}
    fold_slope:
      - {id: 0, x: 2, y: 1, z: 1, yaw: 0}
    smartcar:
      - {id: 0, x: 2, y: 1, z: 1, yaw: 2}
"""
"""A block stands where the lip of the slope swings; only the published rules allow that."""

EMPTY = """
    area_length: 3
    area_width: 3
    area_height: 1
    block_num: 0
    slope_num: 0
    smartcar_num: 1
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Work in a folder with a blueprint and a list of actions."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    (tmp_path / "crowded.yaml").write_text(textwrap.dedent(CROWDED))
    (tmp_path / "empty.yaml").write_text(textwrap.dedent(EMPTY))
    (tmp_path / "unfold.txt").write_text("0 STOP\n0 UNFOLD  # here\n0 LIFT\n")
    return tmp_path


def _validate(*words, out="out"):
    return cli.main(["validate", *words, "--video", "none", "--out", out])


def _report(folder):
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    del report["wall"]
    return report


def _records(folder):
    return [json.loads(line) for line in (folder / "trials.jsonl").read_text().splitlines()]


def test_a_disagreement_is_found_kept_to_replay_and_equal_however_it_is_run(folder, capsys):
    words = ["crowded.yaml", "--actions", "unfold.txt", "--rules", "published", "--trials", "2"]
    assert _validate(*words) == 1
    told = capsys.readouterr().out
    assert "crowded/unfold/0000: tick 1 car 0 UNFOLD: side effect: slope 0 touched block 0" in told
    records = _records(folder / "out")
    assert [record["key"] for record in records] == [f"crowded/unfold/000{i}" for i in range(2)]
    first = records[0]
    assert [attempt["result"] for attempt in first["attempts"]][:2] == ["as predicted", "side effect"]
    assert [attempt["legal"] for attempt in first["attempts"]] == [True, True, False]
    assert (folder / "out" / first["bundle"] / "bundle.json").exists()
    assert cli.main(["replay", str(folder / "out" / first["bundle"]), "--out", "replay"]) == 0
    assert "slope 0 touched block 0" in (folder / "out" / "report.html").read_text(encoding="utf-8")
    report = _report(folder / "out")
    assert report["figures"]["validation"]["trials"] == 2
    # As if killed while the second line was written.
    lines = (folder / "out" / "trials.jsonl").read_bytes()
    (folder / "out" / "trials.jsonl").write_bytes(lines[: lines.index(b"\n") + 100])
    (folder / "out" / "report.json").unlink()
    assert _validate(*words, "--workers", "2", "--resume") == 1
    assert _report(folder / "out") == report
    assert (folder / "out" / "trials.jsonl").read_bytes() == lines


def test_the_shipped_plan_reaches_its_goal_in_physics(folder):
    assert _validate("strip", "--trials", "1", "--randomize", "none") == 0
    (record,) = _records(folder / "out")
    assert record["extra"] == {"ticks": 11, "forbidden": 0, "grid_success": True, "physics_success": True}
    assert record["group"] == "planner"
    assert {attempt["result"] for attempt in record["attempts"]} == {"as predicted"}


def test_policies_that_raise_or_hang_or_talk_nonsense_are_errors_and_harm_no_other(folder):
    (folder / "own.py").write_text(
        "import time\n"
        "def stops(seen): return {name: 6 for name in seen}\n"
        "def raises(seen): raise RuntimeError('no idea')\n"
        "def hangs(seen): time.sleep(3600)\n"
        "def nonsense(seen): return {name: 99 for name in seen}\n"
    )
    names = ["own:stops", "own:raises", "own:hangs", "own:nonsense", "random"]
    words = ["empty.yaml", "--policy", *names, "--trials", "1", "--timeout", "10"]
    assert _validate(*words) == 1
    stops, raises, hangs, nonsense, random = _records(folder / "out")
    assert raises["error"] == "RuntimeError: no idea"
    assert "own.py" in raises["extra"]["traceback"]
    assert hangs["error"] == "no answer within 10 s"
    assert "99" in nonsense["error"]
    for record in (stops, random):
        assert record["agrees"]
        assert len(record["attempts"]) + record["extra"]["forbidden"] == record["extra"]["ticks"] == 20


@pytest.fixture
def earlier(folder):
    """Run a list that the rules forbid, and put one in its place that they allow."""
    (folder / "list.txt").write_text("0 LIFT\n")
    words = ["empty.yaml", "--actions", "list.txt", "--trials", "2"]
    assert _validate(*words, out="earlier") == 1
    (folder / "list.txt").write_text("0 STOP\n")
    return words


def test_against_pairs_the_runs_with_those_of_an_earlier_campaign(folder, earlier, capsys):
    assert _validate(*earlier, "--against", "earlier") == 0
    told = capsys.readouterr().out
    assert (
        "of 2 paired trials 0 agree with the rules in both, 0 only there, 2 only here, 0 in neither" in told
    )
    assert "p = 0.5" in told
    report = _report(folder / "out")
    assert report["config"]["against"] == "earlier"
    paired = report["figures"]["paired"]
    assert paired["against"] == "earlier"
    assert list(paired["changed"]) == ["config.by.list"]
    trials = paired["trials"]
    assert [trials[key] for key in ("pairs", "only_first", "only_second", "p_value")] == [2, 0, 2, 0.5]
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert "this run alone" in page
    assert "p = 0.5" in page
    assert "--against earlier" in page
    # The earlier run decides nothing of this one, so that it can be compared later on, too.
    assert _validate(*earlier, "--resume") == 0
    assert _report(folder / "out")["figures"]["paired"] is None


def test_against_refuses_what_cannot_be_paired_before_anything_is_tried(folder, earlier, capsys):
    def refused(*words, out="out"):
        assert _validate(*(words or earlier), "--against", "earlier", out=out) == 2
        assert not (folder / "out" / "campaign.json").exists()
        return capsys.readouterr().err

    kept = (folder / "earlier" / "trials.jsonl").read_bytes()
    assert "is the folder of this run" in refused(out="earlier")
    assert (folder / "earlier" / "trials.jsonl").read_bytes() == kept
    assert "has the seed 0, not 1" in refused(*earlier, "--seed", "1")
    assert "no trial in common" in refused("crowded.yaml", *earlier[1:])
    (folder / "earlier" / "trials.jsonl").write_bytes(kept[: kept.index(b"\n") + 1])
    assert "an unfinished campaign (1 of 2 trials)" in refused()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["crowded.yaml"], "no shipped plan"),
        (["strip", "--against", "nowhere"], "nowhere holds no campaign"),
        (["missing.yaml"], "missing.yaml"),
        (["crowded.yaml", "--actions", "missing.txt"], "missing.txt"),
        (["crowded.yaml", "--plan", "unfold.txt"], "unfold.txt:1: 2 words, but a line is: tick car ACTION"),
        (["crowded.yaml", "--plan", "unfold.txt", "--policy", "random"], "--plan and --policy exclude"),
        (["crowded.yaml", "strip", "--actions", "unfold.txt"], "--actions needs the one blueprint"),
        (["crowded.yaml", "crowded.yaml", "--policy", "random"], "two blueprints are called 'crowded'"),
        (["crowded.yaml", "--policy", "own:nothing"], "own:nothing"),
        (["crowded.yaml", "--policy", "random", "--trials", "0"], "--trials"),
        (["crowded.yaml", "--policy", "random", "--timeout", "0"], "--timeout"),
    ],
)
def test_wrong_input_is_told_and_leaves_nothing(folder, capsys, words, message):
    assert _validate(*words) == 2
    assert message in capsys.readouterr().err
    assert not (folder / "out" / "campaign.json").exists()
