"""``craftsim design``: files that the rest of craftsim reads, and what is printed."""

import json

import numpy as np
import pytest

from craftsim.cli import main, progress
from craftsim.discrete.files.blueprint import read_blueprint
from craftsim.discrete.files.design import read_design


@pytest.mark.parametrize(
    ("words", "times"),
    [
        (["house", "--size", "4", "3", "1"], 2),
        # That a seed decides all of a random start is a law of tests/designs/test_starts.py.
        (["random", "--difficulty", "0"], 1),
        (["random", "--size", "6", "5", "2"], 1),
    ],
)
def test_it_writes_a_goal_and_a_start_that_are_read_the_same_each_time(
    words, times, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(progress, "_FIRST_LINE_S", 0.0)
    outs = [tmp_path / name for name in ("one", "two")][:times]
    for out in outs:
        assert main(["design", *words, "--seed", "4", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"design {words[0]}\n"), "it says what it does"
    assert "level 1" in printed
    assert f"goal: {outs[0] / 'start_goal.yaml'}" in printed
    for name in ("start_goal.yaml", "start.yaml", "design.png", "report.json"):
        assert len({(out / name).read_bytes() for out in outs}) == 1
    design, start = read_design(outs[0] / "start_goal.yaml"), read_blueprint(outs[0] / "start.yaml")
    design.check_fits(start.size)
    assert start.is_fixed
    assert not design.satisfied(start.grid(np.random.default_rng(0)))
    report = json.loads((outs[0] / "report.json").read_text())
    assert (report["command"], report["seed"], report["figures"]["size"]) == (
        "design",
        4,
        [*start.size],
    )


def test_a_picture_and_a_number_of_cars_make_a_start(picture, tmp_path):
    path = picture("plan.png", "##", "#.")
    words = [str(path), "--cars", "1", "--area", "8", "8", "2", "--out", str(tmp_path / "out")]
    assert main(["design", *words]) == 0
    start = read_blueprint(tmp_path / "out" / "start.yaml")
    assert (start.size, start.n_cars, start.n_blocks) == ((8, 8, 2), 1, 3)


def test_the_list_names_all_and_writes_nothing(tmp_path, capsys):
    assert main(["design", "--list", "--out", str(tmp_path / "out")]) == 0
    assert "pyramid   base=5" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_is_one_message_and_exit_2(tmp_path, capsys):
    for words, message in (
        (["pyramidd"], "did you mean 'pyramid'?"),
        (
            ["random", "--area", "9", "9", "3"],
            "random takes --size, or --difficulty, --cars, --seed",
        ),
        (
            ["random", "--size", "3"],
            "of 3 cells; allowed: length, width and height, 5 x 5 x 1 to 16 x 16 x 4",
        ),
        (["wall", "--area", "9", "9"], "--area has 2 numbers; allowed: three"),
        (["wall", "--area", "9", "9", "3"], "design of (6, 1, 2); allowed: at least (12, 7, 2)"),
        (["wall", "--size", "129"], "--size is 129; allowed: 1 to 128"),
        (["wall", "--cars", "1000"], "--cars is 1000; allowed"),
        (["none.png"], "none.png: no such file"),
    ):
        assert main(["design", *words, "--out", str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
        assert not (tmp_path / "out").exists()
