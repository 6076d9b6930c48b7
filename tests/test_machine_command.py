"""``craftsim machine``: a file to edit, and what its machine can do; the page on it is followed literally."""

import json
import shlex
from pathlib import Path

import pytest
from pages import steps_of, words_of

from craftsim import cli, load_machines
from craftsim.mjcf.machines import NOMINAL

PAGE = "docs/how-to/machine.md"
WEAK = Path(__file__).parents[1] / "examples" / "weak_car.yaml"


def _check(text, folder):
    """Return the exit status of a check of a file with this text, and the first car of its report."""
    (folder / "own.yaml").write_text(text)
    status = cli.main(["machine", "check", str(folder / "own.yaml"), "--out", str(folder / "out")])
    if status == 2:
        return status, None
    return status, json.loads((folder / "out" / "report.json").read_text())["figures"]


def test_the_commands_of_the_page_run_but_for_tuning(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    commands = [words_of(step)[1:] for step in steps_of(PAGE) if step.kind == "shell"]
    assert [words[0] for words in commands[:4]] == ["machine", "machine", "validate", "tune"]
    for words in commands:
        if words[0] != "tune":
            assert cli.main(words) == 0, shlex.join(words)
    assert load_machines("mycar.yaml").digest == NOMINAL.digest
    text = Path("mycar.yaml").read_text()
    assert "# climb a slope with a slope: 2.5 Nm, where 0.832 is needed" in text
    assert "Tasks get what they need." in capsys.readouterr().out


def test_a_file_that_is_there_is_not_replaced(tmp_path, capsys):
    path = tmp_path / "own.yaml"
    path.write_text("smartcar: {mass_kg: 4}")
    assert cli.main(["machine", "new", str(path)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert path.read_text() == "smartcar: {mass_kg: 4}"


def test_what_fails_is_named_with_what_would_have_to_change(tmp_path, capsys):
    status, figures = _check("smartcar: {wheel_torque_nm: 0.81}", tmp_path)
    assert (status, figures["failing"], figures["tight"]) == (1, 2, 2)
    (car,) = figures["cars"]
    climb = car["requirements"]["climb_with_block"]
    assert (climb["verdict"], climb["parameter"]) == ("fails", "smartcar.wheel_torque_nm")
    assert climb["gives"] < climb["least"] < climb["sure"]
    assert climb["changes"][0] == "smartcar.wheel_torque_nm at least 1.31"
    assert car["motions"]["up a slope, loaded"]["speed_cause"] == "crest_limit"
    output = capsys.readouterr().out
    assert "fails" in output
    assert "Needs of tasks that are not met: 2." in output


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("smartcar: {board_travel_m: 0.02}", "board_travel_m is 0.02; from 0.0309 to 0.0509 lifts"),
        ("smartcar: {mass_kg: 3.7, wheel_armature_kgm2: 0.001}", "has a gain of 4: below"),
    ],
)
def test_machines_that_cannot_be_are_refused(text, message, tmp_path, capsys):
    assert _check(text, tmp_path) == (2, None)
    assert message in capsys.readouterr().err


def test_each_car_has_its_rows_and_gains_of_the_file_count(tmp_path):
    text = (
        "cars: [{}, {mass_kg: 13, wheel_gain_nms_rad: 1.0}]\ngains: {drive: {max_slope_speed: 0.2}}"
    )
    status, figures = _check(text, tmp_path)
    assert status == 0
    first, second = figures["cars"]
    assert (first["mass_kg"], second["mass_kg"]) == pytest.approx((10.3, 13.0))
    assert first["motions"]["up a slope, empty"]["speed"] == 0.2
    assert (first["gains"]["drive.friction_speed"], second["gains"]["drive.friction_speed"]) == (
        0.03,
        0.12,
    )
