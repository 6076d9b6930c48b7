"""``craftsim validate``: what it runs, what it writes, its exit status, and what it refuses."""

import json
import textwrap

import pytest
from validation.campaign.sessions import cut_off

from craftsim import cli
from craftsim.cli import films
from craftsim.workers.pool import Pool

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

WHEELS = ("--drive", "wheels")


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
    return cli.main(["validate", *words, *WHEELS, "--video", "none", "--out", out])


def _report(folder):
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    del report["wall"]
    return report


def _records(folder):
    return [json.loads(line) for line in (folder / "trials.jsonl").read_text().splitlines()]


@pytest.fixture
def here(monkeypatch):
    """Let the work be done in this process, so that what is patched here is what is done."""

    def map_unordered(pool, function, jobs, timeout_s, batch):
        return ((job, function(job)) for job in jobs)

    monkeypatch.setattr(Pool, "map_unordered", map_unordered)


def test_a_disagreement_is_found_kept_to_replay_and_equal_however_it_is_run(folder, capsys):
    words = ["crowded.yaml", "--actions", "unfold.txt", "--rules", "published", "--trials", "2"]
    assert _validate(*words) == 1
    told = capsys.readouterr().out
    assert "crowded/unfold/0000: tick 1, car 0 UNFOLD: side effect: block 0 was moved by " in told
    assert "mm (allowed 1.25); slope 0 touched block 0" in told
    records = _records(folder / "out")
    assert [record["key"] for record in records] == [f"crowded/unfold/000{i}" for i in range(2)]
    first = records[0]
    assert [attempt["result"] for attempt in first["attempts"]][:2] == [
        "as predicted",
        "side effect",
    ]
    assert [attempt["legal"] for attempt in first["attempts"]] == [True, True, False]
    assert (folder / "out" / first["bundle"] / "bundle.json").exists()
    assert cli.main(["replay", str(folder / "out" / first["bundle"]), "--out", "replay"]) == 0
    assert "slope 0 touched block 0" in (folder / "out" / "report.html").read_text(encoding="utf-8")
    report = _report(folder / "out")
    assert report["figures"]["validation"]["trials"] == 2
    # As if killed while the second line was written.
    lines = (folder / "out" / "trials.jsonl").read_bytes()
    cut_off(folder / "out", (0,))
    (folder / "out" / "report.json").unlink()
    assert _validate(*words, "--workers", "2", "--resume") == 1
    assert _report(folder / "out") == report
    assert (folder / "out" / "trials.jsonl").read_bytes() == lines


@pytest.mark.usefixtures("here")
def test_a_plan_that_the_rules_forbid_is_not_tried_and_the_rule_is_told(folder, capsys):
    (folder / "forbidden.plan").write_text("0 0 UNFOLD\n")
    assert (
        _validate(
            "crowded.yaml", "--plan", "forbidden.plan", "--trials", "1", "--randomize", "none"
        )
        == 1
    )
    told = capsys.readouterr().out
    assert "crowded/forbidden/0000: tick 0, car 0 UNFOLD: not tried: the rules forbid it: " in told
    assert told.splitlines()[-1] == (
        "The plan or policy breaks a rule. 1 run asked for what the rules forbid, which was not tried. "
        "All else went as predicted."
    )
    (record,) = _records(folder / "out")
    (attempt,) = record["attempts"]
    assert (attempt["legal"], attempt["performed"], record["bundle"]) == (False, False, None)
    assert "(4, 1, 1)" in attempt["reason"], "the cell in the way is named"
    matrix = _report(folder / "out")["figures"]["validation"]["matrix"]
    assert (matrix["legal"]["trials"], matrix["forbidden"]["trials"]) == (0, 0)
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert '<span class="verdict">Forbidden by the rules</span>' in page
    assert "physics disagrees" not in page
    assert "tried on purpose" not in page


