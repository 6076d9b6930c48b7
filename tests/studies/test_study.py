"""Studies: what is read, what is refused, and that an interrupted one goes on."""

import io
import json
import re
import time
from dataclasses import replace
from pathlib import Path

import pytest

from craftsim.cli import main
from craftsim.commands import study_progress
from craftsim.commands.study_text import conclusions, runs_table
from craftsim.commands.terminal import Terminal
from craftsim.errors import InputError
from craftsim.studies.study import SHIPPED, read_study
from craftsim.training.curve import CURVE_FILE, Point, write_curve

TEXT = """
title: Tiny
tasks: [strip]
algos: [ippo]
seeds: 2
steps: 400
episodes: 20
settings: {worlds: 10, width: 8}
tests: {strip: [strip, random_strip@test]}
reference: {strip: 0.92}
"""


@pytest.fixture
def tiny(tmp_path):
    path = tmp_path / "tiny.yaml"
    path.write_text(TEXT)
    return path


def test_a_study_goes_on_without_doing_anything_twice(tiny, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["study", str(tiny), "--out", str(out)]) == 1  # so little training reaches nothing
    whole = json.loads((out / "report.json").read_text())
    rows = whole["figures"]["rows"]
    assert [(row["played"], row["seeds"], row["distinct_starts"]) for row in rows] == [
        ("strip", 2, 1),
        ("random_strip@test", 2, 20),
    ]
    assert {run["steps"] for run in whole["figures"]["runs"]} == {400}
    assert "IQM" in capsys.readouterr().out
    first, second = (out / "trials.jsonl").read_text().splitlines(keepends=True)
    (out / "trials.jsonl").write_text(first)
    assert main(["study", str(tiny), "--out", str(out), "--resume"]) == 1
    again = json.loads((out / "report.json").read_text())
    assert again["figures"] == whole["figures"]
    last = json.loads((out / "trials.jsonl").read_text().splitlines()[1])["extra"]
    assert last["resumed"]
    # Nothing was left to train: the time is that of the call that did.
    assert last["cpu_s"] == json.loads(second)["extra"]["cpu_s"] > 0
    assert again["wall"]["cpu_s"] == whole["wall"]["cpu_s"]
    tiny.write_text(TEXT.replace("seeds: 2", "seeds: 3"))
    assert main(["study", str(tiny), "--out", str(out), "--resume"]) == 2


def test_progress_says_how_far_each_run_is(tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(study_progress, "EVERY_S", 0.01)
    said = io.StringIO()
    console, study = Terminal(file=said, width=200), read_study(str(tiny))
    first, second = study.runs
    with study_progress.watching(console, study, tmp_path) as on_record:
        (tmp_path / "runs" / first.key).mkdir(parents=True)
        _wait_for("0 of 2 runs done, 0 reached 0.99; strip/ippo/0: no evaluation yet", said)
        write_curve(tmp_path / "runs" / first.key / CURVE_FILE, [Point(20, 5, 0.0, 1.0, 1, 0, 1, steps=1200)])
        _wait_for("strip/ippo/0: 1,200 of at most 400 steps, success 0.25", said)
        on_record({"key": first.key, "agrees": True})
        (tmp_path / "runs" / second.key).mkdir(parents=True)
        _wait_for("1 of 2 runs done, 1 reached 0.99; strip/ippo/1: no evaluation yet", said)
    lines = said.getvalue().splitlines()
    assert len(lines) == len(set(lines))


def _wait_for(text, said):
    end = time.monotonic() + 60
    while text not in said.getvalue():
        assert time.monotonic() < end, said.getvalue()
        time.sleep(0.01)


def test_one_seed_has_no_interval():
    stored = Path(__file__).parents[2] / "docs/training/designs.json"
    figures = json.loads(stored.read_text(encoding="utf-8"))["figures"]
    figures["runs"] = figures["runs"][:1]
    one = replace(read_study("designs"), seeds=1)
    assert "| one run |" in runs_table(one, figures).as_markdown()
    assert re.match(r"ippo, all tasks: IQM 0\.\d+, optimality gap", conclusions(figures)[0])


@pytest.mark.parametrize("name", sorted(path.stem for path in SHIPPED.glob("*.yaml")))
def test_shipped_studies_are_sound(name):
    assert read_study(name).runs


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("tasks: [strip]", "tasks: [stripe]", "no task of the study"),
        ("algos: [ippo]", "algos: [ppo]", "key 'algos.0'"),
        ("seeds: 2", "seeds: many", "key 'seeds'"),
        ("seeds: 2", "seed: 2", "seed"),
        ("{worlds: 10, width: 8}", "{world: 10}", "did you mean 'worlds'"),
        ("{worlds: 10, width: 8}", "{width: 100000}", "width is 100000"),
        ("reference: {strip: 0.92}", "reference: {block: 0.9}", "no task of the study"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(old, new, said, tiny):
    tiny.write_text(TEXT.replace(old, new))
    with pytest.raises(InputError, match=said) as error:
        read_study(str(tiny))
    assert str(tiny) in str(error.value)


def test_a_folder_for_its_results_does_not_hide_a_shipped_study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick").mkdir()
    assert read_study("quick").runs
    with pytest.raises(InputError, match="not a regular file"):
        read_study(str(tmp_path))


def test_a_study_that_is_not_there_is_named_with_those_that_are():
    with pytest.raises(InputError, match="there are designs, paper, paper_ippo, quick, random"):
        read_study("papers")
