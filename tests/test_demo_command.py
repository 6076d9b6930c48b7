"""``craftsim demo``: builds and reports, twice the same; status 1 for a missed goal, 2 for wrong input."""

import json
from dataclasses import replace
from importlib.resources import as_file, files

import pytest
from skills.disturbances import pushed

from craftsim import cli, tasks
from craftsim.checking import judge as judging
from craftsim.checking import setup
from craftsim.checking.thresholds import thresholds_of
from craftsim.rendering import render
from craftsim.rendering.film import FilmOptions, Frames
from craftsim.rendering.trajectory import Trajectory
from craftsim.reports.json_file import SCHEMA_VERSION
from craftsim.tasks import TASK_NAMES
from craftsim.validation import rollout

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
GOAL = "block:\n  - {id: 0, x: 2, y: 0, z: 1}\n"
CARRY = "0 0 MOVE_RIGHT\n1 0 LIFT\n2 0 MOVE_RIGHT\n3 0 DROP\n"
OWN = {"task": FLAT, "goal": GOAL, "plan": CARRY}
FAST = ("--randomize", "none", "--drive", "wheels")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Work in a folder, on a screen of 80 columns."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    return tmp_path


@pytest.fixture
def demo(folder, capsys):
    """Run a demo with files of one's own, and return its status and what it says."""

    def run(*words, own=None, out="out", video=False):
        for option, text in (own or {}).items():
            path = (
                folder / {"task": "own.yaml", "goal": "own.goal.yaml", "plan": "own.plan"}[option]
            )
            path.write_text(text, encoding="utf-8")
            words = (*words, f"--{option}", path.name)
        status = cli.main(["demo", *words, *([] if video else ["--no-video"]), "--out", out])
        return status, capsys.readouterr()

    return run


def _report(out="out"):
    with open(f"{out}/report.json", encoding="utf-8") as file:
        return json.load(file)


def test_the_shipped_demo_succeeds_and_reports_it(demo, folder):
    status, said = demo("--seed", "7", *FAST, out="new/folder")
    lines = said.out.splitlines()
    assert (status, said.err) == (0, "")
    assert lines[-1] == "24 of 24 actions agree with the rules; the goal is reached."
    rows = [line.split() for line in lines if "agrees" in line]
    assert (len(rows), {row[1] for row in rows}) == (24, {"0", "1"})
    assert sorted(path.name for path in (folder / "new/folder").iterdir()) == [
        *("config.yaml", "report.html", "report.json"),
        *("simple_two_story.log.csv", "simple_two_story.npz"),
    ]
    report = _report("new/folder")
    assert (report["schema_version"], report["command"], report["seed"]) == (
        SCHEMA_VERSION,
        "demo",
        7,
    )
    config, figures = report["config"], report["figures"]
    assert config["thresholds"]["place_m"] == pytest.approx(0.00125)
    assert (figures["agree"], figures["total"], figures["matches_goal"]) == (24, 24, True)
    assert figures["max_car_error_mm"] <= 1.0
    assert figures["max_car_heading_error_mrad"] <= 3.0
    assert figures["max_placed_error_mm"] <= 2.0
    assert figures["max_bystander_displacement_mm"] <= 1.0
    assert {action["skill"] for action in figures["actions"]} == {"succeeded"}


def test_the_same_seed_gives_the_same_report(demo):
    assert [demo("--drive", "wheels", own=OWN, out=out)[0] for out in ("one", "two")] == [0, 0]
    one, two = _report("one"), _report("two")
    assert one.pop("wall")["total_s"] > 0 < two.pop("wall")["total_s"]
    assert one == two


@pytest.mark.parametrize(
    ("own", "status", "matches", "last"),
    [
        (OWN, 0, True, "4 of 4 actions agree with the rules; the goal is reached."),
        (
            {"task": FLAT, "plan": CARRY},
            0,
            None,
            "4 of 4 actions agree with the rules; no goal was given.",
        ),
        (
            OWN | {"plan": CARRY.replace("3 0 DROP\n", "")},
            *(1, False, "3 of 3 actions agree with the rules; the goal is NOT reached."),
        ),
    ],
)
def test_a_drawing_of_ones_own_is_built(demo, own, status, matches, last):
    ended, said = demo(*FAST, own=own)
    assert (ended, said.err, said.out.splitlines()[-1]) == (status, "", last)
    assert _report()["figures"]["matches_goal"] is matches


def test_an_action_that_the_rules_forbid_is_named_and_ends_with_status_1(demo):
    status, said = demo(*FAST, own={"task": FLAT, "plan": CARRY.replace("1 0 LIFT", "1 0 DROP")})
    assert status == 1
    assert "own: tick 1, car 0 DROP: not tried: the rules forbid it: " in said.out
    legal = [action["legal"] for action in _report()["figures"]["actions"]]
    assert legal == [True, False, True, False]
    assert said.out.splitlines()[-1].startswith("2 of 4 actions agree")