@pytest.mark.usefixtures("rendering", "here")
def test_films_of_every_run_and_none_of_an_earlier_campaign(folder, monkeypatch):
    monkeypatch.setattr(films, "SIZE", (96, 64))
    (folder / "short.txt").write_text("0 STOP\n")
    words = [
        "empty.yaml",
        "--actions",
        "short.txt",
        "--randomize",
        "none",
        "--trials",
        "1",
        *WHEELS,
    ]
    words += ["--out", "out"]
    assert cli.main(["validate", *words, "--video", "all"]) == 0
    film = folder / "out" / "films" / "empty-short-0000.mp4"
    assert film.stat().st_size > 500
    (folder / "other.txt").write_text("0 STOP\n0 STOP\n")
    words[2] = "other.txt"
    assert cli.main(["validate", *words, "--video", "all"]) == 0
    assert [path.name for path in (folder / "out" / "films").iterdir()] == ["empty-other-0000.mp4"]


@pytest.fixture
def earlier(folder, here):
    """Run a list that the rules forbid, and put one in its place that they allow."""
    (folder / "list.txt").write_text("0 LIFT\n")
    words = ["empty.yaml", "--actions", "list.txt", "--trials", "2"]
    assert _validate(*words, out="earlier") == 1
    (folder / "list.txt").write_text("0 STOP\n")
    return words


@pytest.mark.usefixtures("here")
def test_against_pairs_the_runs_with_those_of_an_earlier_campaign(folder, earlier, capsys):
    assert _validate(*earlier, "--baseline", "earlier") == 0
    told = capsys.readouterr().out
    assert (
        "of 2 paired trials 0 agree with the rules in both, 0 only there, 2 only here, 0 in neither"
        in told
    )
    assert "p = 0.5" in told
    report = _report(folder / "out")
    assert report["config"]["against"] == "earlier"
    paired = report["figures"]["paired"]
    assert paired["against"] == "earlier"
    assert list(paired["changed"]) == ["config.by.list"]
    trials = paired["trials"]
    assert [trials[key] for key in ("pairs", "only_first", "only_second", "p_value")] == [
        2,
        0,
        2,
        0.5,
    ]
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert "this run alone" in page
    assert "p = 0.5" in page
    assert "--baseline earlier" in page
    # The earlier run decides nothing of this one, so that it can be compared later on, too.
    assert _validate(*earlier, "--resume") == 0
    assert _report(folder / "out")["figures"]["paired"] is None


@pytest.mark.usefixtures("here")
def test_against_refuses_what_cannot_be_paired_before_anything_is_tried(folder, earlier, capsys):
    def refused(*words, out="out"):
        assert _validate(*(words or earlier), "--baseline", "earlier", out=out) == 2
        assert not (folder / "out" / "session.db").exists()
        return capsys.readouterr().err

    kept = (folder / "earlier" / "trials.jsonl").read_bytes()
    assert "is the folder of this run" in refused(out="earlier")
    assert (folder / "earlier" / "trials.jsonl").read_bytes() == kept
    assert "has the seed 0, not 1" in refused(*earlier, "--seed", "1")
    assert "no trial in common" in refused("crowded.yaml", *earlier[1:])
    cut_off(folder / "earlier", (0,))
    assert "an unfinished run (1 of 2 trials)" in refused()


WRONG = {
    "strip --baseline nowhere": "nowhere holds no run",
    "missing.yaml": "missing.yaml",
    "crowded.yaml --actions missing.txt": "missing.txt",
    "crowded.yaml --plan unfold.txt": "unfold.txt:1: 2 words, but a line is: tick car ACTION",
    "crowded.yaml strip --actions unfold.txt": "actions needs the one world",
    "crowded.yaml --policy os:system": "policy 'os:system' raised TypeError",
    "random --cars 2 --policy builtins:len": "policy 'builtins:len' returned int",
    "crowded.yaml --policy random --workers 0": "--workers",
    "random --cars 13": "allowed: 1 to 12 cars",
    "random --max-steps 0": "--max-steps is 0",
    "random --policy planner": "no shipped plan for random",
    "castle": "castle",
    "crowded.yaml --policy random --timeout 0": "--timeout",
}


