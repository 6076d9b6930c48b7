"""Studies: what is read, what is refused, and that an interrupted one goes on."""

import json
import re
import time
from dataclasses import asdict, replace
from pathlib import Path
from threading import Event

import pytest
from owner import owner
from validation.campaign.sessions import cut_off

from craftsim.cli import main
from craftsim.cli.progress import print_regularly
from craftsim.errors import InputError
from craftsim.learning import evaluation
from craftsim.learning.curve import CURVE_FILE, CurvePoint, write_curve
from craftsim.learning.study import (
    RUNS_FOLDER,
    SHIPPED_STUDIES,
    Study,
    read_study,
    train_and_evaluate,
    under_way,
)
from craftsim.learning.study_results import conclusions, learning_table, study_figures
from craftsim.learning.trainer import Trainer
from craftsim.tasks import make_task, register_task

TEXT = """
title: Tiny
tasks: [strip]
algos: [ippo]
seeds: 2
steps: 400
episodes: 20
settings: {worlds: 10, width: 8}
tests: {strip: [strip, random_strip@test]}
reference: {strip: {ippo: 0.92}}
"""


@pytest.fixture
def tiny(tmp_path):
    path = tmp_path / "tiny.yaml"
    path.write_text(TEXT)
    return path


def test_a_study_goes_on_without_doing_anything_twice(tiny, tmp_path, capsys):
    out = tmp_path / "out"
    assert (
        main(["train", "study", str(tiny), "--out", str(out)]) == 1
    )  # so little training reaches nothing
    whole = json.loads((out / "report.json").read_text())
    rows = whole["figures"]["rows"]
    assert [(row["played"], row["seeds"], row["distinct_starts"]) for row in rows] == [
        ("strip", 2, 1),
        ("random_strip@test", 2, 20),
    ]
    assert {run["steps"] for run in whole["figures"]["runs"]} == {400}
    assert "IQM" in capsys.readouterr().out
    _, second = (out / "trials.jsonl").read_text().splitlines(keepends=True)
    cut_off(out, (0,))
    assert main(["train", "study", str(tiny), "--out", str(out), "--resume"]) == 1
    again = json.loads((out / "report.json").read_text())
    assert again["figures"] == whole["figures"]
    last = json.loads((out / "trials.jsonl").read_text().splitlines()[1])["extra"]
    assert last["resumed"]
    # Nothing was left to train: the time is that of the call that did.
    assert last["cpu_s"] == json.loads(second)["extra"]["cpu_s"] > 0
    assert again["wall"]["cpu_s"] == whole["wall"]["cpu_s"]
    tiny.write_text(TEXT.replace("seeds: 2", "seeds: 3"))
    assert main(["train", "study", str(tiny), "--out", str(out), "--resume"]) == 2


def test_a_study_says_how_far_each_run_is_that_is_under_way(tiny, tmp_path, capsys):
    asked = read_study(str(tiny))
    for run, steps, successes in zip(asked.runs, (200, 400), (3, 4), strict=True):
        folder = tmp_path / RUNS_FOLDER / run.key
        folder.mkdir(parents=True)
        point = CurvePoint(10, successes, 0.0, 5.0, 1, 0, 1, steps)
        write_curve(folder / CURVE_FILE, [replace(point, steps=100), point])
    told = ["strip/ippo/0: 200 of at most 400 steps, 3 of 10 episodes succeed"]
    assert under_way(asked, tmp_path, 0.0) == told
    assert under_way(asked, tmp_path, time.time() + 60) == []
    said = Event()
    with print_regularly(lambda: said.set() or [*told, "[red]"], 0.01):
        assert said.wait(60)
    assert f"{told[0]}\n[red]\n" in capsys.readouterr().out


@pytest.mark.parametrize("settings", ["backend: physics", "execution: asynchronous"])
def test_a_study_evaluates_as_it_trains(settings, tmp_path, monkeypatch):
    path = tmp_path / "tiny.yaml"
    path.write_text(TEXT.replace("width: 8", f"width: 8, max_steps: 1, {settings}"))
    run = read_study(str(path)).runs[0]
    net = Trainer(run.config, task=run.task).learner.net
    played = []

    def note(module, name):
        function = getattr(module, name)

        def noted(*arguments):
            played.append((name, arguments))
            return function(*arguments)

        monkeypatch.setattr(module, name, noted)

    note(evaluation, "evaluate")
    note(evaluation, "evaluate_in_physics")
    found = evaluation.evaluate_as_trained(run.config, net, run.task, 2, 1)
    ((name, arguments),) = played
    assert found.episodes == 2
    assert name == ("evaluate_in_physics" if "physics" in settings else "evaluate")
    assert ("asynchronous" in arguments) == ("asynchronous" in settings)


