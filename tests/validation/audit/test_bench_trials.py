"""``craftsim bench trials``: what a trial of the audit costs, and where that goes."""

import json
from functools import partial

from craftsim import cli
from craftsim.validation.audit import rows


def test_bench_says_where_the_time_of_a_trial_goes(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(rows, "audit_plan", partial(rows.audit_plan, verbs=("STOP",)))
    assert cli.main(["bench", "trials", "--contexts", "2", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "median of 2 contexts" in printed
    wall = json.loads((tmp_path / "report.json").read_text())["wall"]
    assert abs(sum(wall["stage_shares"].values()) - 1) < 1e-9
    assert 0 < wall["physics_share"] < 1
    assert wall["first_step_s"] > 0
    assert 0 < wall["stage_ms"]["compile"] < wall["median_ms"]