def test_wrong_input_is_told_and_leaves_nothing(folder, capsys):
    for words, message in WRONG.items():
        assert _validate(*words.split()) == 2
        assert message in capsys.readouterr().err
        assert not (folder / "out" / "session.db").exists()


def test_policies_that_raise_or_hang_or_talk_nonsense_are_errors_and_harm_no_other(folder):
    (folder / "own.py").write_text(
        "import multiprocessing, time\n"
        "first = multiprocessing.parent_process() is None  # asked before the runs begin\n"
        "def stops(seen): return {name: 6 for name in seen}\n"
        "def raises(seen): return stops(seen) if first else 1 / 0\n"
        "def hangs(seen): return stops(seen) if first else time.sleep(3600)\n"
        "def nonsense(seen): return {name: 6 if first else 99 for name in seen}\n"
    )
    names = ["own:stops", "own:raises", "own:hangs", "own:nonsense", "random"]
    words = ["empty.yaml", "--policy", *names, "--trials", "1", "--timeout", "10"]
    assert _validate(*words) == 1
    stops, raises, hangs, nonsense, random = _records(folder / "out")
    assert raises["error"] == "ZeroDivisionError: division by zero"
    assert "own.py" in raises["extra"]["traceback"]
    assert hangs["error"] == "no answer within 10 s"
    assert "99" in nonsense["error"]
    for record in (stops, random):
        assert record["agrees"]
        assert (
            len(record["attempts"]) + record["extra"]["forbidden"] == record["extra"]["ticks"] == 20
        )


def test_worlds_that_each_run_draws_anew_differ_and_are_the_same_at_any_number_of_workers(folder):
    words = ["random", "--cars", "2", "--max-steps", "3", "--trials", "2", "--randomize", "none"]
    assert _validate(*words, out="one") == 0
    assert _validate(*words, "--workers", "2", out="two") == 0
    one, other = _records(folder / "one")
    assert one["attempts"] != other["attempts"]
    assert (one["context"], one["group"]) == ("random", "play")
    assert _records(folder / "two") == [one, other]
    assert _report(folder / "one") == _report(folder / "two")


@pytest.mark.parametrize(("x", "reached"), [(2, True), (3, False)])
def test_the_goal_of_a_file_is_judged_with_a_plan_or_actions_too(folder, x, reached):
    (folder / "start.yaml").write_text(
        "area_length: 4\narea_width: 3\narea_height: 2\nblock_num: 1\nslope_num: 0\nsmartcar_num: 1\n"
        "block:\n  - {id: 0, x: 1, y: 1, z: 1}\nsmartcar:\n  - {id: 0, x: 1, y: 1, z: 1, yaw: 0}\n"
    )
    (folder / "goal.yaml").write_text(f"block:\n  - {{id: 0, x: {x}, y: 1, z: 1}}\n")
    (folder / "carry.plan").write_text("0 0 LIFT\n1 0 MOVE_RIGHT\n2 0 DROP\n")
    (folder / "carry.txt").write_text("0 LIFT\n0 MOVE_RIGHT\n0 DROP\n")
    for option in (("--plan", "carry.plan"), ("--actions", "carry.txt")):
        words = (
            "start.yaml",
            *option,
            "--goal",
            "goal.yaml",
            "--randomize",
            "none",
            "--trials",
            "1",
        )
        assert _validate(*words) == 0
        extra = json.loads((folder / "out" / "trials.jsonl").read_text())["extra"]
        assert (extra["physics_success"], extra["grid_success"]) == (reached, reached)


def test_a_goal_where_it_would_not_be_judged_is_refused(folder, capsys):
    (folder / "goal.yaml").write_text("block:\n  - {id: 0, x: 1, y: 1, z: 1}\n")
    assert _validate("strip", "--backend", "grid", "--policy", "strip", "--goal", "goal.yaml") == 2
    assert "--goal is judged in physics" in capsys.readouterr().err
    assert _validate("strip", "block", "--goal", "goal.yaml") == 2
    assert _validate("strip", "--disturb", "shove") == 2