def test_runs_that_have_no_point_yet_or_a_damaged_curve_do_not_end_the_progress_of_a_study(
    tiny, tmp_path
):
    """A run that is cut off before its first evaluation leaves a curve of headings alone."""
    asked = read_study(str(tiny))
    first, second = (tmp_path / RUNS_FOLDER / run.key / CURVE_FILE for run in asked.runs)
    for path in (first, second):
        path.parent.mkdir(parents=True)
        write_curve(path, [])
    assert under_way(asked, tmp_path, 0.0) == []
    write_curve(second, [CurvePoint(10, 3, 0.0, 5.0, 1, 0, 1, 200)])
    (line,) = under_way(asked, tmp_path, 0.0)
    assert line.endswith("200 of at most 400 steps, 3 of 10 episodes succeed")
    whole = second.read_text()
    headings = whole.splitlines()[0]
    for text, message in (
        (whole.replace(",3,", ",three,"), "curve.csv:2: successes is 'three', not a number"),
        (whole.replace(",3,", ",30,"), "curve.csv:2: a point of the curve has 30 of 10 episodes"),
        (headings + "\n1,2\n", "curve.csv:2: no point of a learning curve"),
        ("", None),
        ("steps\n" + "1" * (17 << 20), "curve.csv: 17 MiB; a CSV table is no larger than"),
    ):
        second.write_text(text)
        lines = under_way(asked, tmp_path, 0.0)
        assert len(lines) == (message is not None)
        assert all(message in line for line in lines)
    second.unlink()
    second.symlink_to("/dev/zero")
    (line,) = under_way(asked, tmp_path, 0.0)
    assert "not a regular file" in line


@pytest.mark.parametrize(("reward", "shown"), [("published_code", "0.50"), ("paper", "")])
def test_returns_count_by_a_threshold_where_the_reward_is_that_of_craftenvs_code(
    reward, shown, tmp_path
):
    task = tmp_path / "strip_again.yaml"
    task.write_text(f"start: strip\ngoal: strip_goal\nreward: {reward}\n")
    path = tmp_path / "tiny.yaml"
    path.write_text(
        f"title: Tiny\ntasks: [{task}]\nseeds: 1\nreference: {{{task}: {{ippo: 0.5, vdn: 0.7}}}}\n"
        f"thresholds: {{{task}: {{mean_return: 4, last: 0.5}}}}\n"
    )
    asked = read_study(str(path))
    curve = []
    for steps, mean_return in ((100, 9.0), (900, 3.5), (1000, 4.0)):
        point = CurvePoint(20, 0, mean_return, 20.0, 1, 0, 1, steps)
        curve.append(asdict(point))
    extra = {"steps": 1000, "curve": curve, "evaluations": {}}
    figures = study_figures(asked, [{"error": None, "extra": extra}])
    *_, row = learning_table(asked, figures).as_markdown().splitlines()
    assert [cell.strip() for cell in row.split("|")[-3:-1]] == [shown, "0.50"]


def test_one_seed_has_no_interval():
    stored = Path(__file__).parents[2] / "docs/results/training/designs.json"
    figures = json.loads(stored.read_text(encoding="utf-8"))["figures"]
    figures["runs"] = figures["runs"][:1]
    one = replace(read_study("designs"), seeds=1)
    assert "| one run |" in learning_table(one, figures).as_markdown()
    assert re.match(r"ippo, all tasks: IQM 0\.\d+, optimality gap", conclusions(figures)[0])


WRONG = {
    ("tasks: [strip]", "tasks: [stripe]"): "no task of the study",
    ("tasks: [strip]", "tasks: [strip, strip]"): "key 'tasks': 'strip' is given 2 times",
    ("tasks: [strip]", "tasks: []"): "key 'tasks': has 0 entries, allowed: at least 1",
    ("algos: [ippo]", "algos: [ppo]"): r"key 'algos\[0\]'",
    ("seeds: 2", "seed: 2"): "unknown key 'seed'; did you mean 'seeds'",
    ("seeds: 2", "seeds: 1001"): "key 'seeds': 1001 is out of range, allowed: 1 to 1000",
    ("steps: 400", "steps: inf"): "key 'steps'",
    ("title: Tiny", "title: " + 201 * "x"): "key 'title': has 201 characters, allowed: at most 200",
    ("reference: {strip: {ippo: 0.92}}", "reference: {block: {ippo: 0.9}}"): "no task of the study",
    (
        "reference: {strip: {ippo: 0.92}}",
        "reference: {strip: {ippo: nan}}",
    ): "key 'reference.strip.ippo'",
    (
        "reference: {strip: {ippo: 0.92}}",
        "of_tasks: {strip: {steps: [1]}}",
    ): "'of_tasks.strip.steps': must be an integer",
    (
        "reference: {strip: {ippo: 0.92}}",
        "of_tasks: {strip: {steps: -1}}",
    ): "'of_tasks.strip.steps' is -1",
    ("{worlds: 10, width: 8}", "{world: 10}"): "did you mean 'worlds'",
    (
        "{worlds: 10, width: 8}",
        "{width: [1]}",
    ): "settings of 'strip' by ippo: key 'width'.* not a list",
    ("{worlds: 10, width: 8}", "{hyperparameters: {gamma: nan}}"): "key 'hyperparameters.gamma'",
    ("{worlds: 10, width: 8}", "{stages: [designs], stage_steps: 1}"): "stage 'designs' has",
    ("{worlds: 10, width: 8}", "{pretrained: nothere}"): "no policy 'nothere'",
    ("{worlds: 10, width: 8}", "{shown_share: 0.9, imitate: 3}"): "leave it out",
    (
        "[strip, random_strip@test]",
        "[designs]",
    ): "key 'tests.strip': 'designs' has 2 cars in an area of",
    ("[strip, random_strip@test]", "[http.server:test]"): "module:factory is code",
    (
        "[strip, random_strip@test]",
        f"[{'x' * 1001}]",
    ): "a name of 1001 characters; allowed: at most 1000",
}


