"""The study of the physics step."""

import json

from synthetic import attempt

from craftsim.checking.attempt import Attempt, Verdict
from craftsim.commands.bench import bench
from craftsim.commands.bench_steps import STEPS_S, Outcomes


def _outcomes(*attempts):
    return Outcomes(tuple((Attempt.of(one),) for one in attempts), 1.0)


def test_trials_are_compared_one_by_one_with_the_finest_step():
    finest = _outcomes(
        attempt(car_error_m=0.001, duration_s=1.0, peak_force_n=100.0), attempt(Verdict.FAILED)
    )
    coarse = _outcomes(attempt(car_error_m=0.003, duration_s=1.5, peak_force_n=150.0), attempt())
    found = coarse.against(finest)
    assert found["verdicts_alike"] == 0.5
    assert abs(found["error_difference_m"] - 0.002) < 1e-12
    assert (found["duration_ratio"], found["peak_force_ratio"]) == (1.5, 1.5)


def test_the_study_tries_each_step_and_reports(tmp_path, capsys):
    assert bench("steps", contexts=2, drive="reduced", out=tmp_path) == 0
    assert "reduced: 2 trials" in capsys.readouterr().out
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert list(report["figures"]["steps_ms"]) == [f"{1e3 * step:.2f}" for step in STEPS_S]
    assert report["config"]["drive"] == "reduced"
