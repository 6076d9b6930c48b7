"""``craftsim reality`` reports what recordings say, the same for the same seed, and says by its status what differs."""

import json

import pytest
from reality.made import drive_arrays, toss_arrays, written

from craftsim.cli import main
from craftsim.reality import contact_law


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reality")
    written(folder / "tosses.npz", toss_arrays(0.18, n=12))
    written(folder / "rough.npz", toss_arrays(0.36, n=12))
    for seed in (0, 1):
        written(folder / f"drive{seed}.npz", drive_arrays(20.0, seed))
    return folder


@pytest.fixture(autouse=True)
def _short_search(monkeypatch):
    monkeypatch.setattr(contact_law, "_FIRST_LOOK", 16)
    monkeypatch.setattr(contact_law, "_STEPS", 25)


def _run(folder, out, *names):
    status = main(["reality", *(str(folder / name) for name in names), "--out", str(out)])
    return status, json.loads((out / "report.json").read_text(encoding="utf-8"))


def test_recordings_of_both_kinds_are_reported_together(folder, tmp_path, capsys):
    names = ("tosses.npz", "drive0.npz", "drive1.npz")
    status, report = _run(folder, tmp_path, *names)
    figures = report["figures"]
    assert (status, figures["differences"]) == (0, [])
    assert report["command"] == "reality"
    assert report["config"]["data"] == list(names)
    assert [row["kind"] for row in figures["recordings"]] == ["tosses", "drive", "drive"]
    (law,) = figures["contact_law"]
    assert [row["law"].split(",")[0] for row in law["laws"]][0::4] == ["craftsim", "fitted"]
    driving = figures["driving"]
    assert (driving["fitted_to"], driving["tested_on"]) == (["drive0.npz"], ["drive1.npz"])
    assert len(driving["models"]) == 7
    assert {*driving["models"][0]["windows"]} == {"0.5_s", "2_s", "10_s"}
    estimates = driving["identified"]["estimates"]
    assert estimates["smartcar.wheel_radius_m"]["value"] == pytest.approx(0.07, rel=0.004)
    assert estimates["smartcar.wheel_y_m"]["value"] == pytest.approx(0.169, rel=0.02)
    out = capsys.readouterr().out
    for words in ("Laws", "Errors of predicted ways", "Effective radii", "Simulated robot"):
        assert words in out
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "mean position error of a toss" in page


def test_equal_seeds_give_equal_reports_and_what_differs_gives_status_1(folder, tmp_path):
    reports = []
    for name in ("first", "second"):
        status, report = _run(folder, tmp_path / name, "rough.npz")
        assert status == 1
        report.pop("wall")
        reports.append(report)
    assert reports[0] == reports[1]
    (text,) = reports[0]["figures"]["differences"]
    assert text.startswith("rough.npz: friction 0.3")
    assert text.endswith("declared 0.18")
