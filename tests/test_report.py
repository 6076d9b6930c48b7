"""Reports are whole, comparable byte for byte, and hold what NumPy and dataclasses give."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from craftsim.discrete.kinds import Action
from craftsim.reports.json_file import SCHEMA_VERSION, write_report
from craftsim.reports.report import percent


@dataclass(frozen=True)
class Row:
    action: Action
    error_mm: np.floating


def _figures() -> dict:
    return {
        "z": np.float32(0.5),
        "a": np.arange(3),
        "flag": np.bool_(True),
        "rows": (Row(Action.LIFT, np.float64(0.25)),),
        "path": Path("film.mp4"),
        "unknown": float("nan"),
        "by_action": {Action.DROP: 2},
    }


def test_a_report_holds_figures_and_what_decides_them(tmp_path):
    path = write_report(
        tmp_path / "new" / "folder", _figures(), command="demo", seed=3, config={"step_s": 0.004}
    )
    report = json.loads(path.read_text())
    assert path.name == "report.json"
    assert report["schema_version"] == SCHEMA_VERSION
    assert (report["command"], report["seed"], report["config"]) == ("demo", 3, {"step_s": 0.004})
    assert set(report["versions"]) == {"craftsim", "mujoco", "numpy", "python", "platform"}
    assert report["versions"]["numpy"] == np.__version__
    assert report["figures"] == {
        "z": 0.5,
        "a": [0, 1, 2],
        "flag": True,
        "rows": [{"action": "LIFT", "error_mm": 0.25}],
        "path": "film.mp4",
        "unknown": None,
        "by_action": {"DROP": 2},
    }


def test_runs_differ_only_under_wall(tmp_path):
    texts = []
    for name, duration_s in (("a", 1.0), ("b", 2.0)):
        path = write_report(
            tmp_path / name, _figures(), command="demo", wall={"duration_s": duration_s}
        )
        report = json.loads(path.read_text())
        assert report.pop("wall") == {"duration_s": duration_s}
        texts.append(json.dumps(report))
    assert texts[0] == texts[1]


def test_what_json_cannot_hold_is_named_and_keeps_the_previous_report(tmp_path):
    before = write_report(tmp_path, {"value": 1}, command="demo").read_bytes()
    with pytest.raises(TypeError, match="cannot hold a set"):
        write_report(tmp_path, {"value": {1, 2}}, command="demo")
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
    assert (tmp_path / "report.json").read_bytes() == before


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (1.0, "100 %"),
        (0.9996, "> 99.9 %"),
        (0.9994, "99.9 %"),
        (0.5, "50.0 %"),
        (0.0006, "0.1 %"),
        (0.0004, "< 0.1 %"),
        (0.0, "0 %"),
        (None, "none"),
    ],
)
def test_a_share_is_all_or_nothing_only_where_it_is(share, text):
    assert percent(share) == text
