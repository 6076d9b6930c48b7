"""What is said of a simulation and reality; here a simulation with hidden parameters stands for reality."""

import json

import pytest
from synthetic import attempt, record

from craftsim import cli
from craftsim.checking.attempt import Verdict
from craftsim.errors import InputError
from craftsim.experiments.compare import compare_with_reality
from craftsim.experiments.records import Finished
from craftsim.validation.forms import read_run


def _run(tmp_path, records, **config):
    return Finished(tmp_path, {"config": config, "versions": {}}, records)


def _runs(tmp_path, share, seconds=1.0):
    """Return a run of three plans, ten trials each, of which some succeed, by plan."""
    made = [
        record(
            f"{plan}#{n}",
            attempt(Verdict.FAILED if n >= good else Verdict.AS_PREDICTED, duration_s=seconds),
            group=plan,
        )
        for plan, good in share.items()
        for n in range(10)
    ]
    return _run(tmp_path, made)


def test_a_run_agrees_with_itself(tmp_path):
    run = _runs(tmp_path, {"a": 10, "b": 7, "c": 2})
    gap = compare_with_reality(run, run)
    assert gap.agrees
    assert gap.by_verb["MOVE"].agreement.rate == 1.0
    assert gap.by_verb["MOVE"].duration_ratio.value == 1.0
    assert gap.ranks.mmrv == 0.0
    assert gap.ranks.pearson.value == pytest.approx(1.0)
    assert all(shift.distance == 0.0 for shift in gap.error_shifts.values())


def test_ranks_durations_and_outcomes_are_those_of_reality_by_the_simulation(tmp_path):
    sim, real = _runs(tmp_path, {"a": 9, "b": 7, "c": 2}), _runs(tmp_path, {"a": 3, "b": 7, "c": 1}, 1.5)
    gap = compare_with_reality(sim, real)
    # Plans a and b change places: the distance in reality, 0.4, counts for both of them.
    assert gap.ranks.mmrv == pytest.approx(0.8 / 3)
    assert [(plan.sim, plan.real) for plan in gap.plans] == [(0.9, 0.3), (0.7, 0.7), (0.2, 0.1)]
    ratio = gap.by_verb["MOVE"].duration_ratio
    assert (ratio.value, ratio.low, ratio.high) == (1.5, 1.5, 1.5)
    assert gap.by_verb["MOVE"].agreement.successes == 30 - 6 - 1
    assert gap.by_verb["MOVE"].sim.successes == 18
    assert gap.trials.only_first == 7


def test_runs_without_a_common_trial_are_refused(tmp_path):
    with pytest.raises(InputError, match="no trial in common"):
        compare_with_reality(
            _run(tmp_path, [record("a", attempt())]), _run(tmp_path, [record("b", attempt())])
        )
    with pytest.raises(InputError, match="holds no run"):
        read_run(tmp_path)


def test_a_hidden_delay_shows_in_the_outcomes(tmp_path, capsys):
    """The same plan on two sets of machines; what differs is told, and that there are too few plans to rank."""
    late = tmp_path / "late.yaml"
    late.write_text("{min_delay_s: 0.1, max_delay_s: 0.1}")
    words = [
        "validate",
        "strip",
        "--drive",
        "reduced",
        "--randomize",
        "mild",
        "--trials",
        "6",
        "--video",
        "none",
    ]
    cli.main([*words, "--out", str(tmp_path / "sim")])
    cli.main([*words, "--noise", str(late), "--assume", "none", "--out", str(tmp_path / "real")])
    status = cli.main(
        ["compare", str(tmp_path / "sim"), str(tmp_path / "real"), "--out", str(tmp_path / "gap")]
    )
    assert status == 1
    gap = json.loads((tmp_path / "gap" / "report.json").read_text())["figures"]["compare"]
    assert gap["changed"]["config.setup.randomization.sensors.max_delay_s"] == [0.02, 0.1]
    assert gap["trials"]["only_first"] == 6
    assert gap["ranks"] is None
    assert "at least three plans" in capsys.readouterr().out
    assert cli.main(["compare", str(tmp_path), str(tmp_path / "real"), "--out", str(tmp_path / "gap")]) == 2