WRONG = [
    ("task", FLAT.replace("area_width", "area_widht"), "area_widht", "did you mean 'area_width'?"),
    ("task", FLAT.replace("x: 1,", "x: 3,"), "x: 3,", "3 is out of range, allowed: 0 to 2"),
    ("task", FLAT + "goal: ]", "goal: ]", "not valid YAML"),
    ("goal", GOAL.replace("x: 2", "x: 9"), "x: 9", "is outside the area"),
    ("plan", CARRY.replace("1 0 LIFT", "1 1 LIFT"), "1 1 LIFT", "no car '1'"),
    ("plan", CARRY.replace("LIFT", "LFIT"), "LFIT", "did you mean 'LIFT'?"),
]


@pytest.mark.parametrize(("which", "text", "at", "message"), WRONG)
def test_a_wrong_file_gives_one_message_with_file_and_line(demo, folder, which, text, at, message):
    status, said = demo(own=OWN | {which: text})
    line = 1 + next(i for i, line in enumerate(text.splitlines()) if at in line)
    name = {"task": "own.yaml", "goal": "own.goal.yaml", "plan": "own.plan"}[which]
    assert (status, said.out, said.err.count("\n")) == (2, "", 1)
    assert said.err.startswith(f"craftsim: {name}:{line}: ")
    assert message in said.err
    assert not list(folder.glob("out/*"))


def test_files_that_are_missing_or_do_not_fit_are_named(demo, folder):
    no_plan = (
        f"no shipped plan for own.yaml; give one with --plan (shipped ones: {', '.join(TASK_NAMES)}"
    )
    with as_file(files("craftsim.data")) as data:
        plan = str(data / "plans/simple_two_story.plan")
        for words, own, message in (
            ([], {"task": FLAT}, no_plan),
            (["--task", "gone.yaml", "--plan", plan], {}, "gone.yaml"),
            (["--goal", "gone.yaml"], {}, "craftsim: gone.yaml: no such file"),
            (["--plan", "gone.plan"], {}, "craftsim: gone.plan: no such file"),
            (["--plan", plan], {"task": FLAT}, "no car '1'; there are cars 0 to 0"),
            (["--task", "all", "--plan", "my.plan"], {}, "files of your own go with a single task"),
        ):  # fmt: skip
            status, said = demo(*words, own=own)
            assert (status, said.out, said.err.count("\n")) == (2, "", 1)
            assert message in said.err
            assert not list(folder.glob("out/*"))


def test_all_tasks_give_one_summary_and_one_report(demo, monkeypatch):
    names = ("block", "breaking_barrier")
    monkeypatch.setattr(tasks, "TASK_NAMES", names)
    status, said = demo("--task", "all", *FAST)
    lines = said.out.splitlines()
    assert (status, lines[-1]) == (
        0,
        "40 of 40 actions agree with the rules; 2 of 2 goals are reached.",
    )
    assert [
        line.split()[0] for line in lines if "as predicted" in line and line.startswith(names)
    ] == list(names)
    assert (
        max(map(len, (line for line in lines if not line.startswith(("Report:", "Page:"))))) <= 80
    )
    figures = _report()["figures"]
    assert (figures["agree"], figures["total"], figures["good"]) == (40, 40, 2)
    assert all(figures["tasks"][name]["matches_goal"] for name in names)


@pytest.mark.usefixtures("rendering")
def test_one_failure_among_all_tasks_is_named_and_each_task_has_its_film(demo, folder, monkeypatch):
    import av

    (folder / "wrong.plan").write_text("0 0 DROP\n", encoding="utf-8")
    monkeypatch.setattr(tasks, "TASK_NAMES", ("strip", "block"))
    monkeypatch.setattr(rollout, "shipped_plan", lambda name: folder / "wrong.plan")
    monkeypatch.setattr(render, "FilmOptions", lambda: FilmOptions((96, 64)))
    status, said = demo("--task", "all", *FAST, video=True)
    assert status == 1
    assert "strip: tick 0, car 0 DROP: not tried: the rules forbid it: " in said.out
    assert said.out.endswith("0 of 2 actions agree with the rules; 0 of 2 goals are reached.\n")
    assert said.out.count("Film of ") == 2
    kinds = {
        f"{name}.{ending}" for name in ("strip", "block") for ending in ("mp4", "npz", "log.csv")
    }
    assert kinds <= {path.name for path in (folder / "out").iterdir()}
    with av.open("out/block.mp4") as film:
        frames = sum(1 for _ in film.decode(video=0))
    assert frames == len(Frames(Trajectory.read(folder / "out/block.npz"), FilmOptions()))


@pytest.mark.parametrize("disturbance", ["bystander", "limit"])
def test_what_the_reading_does_not_show_disagrees_nevertheless(demo, monkeypatch, disturbance):
    if disturbance == "bystander":
        monkeypatch.setattr(setup, "Executor", pushed(0, 0.004))
        result, message = "side effect", "side effect: block 0 was moved by"
    else:
        strict = replace(thresholds_of(), place_m=1e-9)
        monkeypatch.setattr(judging, "thresholds_of", lambda _: strict)
        result, message = "failed", "failed: the car is "
    status, said = demo("--task", "strip", "--randomize", "none", own={"plan": "0 0 MOVE_LEFT\n"})
    assert status == 1
    assert f"tick 0, car 0 MOVE_LEFT: {message}" in said.out
    assert "0 of 1 actions agree" in said.out
    figures = _report()["figures"]
    (action,) = figures["actions"]
    assert (action["finding"], action["result"]) == ("agrees", result)
    assert figures["max_placed_error_mm"] is None
