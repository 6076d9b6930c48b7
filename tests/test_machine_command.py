"""``craftsim machine``: a file to edit, and what its machine can do; the page on it is followed literally."""

import json
import re
import shlex
from pathlib import Path

import pytest
from pages import ROOT, steps_of, words_of

import craftsim
from craftsim import cli, load_machines
from craftsim.cli import progress
from craftsim.discrete.grid import Piece, grid_of
from craftsim.discrete.kinds import CarField, Kind
from craftsim.mjcf.machines import NOMINAL

PAGE = "docs/how-to/machine.md"
CARS = ROOT / "tests" / "data" / "cars"


TUTORIAL = "docs/tutorials/machine.md"
SMALLER = {
    "validate simple_two_story": ["--trials", "1"],
    "validate strip --plan": ["--video", "none"],
    "train": ["--steps", "200", "--worlds", "10", "--episodes", "1", "--until", "0"],
    "validate strip --policy": ["--video", "none", "--backend", "grid"],
}
"""Options that make commands of the tutorial short, by how they begin."""


def test_the_tutorial_is_followed_in_a_fresh_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(progress, "_FIRST_LINE_S", 0.0)
    statuses = []
    for step in steps_of(TUTORIAL):
        if step.kind == "save":
            (tmp_path / step.name).write_text(step.text, encoding="utf-8")
            continue
        words = words_of(step)[1:]
        if words[0] == "audit":
            # Learning takes minutes; the rules written by hand stand for what it writes.
            Path(words[words.index("--learn") + 1]).write_text(
                (ROOT / "examples" / "unladen_car.rules.yaml").read_text(encoding="utf-8")
            )
            continue
        line = shlex.join(words)
        for beginning, options in SMALLER.items():
            if line.startswith(beginning):
                for name in options[::2]:
                    if name in words:
                        place = words.index(name)
                        del words[place : place + 2]
                words += options
        if "--backend" in words:
            for name in ("--machines", "--randomize"):
                place = words.index(name)
                del words[place : place + 2]
        statuses.append(cli.main(words))
    # The weak car fails at climbing with loads; a policy that was hardly trained fails, too.
    assert statuses[:-1] == [0, 0, 0, 1, 0, 0, 0]
    assert statuses[-1] in (0, 1)
    assert load_machines("mycar.yaml").digest == NOMINAL.digest
    text = Path("mycar.yaml").read_text()
    assert "# climb a slope with a slope: 2.5 Nm, where 0.832 is needed" in text
    printed = capsys.readouterr().out
    assert "\nmachine check unladen_car.yaml\n" in printed, "it says what it does"
    assert "Tasks get what they need." in printed
    assert printed.count("The run did in physics what the rules predict.") >= 2
    (sample,) = re.findall(r"```text\n(.*?)```", (ROOT / TUTORIAL).read_text(), re.DOTALL)
    assert all(figure in printed for figure in re.findall(r"\d+\.\d+", sample))


def test_the_rules_of_the_unladen_car_forbid_what_the_check_finds():
    rules = craftsim.Rules(ROOT / "examples" / "unladen_car.rules.yaml")
    before_ramp = grid_of(
        [Piece(Kind.BLOCK, (3, 0, 1)), Piece(Kind.BODY, (2, 0, 1), 2)],
        [(0, 0, 1, 0, 0, 0, 0)],
        (4, 1, 2),
    )
    assert rules.legal(before_ramp, 0, craftsim.Action.MOVE_RIGHT)
    before_ramp.cars[0, CarField.LOAD] = Kind.BLOCK
    assert craftsim.Rules("physical").legal(before_ramp, 0, craftsim.Action.MOVE_RIGHT)
    explanation = rules.explain(before_ramp, 0, craftsim.Action.MOVE_RIGHT)
    assert explanation.learned == "climbs-unladen"
    path = ROOT / "examples" / "unladen_car.rules.yaml"
    env = craftsim.parallel_env("strip", rule_set=str(path))
    env.reset(seed=0)
    env.close()


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
    from_mjcf, tuning = commands
    assert tuning[0] == "tune"
    (mapping,) = re.findall(r"```yaml\n(.*?)```", (ROOT / PAGE).read_text(), re.DOTALL)
    Path("parts.yaml").write_text(mapping)
    Path("car.xml").write_text((CARS / "rosbot_like.xml").read_text())
    Path("mycar.yaml").touch()
    assert cli.main(from_mjcf) == 2, "the file is there"
    Path("mycar.yaml").unlink()
    assert cli.main(from_mjcf) == 1, "sizes do not fit"
    text = Path("mycar.yaml").read_text()
    assert "# not represented: wheel_y_m: 0.135 does not fit" in text
    assert (
        "wheel_torque_nm: 1.488  # Nm; largest torque of a motor at its wheel; read: limit" in text
    )
    assert load_machines("mycar.yaml").car(0).mass_kg == pytest.approx(5.7)
    assert "left out" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["rosbot_like", "lekiwi_like"])
def test_a_car_that_was_read_builds_as_predicted(name, tmp_path):
    path = tmp_path / "own.yaml"
    words = ["--from", str(CARS / f"{name}.xml"), "--mapping", str(CARS / f"{name}.yaml")]
    assert cli.main(["machine", "new", str(path), *words]) == 1
    result = craftsim.validate("simple_two_story", machines=path, randomize="mild", trials=1)
    assert (result.to_frame().result == "as predicted").all()


def test_a_car_whose_servos_a_step_cannot_take_is_written_and_said(tmp_path, capsys):
    text = (CARS / "rosbot_like.xml").read_text().replace('armature="0.01"', 'armature="0.002"')
    (tmp_path / "car.xml").write_text(text)
    words = ["--from", str(tmp_path / "car.xml"), "--mapping", str(CARS / "rosbot_like.yaml")]
    assert cli.main(["machine", "new", str(tmp_path / "own.yaml"), *words]) == 1
    assert "has a gain of 2.95" in capsys.readouterr().err
    assert "# not represented: the velocity loop" in (tmp_path / "own.yaml").read_text()
    assert cli.main(["machine", "new", str(tmp_path / "other.yaml"), *words[:2]]) == 2
    assert "--from and --mapping go together" in capsys.readouterr().err


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
