"""craftsim robot excite and identify: files that go on to be used, and exit codes."""

import json
import math

import pytest
from robots.bags import write_bag
from tuning.tuning_cars import HIDDEN

from craftsim import cli, load_machines
from craftsim.checking.setup import setup_of
from craftsim.cli import tune
from craftsim.rendering.plots import style
from craftsim.robots.log_files import read_log, write_table
from craftsim.tuning import identification


def test_excite_writes_a_log_and_commands_to_replay(tmp_path, capsys):
    words = ["robot", "excite", "--duration", "12", "--drive", "wheels", "--out", str(tmp_path)]
    assert cli.main(words) == 0
    log, commands = read_log(tmp_path / "log.csv"), read_log(tmp_path / "commands.csv")
    assert (log.commands == commands.commands).all()
    assert len(log) == 600
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["figures"]["stayed"] is True
    assert report["seed"] == 0
    out = capsys.readouterr().out
    assert "12.0 s" in out
    drawn = report["figures"]["drawn"]
    limits = drawn["torque limit of the wheel motors, Nm"]
    assert len(set(limits)) == 4
    assert all(
        abs(limit / 2.5 - 1) < 0.08 for limit in limits
    )  # --randomize mild draws 7.5 % either way
    assert 10.0 < drawn["delay of the localisation, ms"][0] < 20.0
    assert f"torque limit of the wheel motors, Nm: {limits[0]:.4g}" in out


def test_identify_shows_progress_without_a_terminal_and_writes_files_to_run_with(
    tmp_path, capsys, log, monkeypatch
):
    # The look of plots is that of tests/rendering.
    monkeypatch.setattr(style, "DPI", 40)
    monkeypatch.setattr(tune, "IDENTIFY_EVERY_S", 0.0)
    table = write_table(tmp_path / "log.csv", {0: log})
    out = tmp_path / "out"
    assert (
        cli.main(["robot", "identify", str(table), "--held-out", str(table), "--out", str(out)])
        == 0
    )
    machines, noise = (
        load_machines(out / "parameters.yaml"),
        setup_of(noise=out / "noise.yaml").randomization.sensors,
    )
    assert machines.car(0).gear_friction_nm == pytest.approx(
        HIDDEN["smartcar.gear_friction_nm"], rel=0.05
    )
    assert machines.car(0).wheel_mass_kg == 2.3
    assert (
        noise.min_delay_s == noise.max_delay_s == pytest.approx(HIDDEN["noise.delay_s"], abs=0.005)
    )
    figures = json.loads((out / "report.json").read_text())["figures"]
    for of in ("fitted_log", "held_out_log"):
        was, now = (
            figures[of][name]["wheel speeds"]["rms"] for name in ("as_assumed", "as_identified")
        )
        assert now < 0.5 * was
    assert (out / "prediction.png").stat().st_size > 1000
    said = capsys.readouterr().out
    assert "identify log.csv: fit, 1 of 3, " in said
    assert "simulations," in said
    assert "Unidentifiable: position bias" in said
    assert "held" in said


def test_wrong_input_ends_with_a_message(capsys):
    for words, said in [
        (["robot", "identify", "no.csv"], "no.csv: no such file"),
        (["robot", "identify", "no.bin"], "no log by its ending"),
        (["robot", "excite", "--duration", "1"], "--duration is 1; allowed: 10 to 3600"),
        (["robot", "excite", "--length", "0.1"], "--length is 0.1; allowed: 0.6 to 20"),
    ]:
        assert cli.main(words) == 2
        assert said in capsys.readouterr().err


def test_the_report_of_a_bag_notes_what_was_left_out(tmp_path, capsys, log, found, monkeypatch):
    pytest.importorskip("mcap_ros2")

    def alter(topic, row, message, at):
        if topic == "/localisation" and row == 100:
            nowhere = {"x": math.nan, "y": math.nan, "z": math.nan}
            message = message | {"pose": message["pose"] | {"position": nowhere}}
        return [(message, at)]

    monkeypatch.setattr(style, "DPI", 40)
    monkeypatch.setattr(identification, "identify", lambda *_: found)
    folder = tmp_path / "run"
    folder.mkdir()
    write_bag(folder / "run_0.mcap", log, alter=alter)
    assert cli.main(["robot", "identify", str(folder), "--out", str(tmp_path / "out")]) == 0
    text = f"run: /localisation: 1 of {len(log)} messages have no x_m, y_m, heading_rad, pitch_rad, roll_rad"
    assert text in " ".join(capsys.readouterr().out.split())
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["figures"]["notes"][0].startswith(text)
