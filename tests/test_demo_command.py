"""``craftsim demo``: builds and reports, twice the same; status 1 for a missed goal, 2 for wrong input."""

import json
import subprocess
import sys
from importlib.resources import as_file, files
from pathlib import Path

import pytest

from craftsim.discrete.tasks import TASK_NAMES
from craftsim.rendering.film import Frames, Look
from craftsim.rendering.trajectory import Trajectory
from craftsim.reports.json_file import SCHEMA_VERSION

NAME = "simple_two_story"
"""What names each file on the command line."""

FLAT = """\
area_length: 3
area_width: 1
area_height: 2
block_num: 1
slope_num: 0
smartcar_num: 1
block:
  - {id: 0, x: 1, y: 0, z: 1}
smartcar:
  - {id: 0, x: 0, y: 0, z: 1, yaw: 0}
"""
GOAL = """\
block:
  - {id: 0, x: 2, y: 0, z: 1}
"""
CARRY = """\
0 0 MOVE_RIGHT
1 0 LIFT
2 0 MOVE_RIGHT
3 0 DROP
"""


def _demo(*words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "craftsim", "demo", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def _write(folder: Path, **texts: str) -> list[str]:
    """Write files and return the options that name them."""
    words = []
    for option, text in texts.items():
        path = folder / {"start": "own.yaml", "goal": "own_goal.yaml", "plan": "own.plan"}[option]
        path.write_text(text, encoding="utf-8")
        words += [f"--{option}", str(path)]
    return words


def _report(out: Path) -> dict:
    return json.loads((out / "report.json").read_text(encoding="utf-8"))


def _last_line(result: subprocess.CompletedProcess[str]) -> str:
    return result.stdout.strip().splitlines()[-1]


@pytest.fixture(scope="module")
def shipped(tmp_path_factory) -> tuple[subprocess.CompletedProcess[str], Path]:
    out = tmp_path_factory.mktemp("shipped") / "new" / "folder"
    return _demo("--no-video", "--out", out, "--seed", 7, "--randomize", "none"), out


def test_the_shipped_demo_succeeds_and_says_so_last(shipped):
    result, _ = shipped
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    assert _last_line(result) == "24 of 24 actions agree with the rules; the building matches its goal."


def test_the_table_has_a_row_for_each_action(shipped):
    result, _ = shipped
    rows = [line.split() for line in result.stdout.splitlines() if "agrees" in line]
    assert len(rows) == 24
    assert {row[1] for row in rows} == {"0", "1"}


def test_without_a_film_the_report_its_page_and_the_trajectory_are_written(shipped):
    _, out = shipped
    written = [
        "config.yaml",
        "report.html",
        "report.json",
        "simple_two_story.log.csv",
        "simple_two_story.npz",
    ]
    assert sorted(path.name for path in out.iterdir()) == written


def test_the_report_says_what_ran_and_what_came_out(shipped):
    report = _report(shipped[1])
    assert sorted(report) == ["command", "config", "figures", "schema_version", "seed", "versions", "wall"]
    assert (report["schema_version"], report["command"], report["seed"]) == (SCHEMA_VERSION, "demo", 7)
    assert {"craftsim", "mujoco", "numpy", "python", "platform"} <= report["versions"].keys()
    setup = report["config"]["setup"]
    assert setup["simulation"]["timestep_s"] > 0
    assert setup["gains"]["drive"]["position_gain"] > 0
    assert setup["thresholds"]["car_m"] == 0.001
    assert set(report["config"]["digests"]) == {"gains", "machines"}
    assert (report["config"]["rules"], report["config"]["randomize"]) == ("physical", "none")
    figures = report["figures"]
    assert (figures["agree"], figures["total"], figures["matches_goal"]) == (24, 24, True)
    assert figures["max_car_error_mm"] <= 1.0
    assert figures["max_car_heading_error_mrad"] <= 3.0
    assert figures["max_placed_error_mm"] <= 2.0
    assert figures["max_bystander_displacement_mm"] <= 1.0
    assert len(figures["actions"]) == 24
    assert {action["skill"] for action in figures["actions"]} == {"succeeded"}


def test_the_same_seed_gives_the_same_report(shipped, tmp_path):
    assert _demo("--no-video", "--out", tmp_path, "--seed", 7, "--randomize", "none").returncode == 0
    first, second = _report(shipped[1]), _report(tmp_path)
    assert first.pop("wall")["total_s"] > 0
    assert second.pop("wall")["total_s"] > 0
    assert first == second


@pytest.mark.usefixtures("rendering")
def test_the_film_plays_in_a_browser(tmp_path):
    import av

    result = _demo("--out", tmp_path, *_write(tmp_path, start=FLAT, goal=GOAL, plan=CARRY))
    assert result.returncode == 0, result.stderr
    with av.open(str(tmp_path / "own.mp4")) as film:
        stream = film.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        frames = sum(1 for _ in film.decode(stream))
    trajectory = Trajectory.read(tmp_path / "own.npz")
    assert frames == Frames.count(trajectory, Look())
    assert trajectory.time[-1] == pytest.approx(_report(tmp_path)["figures"]["simulated_s"])
    assert not list(tmp_path.glob(".*"))


def test_a_drawing_of_ones_own_is_built(tmp_path):
    result = _demo("--no-video", "--out", tmp_path, *_write(tmp_path, start=FLAT, goal=GOAL, plan=CARRY))
    assert result.returncode == 0, result.stderr
    assert _last_line(result) == "4 of 4 actions agree with the rules; the building matches its goal."
    assert _report(tmp_path)["config"]["blueprint"] == "own.yaml"


def test_without_a_goal_the_last_line_says_that_there_is_none(tmp_path):
    result = _demo("--no-video", "--out", tmp_path, *_write(tmp_path, start=FLAT, plan=CARRY))
    assert result.returncode == 0, result.stderr
    assert _last_line(result) == "4 of 4 actions agree with the rules; no goal was given."
    assert _report(tmp_path)["figures"]["matches_goal"] is None


def test_a_missed_goal_ends_with_status_1(tmp_path):
    half = CARRY.replace("3 0 DROP\n", "")
    result = _demo("--no-video", "--out", tmp_path, *_write(tmp_path, start=FLAT, goal=GOAL, plan=half))
    assert result.returncode == 1
    assert _last_line(result) == "3 of 3 actions agree with the rules; the building does NOT match its goal."
    assert _report(tmp_path)["figures"]["matches_goal"] is False


def test_an_action_that_the_rules_forbid_is_named_and_ends_with_status_1(tmp_path):
    plan = CARRY.replace("1 0 LIFT", "1 0 DROP")
    result = _demo("--no-video", "--out", tmp_path, *_write(tmp_path, start=FLAT, plan=plan))
    assert result.returncode == 1
    assert "own: tick 1, car 0 DROP: not tried: the rules forbid it: " in result.stdout
    figures = _report(tmp_path)["figures"]
    assert [action["legal"] for action in figures["actions"]] == [True, False, True, False]
    assert _last_line(result).startswith("2 of 4 actions agree")


def _line(text: str, part: str) -> int:
    return 1 + next(i for i, line in enumerate(text.splitlines()) if part in line)


WRONG = [
    (
        "unknown key",
        "start",
        FLAT.replace("area_width", "area_widht"),
        "area_widht",
        "did you mean 'area_width'?",
    ),
    ("outside", "start", FLAT.replace("x: 1,", "x: 3,"), "x: 3,", "3 is out of range, allowed: 0 to 2"),
    (
        "two things in a cell",
        "start",
        FLAT.replace("block_num: 1", "block_num: 2").replace(
            "smartcar:\n", "  - {id: 1, x: 1, y: 0, z: 1}\nsmartcar:\n"
        ),
        "{id: 1,",
        "where a block is already (line 8)",
    ),
    (
        "wrong type",
        "start",
        FLAT.replace("area_height: 2", "area_height: two"),
        "two",
        "an integer from 1",
    ),
    ("wrong type of list", "start", FLAT.replace("block_num: 1", "block_num: [1]"), "[1]", "a list"),
    ("no YAML", "start", FLAT + "goal: ]", "goal: ]", "not valid YAML"),
    ("goal outside", "goal", GOAL.replace("x: 2", "x: 9"), "x: 9", "is outside the area"),
    ("goal with an unknown key", "goal", GOAL.replace("block", "blok"), "blok", "did you mean 'block'?"),
    ("unknown car", "plan", CARRY.replace("1 0 LIFT", "1 1 LIFT"), "1 1 LIFT", "no car '1'"),
    ("unknown action", "plan", CARRY.replace("LIFT", "LFIT"), "LFIT", "did you mean 'LIFT'?"),
    ("too few words", "plan", CARRY.replace("1 0 LIFT", "1 LIFT"), "1 LIFT", "a line is: tick car ACTION"),
]


@pytest.mark.parametrize(
    ("which", "text", "at", "message"), [case[1:] for case in WRONG], ids=[case[0] for case in WRONG]
)
def test_a_wrong_file_gives_one_message_with_file_and_line(tmp_path, which, text, at, message):
    good = {"start": FLAT, "goal": GOAL, "plan": CARRY}
    words = _write(tmp_path, **(good | {which: text}))
    wrong = words[words.index(f"--{which}") + 1]
    out = tmp_path / "out"
    result = _demo("--no-video", "--out", out, *words)
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.startswith(f"craftsim: {wrong}:{_line(text, at)}: ")
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert not out.exists() or not list(out.iterdir())


@pytest.mark.parametrize("which", ["start", "goal", "plan"])
def test_a_missing_file_gives_one_message_with_its_name(tmp_path, which):
    words = _write(tmp_path, start=FLAT, goal=GOAL, plan=CARRY)
    missing = Path(words[words.index(f"--{which}") + 1])
    missing.unlink()
    out = tmp_path / "out"
    result = _demo("--no-video", "--out", out, *words)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == f"craftsim: {missing}: no such file\n"
    assert not out.exists() or not list(out.iterdir())


def test_a_blueprint_of_ones_own_without_a_plan_is_refused_and_the_shipped_plans_are_named(tmp_path):
    words = _write(tmp_path, start=FLAT)
    result = _demo("--no-video", "--out", tmp_path / "out", *words)
    assert (result.returncode, result.stdout) == (2, "")
    assert f"there is no shipped plan for {words[1]}; give one with --plan" in result.stderr
    assert ", ".join(TASK_NAMES) in result.stderr
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_shipped_plan_does_not_fit_a_drawing_with_one_car(tmp_path):
    with as_file(files("craftsim.data")) as data:
        plan = data / "plans" / f"{NAME}.plan"
        words = [*_write(tmp_path, start=FLAT), "--plan", plan]
        result = _demo("--no-video", "--out", tmp_path / "out", *words)
        assert result.returncode == 2
        line = _line(plan.read_text(encoding="utf-8"), "0  1 ")
        assert result.stderr == f"craftsim: {plan}:{line}: no car '1'; there are cars 0 to 0\n"


def test_an_output_folder_that_cannot_be_made_gives_one_message(tmp_path):
    file = tmp_path / "file"
    file.write_text("", encoding="utf-8")
    result = _demo("--no-video", "--out", file / "out")
    assert result.returncode == 2
    assert "cannot make the output directory" in result.stderr
    assert result.stderr.count("\n") == 1
