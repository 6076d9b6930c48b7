"""``craftsim demo --task``: any of the six tasks, or all with one summary and one report."""

import json

import pytest
from disturbances import pushed

from craftsim import cli
from craftsim.checking import setup
from craftsim.checking.attempt import Thresholds
from craftsim.discrete import tasks
from craftsim.validation import building


def _figures(out):
    return json.loads((out / "report.json").read_text(encoding="utf-8"))["figures"]


@pytest.fixture(autouse=True)
def _a_screen_of_80_columns(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")


def test_a_task_is_built_by_its_name(tmp_path, capsys):
    assert cli.main(["demo", "--task", "breaking_barrier", "--no-video", "--out", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "20 of 20 actions agree with the rules; the flag is at the goal."
    assert _figures(tmp_path)["matches_goal"] is True


def test_a_plan_that_leaves_blocks_apart_misses_the_goal(tmp_path, capsys):
    plan = tmp_path / "short.plan"
    plan.write_text("0 0 MOVE_RIGHT\n", encoding="utf-8")
    words = ["--task", "free_building", "--plan", str(plan), "--no-video", "--out", str(tmp_path)]
    assert cli.main(["demo", *words]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "1 of 1 actions agree with the rules; the blocks do NOT form one platform."


def test_all_tasks_give_one_summary_and_one_report(tmp_path, capsys, monkeypatch):
    names = ("block", "breaking_barrier")
    monkeypatch.setattr(tasks, "TASK_NAMES", names)
    assert cli.main(["demo", "--task", "all", "--no-video", "--out", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == "40 of 40 actions agree with the rules; 2 of 2 goals are reached."
    rows = [line.split() for line in lines if "reached" in line and line.startswith(names)]
    assert [row[0] for row in rows] == list(names)
    assert max(map(len, (line for line in lines if not line.startswith(("Report:", "Page:"))))) <= 80
    figures = _figures(tmp_path)
    assert list(figures["tasks"]) == sorted(names)
    assert (figures["agree"], figures["total"], figures["good"]) == (40, 40, 2)
    assert all(task["matches_goal"] for task in figures["tasks"].values())
    trajectories = [f"{name}.{ending}" for name in names for ending in ("npz", "log.csv")]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        [*trajectories, "config.yaml", "report.html", "report.json"]
    )


def test_one_failure_among_all_tasks_is_named_and_ends_with_status_1(tmp_path, capsys, monkeypatch):
    plan = tmp_path / "wrong.plan"
    plan.write_text("0 0 DROP\n", encoding="utf-8")
    monkeypatch.setattr(tasks, "TASK_NAMES", ("strip", "block"))
    monkeypatch.setattr(building, "shipped_plan", lambda name: plan)
    assert cli.main(["demo", "--task", "all", "--no-video", "--out", str(tmp_path / "out")]) == 1
    output = capsys.readouterr().out
    assert "strip: tick 0, car 0 DROP: not tried: the rules forbid it: " in output
    assert output.splitlines()[-1] == "0 of 2 actions agree with the rules; 0 of 2 goals are reached."
    assert _figures(tmp_path / "out")["good"] == 0


@pytest.fixture
def one_stop(tmp_path):
    """Return the words of a demo in which one car stops once."""
    (tmp_path / "stop.plan").write_text("0 0 MOVE_LEFT\n", encoding="utf-8")
    words = ["--plan", str(tmp_path / "stop.plan"), "--no-video", "--out", str(tmp_path / "out")]
    return ["demo", "--task", "strip", "--randomize", "none", *words]


def test_a_bystander_that_moves_too_far_disagrees_though_the_reading_is_as_predicted(
    one_stop, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(setup, "Executor", pushed(0, 0.004))
    assert cli.main(one_stop) == 1
    output = capsys.readouterr().out
    assert "tick 0, car 0 MOVE_LEFT: side effect: block 0 was moved by" in output
    assert "0 of 1 actions agree" in output
    (action,) = _figures(tmp_path / "out")["actions"]
    assert (action["finding"], action["result"]) == ("agrees", "side effect")


def test_a_car_beyond_its_limit_disagrees_though_the_reading_is_as_predicted(
    one_stop, tmp_path, capsys, monkeypatch
):
    strict = (Thresholds(car_m=1e-9), *setup.RANDOMIZE["none"][1:])
    monkeypatch.setitem(setup.RANDOMIZE, "none", strict)
    assert cli.main(one_stop) == 1
    assert "tick 0, car 0 MOVE_LEFT: failed: the car is " in capsys.readouterr().out
    (action,) = _figures(tmp_path / "out")["actions"]
    assert (action["finding"], action["result"]) == ("agrees", "failed")


@pytest.mark.parametrize("order", ["sequential", "ticks", "concurrent"])
def test_many_cars_at_once_build_the_same_in_less_time(order, tmp_path, capsys):
    words = ["--task", "strip", "--order", order, "--no-video", "--out", str(tmp_path)]
    assert cli.main(["demo", *words]) == 0
    figures = _figures(tmp_path)
    assert figures["matches_goal"] is True
    busy_s = sum(action["duration_s"] for action in figures["actions"])
    assert (figures["makespan_s"] < 0.9 * busy_s) is (order != "sequential")
    assert "-0.00" not in capsys.readouterr().out


def test_nothing_is_said_of_the_errors_of_what_was_not_done(one_stop, tmp_path, capsys):
    cli.main(one_stop)
    output = capsys.readouterr().out
    assert "At worst: cars " in output
    assert "set down" not in output
    assert _figures(tmp_path / "out")["max_placed_error_mm"] is None


@pytest.mark.usefixtures("rendering")
def test_each_task_has_its_own_film(tmp_path, capsys, monkeypatch):
    plan = tmp_path / "short.plan"
    plan.write_text("0 0 STOP\n", encoding="utf-8")
    monkeypatch.setattr(tasks, "TASK_NAMES", ("strip", "block"))
    monkeypatch.setattr(building, "shipped_plan", lambda name: plan)
    cli.main(["demo", "--task", "all", "--out", str(tmp_path / "out")])
    films = {f"{name}.{ending}" for name in ("strip", "block") for ending in ("mp4", "npz", "log.csv")}
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "config.yaml",
        "report.html",
        "report.json",
        *films,
    }
    assert capsys.readouterr().out.count("Film of ") == 2


def test_files_of_ones_own_do_not_go_with_all_tasks(tmp_path, capsys):
    assert cli.main(["demo", "--task", "all", "--plan", "my.plan", "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "files of your own go with a single task" in error
    assert not (tmp_path / "out").exists()
