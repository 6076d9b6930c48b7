"""The control arm of a comparison: trials of one run, between which nothing is changed but what is drawn."""

import json

import numpy as np
import pytest
from synthetic import attempt, record

from craftsim import cli
from craftsim.checking.attempt import Verdict
from craftsim.experiments.compare import compare_with_reality, control_arm
from craftsim.experiments.compare_report import gap_report
from craftsim.experiments.records import Finished
from craftsim.experiments.report_parts import arms_table

RUNS = 100
ANY = {"config": {}, "versions": {}}


def trials(rng, works, *, n=60, seconds=1.0, plans=("a", "b")):
    """Return records of trials of plans that work with some probability."""
    records = []
    for plan in plans:
        for number in range(n // len(plans)):
            result = Verdict.AS_PREDICTED if rng.random() < works else Verdict.FAILED
            act = attempt(result, duration_s=seconds * rng.normal(1.0, 0.02))
            records.append(record(f"{plan}#{number}", act, group=plan))
    return records


def test_a_control_arm_differs_in_at_most_a_twentieth_of_runs():
    rng = np.random.default_rng(0)
    alarms = sum(control_arm(ANY, trials(rng, 0.7)).trials.differ for _ in range(RUNS))
    assert alarms <= 0.05 * RUNS


def test_a_planted_difference_shows_in_its_arm_and_not_in_the_control_arm(tmp_path):
    rng = np.random.default_rng(1)
    seen = 0
    for _ in range(20):
        first = Finished(tmp_path, ANY, trials(rng, 0.9))
        second = Finished(tmp_path, ANY, trials(rng, 0.4, seconds=1.1))
        gap = compare_with_reality(first, second)
        seen += gap.trials.differ
        assert not gap.control.trials.differ
        assert gap.control.trials.pairs == 30
        assert gap.actions.duration_ratio == pytest.approx(1.1, abs=0.03)
        assert gap.control.actions.duration_ratio == pytest.approx(1.0, abs=0.03)
    assert seen >= 19


def test_only_trials_of_one_plan_in_one_world_are_paired():
    rng = np.random.default_rng(2)
    records = trials(rng, 0.9, n=5, plans=["a"]) + trials(rng, 0.9, n=1, plans=["b"])
    control = control_arm(ANY, records)
    assert (control.trials.pairs, control.actions.actions) == (2, 2)


@pytest.mark.parametrize("config", [{"stop": True}, {"certify": 0.99}])
def test_there_is_none_where_trials_are_alike_or_ended_by_their_outcomes(config):
    assert control_arm(ANY, [record(f"a#{n}", attempt()) for n in range(4)]) is None
    rng = np.random.default_rng(3)
    assert control_arm({"config": config}, trials(rng, 0.9)) is None
    assert control_arm({"config": {"stop": False, "certify": None}}, trials(rng, 0.9))


def test_trials_that_are_no_independent_draws_are_called_so(tmp_path):
    """Every second trial fails, as if a car had been left where the trial before had put it."""
    records = []
    for number in range(40):
        result = (Verdict.AS_PREDICTED, Verdict.FAILED)[number % 2]
        records.append(record(f"a#{number}", attempt(result, duration_s=1.0 + 0.01 * number)))
    run = Finished(tmp_path, ANY, records)
    gap = compare_with_reality(run, run)
    assert gap.control.trials.only_first == 20
    arms = arms_table(gap.trials, gap.actions, gap.control)
    assert [row[:2] for row in arms.rows] == [("changed", 40), ("nothing changed", 20)]
    assert "trials are no independent draws" in arms.note
    assert arms in gap_report(gap, tmp_path, tmp_path, 0).sections[0].blocks


def test_compare_shows_it_unless_it_is_left_out(tmp_path, capsys):
    plan = tmp_path / "drive.plan"
    plan.write_text("0 0 MOVE_RIGHT\n")
    sim = str(tmp_path / "sim")
    again = str(tmp_path / "again")
    validate = ["validate", "strip", "--plan", str(plan), "--randomize", "mild", "--trials", "4"]
    validate += ["--drive", "wheels", "--video", "none"]
    assert cli.main([*validate, "--out", sim]) == 0
    assert cli.main([*validate, "--baseline", sim, "--out", again]) == 0
    assert "Control arm" in capsys.readouterr().out

    def figures(*options):
        out = tmp_path / "compare"
        cli.main(["compare", sim, again, *options, "--out", str(out)])
        return json.loads((out / "report.json").read_text())["figures"]["compare"]

    control = figures()["control"]
    assert (control["trials"]["pairs"], control["trials"]["both"]) == (2, 2)
    assert "nothing changed" in capsys.readouterr().out
    assert figures("--no-control")["control"] is None
    assert "--no-control" in capsys.readouterr().out