def test_what_is_wrong_in_a_file_is_named(tiny):
    for (old, new), said in WRONG.items():
        tiny.write_text(TEXT.replace(old, new))
        with pytest.raises(InputError, match=said) as error:
            read_study(str(tiny))
        assert str(tiny) in str(error.value)


def test_a_product_that_is_too_large_is_refused_by_count_before_anything_is_made_of_it(
    tiny, monkeypatch
):
    def looked_up(*given, **named):
        raise AssertionError("a task was looked up")

    monkeypatch.setattr("craftsim.learning.study.known_task", looked_up)
    names = ", ".join(f"task_{number}" for number in range(2000))
    text = TEXT.replace("tasks: [strip]", f"tasks: [{names}]").replace("seeds: 2", "seeds: 1000")
    tiny.write_text(text.replace("algos: [ippo]", f"algos: [{', '.join(['ippo'] * 70)}]"))
    with pytest.raises(
        InputError, match=r"2000 tasks x 70 algorithms x 1000 seeds, is 140000000; allowed: 1 to"
    ):
        read_study(str(tiny))


START = (
    "area_length: 4\narea_width: 4\narea_height: 2\nblock_num: 2\nslope_num: 0\nsmartcar_num: 1\n"
)


def test_registered_tasks_and_those_from_files_have_folders_in_the_study_and_are_known_to_workers(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr("craftsim.tasks.registry._REGISTERED", {})
    register_task(replace(make_task("strip"), name="mine"))
    for name in ("own$\\frac", "..."):
        (tmp_path / f"{name}.yaml").write_text("start: start.yaml\ngoal: platform\n")
    (tmp_path / "start.yaml").write_text(START)
    work = tmp_path / "a" / "b"
    work.mkdir(parents=True)
    monkeypatch.chdir(work)
    settings = "seeds: 1\nsteps: 1\nepisodes: 2\nsettings: {worlds: 2, width: 4}\n"
    tasks = ["../../own$\\frac.yaml", str(tmp_path / "....yaml"), "mine"]
    Path("own.yaml").write_text(f"title: $\\frac\ntasks: {json.dumps(tasks)}\n{settings}")
    before = {path for path in tmp_path.rglob("*") if "out" not in path.parts}
    assert main(["train", "study", "own.yaml", "--out", "out"]) == 1
    assert {path for path in tmp_path.rglob("*") if "out" not in path.parts} == before
    runs = sorted(
        str(path.parent.relative_to("out")) for path in Path("out").rglob("run.safetensors")
    )
    assert runs == ["runs/mine/ippo/0", "runs/own-frac/ippo/0", "runs/task/ippo/0"]
    report = json.loads(Path("out/report.json").read_text())
    assert [run["error"] for run in report["figures"]["runs"]] == [None] * 3
    (tmp_path / "start.yaml").write_text(START.replace("block_num: 2", "block_num: 3"))
    assert main(["train", "study", "own.yaml", "--out", "out", "--resume"]) == 2
    assert "digests" in capsys.readouterr().err


def test_two_tasks_of_one_name_are_not_mixed(tmp_path):
    (tmp_path / "start.yaml").write_text(START)
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "own.yaml").write_text("start: ../start.yaml\ngoal: platform\n")
    names = [str(tmp_path / folder / "own.yaml") for folder in "ab"]
    with pytest.raises(InputError, match="are both called 'own'"):
        Study(title="T", tasks=tuple(names), settings={"worlds": 2, "width": 4})


def test_a_shipped_study_is_found_by_name_and_not_hidden_by_a_folder_for_its_results(
    tmp_path, monkeypatch
):
    for path in SHIPPED_STUDIES.glob("*.yaml"):
        assert read_study(path.stem).runs
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick").mkdir()
    assert read_study("quick").runs
    with pytest.raises(InputError, match="not a regular file"):
        read_study(str(tmp_path))
    with pytest.raises(InputError, match="there are designs, paper, paper_ippo, quick, random"):
        read_study("papers")


def test_a_run_that_somebody_goes_on_with_alone_is_left_to_them(tiny, tmp_path):
    run, out = read_study(str(tiny)).runs[0], tmp_path / "out"
    with owner(out / RUNS_FOLDER / run.key), pytest.raises(InputError, match="is in use"):
        train_and_evaluate((run, out))
    (tmp_path / "elsewhere").mkdir()
    (out / RUNS_FOLDER / run.key).parent.mkdir(parents=True)
    (out / RUNS_FOLDER / run.key).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="is a link, and none is followed"):
        train_and_evaluate((run, out))
    assert not [*(tmp_path / "elsewhere").iterdir()]
