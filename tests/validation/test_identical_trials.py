"""Trials that repeat another one are run once and count once, in intervals and in tests."""

import json

import numpy as np
import pytest
from synthetic import attempt, record

from craftsim import cli, validate
from craftsim.audit.audit import audit_rows
from craftsim.audit.imperfections import imperfections_of
from craftsim.audit.margins import PROBES, MarginSearch, find_margin, scenarios
from craftsim.checking.attempt import Verdict
from craftsim.checking.setup import setup_of
from craftsim.experiments.compare import compare_actions, compare_trials
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.statistics import campaign_figures, repeated

FAST = {"drive": "wheels", "randomize": "none"}
MARGIN_TRIALS = 7


def run_of(world, errors, result=Verdict.AS_PREDICTED, **changes):
    """Return records of trials in a world, each with two actions and a car's error of its own."""
    return [
        record(
            f"{world}/plan/{number:04d}",
            attempt(car_error_m=error),
            attempt(result, number=1),
            context=world,
            **changes,
        )
        for number, error in enumerate(errors)
    ]


def test_planted_duplicates_count_once_and_trials_of_which_one_differs_all_count():
    equal = run_of("strip", [0.001] * 3) + run_of("block", [0.002] * 3, Verdict.FAILED)
    figures = campaign_figures(equal, 0)
    assert figures.all == {"runs": Proportion.of(1, 2), "actions": Proportion.of(3, 4)}
    assert (figures.trials, figures.identical) == (6, 4)
    assert figures.precision["car_error_mm"].n == 3
    assert figures.survival["without_resync"]["runs"] == 2
    drawn = run_of("strip", [0.001, 0.001, 0.003])
    assert campaign_figures(drawn, 0).all["runs"] == Proportion.of(3, 3)
    assert campaign_figures(drawn, 0).identical == 0


def test_of_no_draws_the_duplicates_are_found_wherever_they_stand_and_of_draws_none():
    rng = np.random.default_rng(0)
    drawn = run_of("strip", rng.random(50).tolist())
    fixed = run_of("block", [0.004] * 50)
    records = [drawn[0], *fixed[:30], *drawn[1:], *fixed[30:]]
    assert campaign_figures(records, 0).all["runs"].trials == 51
    assert repeated(records) == {one["key"] for one in fixed[1:]}
    # What tried nothing, and what did not finish, repeats nothing.
    idle = [record(f"idle/{number}") for number in range(3)]
    lost = [record(f"lost/{number}", error="TimeoutError", agrees=False) for number in range(3)]
    assert repeated([*idle, *lost]) == set()


def test_pairs_that_are_equal_in_both_runs_are_one_pair():
    first = run_of("strip", [0.001] * 3) + run_of("block", [0.002] * 3)
    second = run_of("strip", [0.001] * 3) + run_of("block", [0.002] * 3, Verdict.FAILED)
    paired = compare_trials(first, second)
    assert (paired.pairs, paired.both, paired.only_first, paired.unpaired) == (2, 1, 1, 0)
    assert compare_actions(first, second).actions == 4
    drawn = run_of("strip", [0.001, 0.002, 0.003])
    assert compare_trials(run_of("strip", [0.001] * 3), drawn).pairs == 3


def test_a_trial_that_stands_for_several_is_beside_each_of_the_other_run():
    (once,) = run_of("strip", [0.001], extra={"identical": 3})
    drawn = run_of("strip", [0.001, 0.002, 0.003, 0.004])
    for first, second in (([once], drawn), (drawn, [once])):
        paired = compare_trials(first, second)
        assert (paired.pairs, paired.unpaired) == (3, 1)
    assert compare_trials([once], [once]).pairs == 1
    # Beside a run that repeated them all.
    assert compare_trials([once], run_of("strip", [0.001] * 3)).pairs == 1


def test_an_audit_counts_what_a_situation_repeats_once():
    rows = audit_rows(run_of("situation 1", [0.001] * 20) + run_of("situation 2", [0.001] * 20))
    assert [(row.trials, row.as_predicted) for row in rows] == [(2, 2)]


@pytest.mark.parametrize(
    ("randomize", "draws"), [("none", False), ("mild", True), ("strong", True), ("lab_floor", True)]
)
def test_a_setup_says_whether_it_draws(randomize, draws):
    assert setup_of(randomize).draws == draws


def test_without_randomness_a_plan_is_run_once_and_a_random_start_or_policy_as_often_as_was_asked(
    tmp_path,
):
    (tmp_path / "short.plan").write_text("0 0 MOVE_RIGHT\n0 1 MOVE_RIGHT\n")
    plan = str(tmp_path / "short.plan")
    once = validate("strip", plan=plan, trials=3, **FAST)
    assert [one["key"] for one in once.records] == ["strip/short/0000"]
    assert once.records[0]["extra"]["identical"] == 3
    assert once.figures.identical == 2
    assert once.figures.all["actions"].trials == 2
    several = validate("random_strip", plan=plan, trials=2, **FAST)
    assert len(several.records) == 2
    assert (
        len(validate("strip", plan=plan, trials=2, drive="wheels", randomize="mild").records) == 2
    )


def test_a_policy_that_draws_nothing_in_a_world_that_draws_nothing_counts_once(tmp_path):
    def first_offered(observations):
        return {
            agent: int(np.flatnonzero(seen["action_mask"])[0])
            for agent, seen in observations.items()
        }

    (tmp_path / "one.yaml").write_text(
        "area_length: 3\narea_width: 3\narea_height: 2\nblock_num: 0\nslope_num: 0\nsmartcar_num: 1\n"
        "smartcar:\n  - {id: 0, x: 1, y: 1, z: 1, yaw: 0}\n"
    )
    result = validate(str(tmp_path / "one.yaml"), policy=first_offered, trials=3, **FAST)
    assert len(result.records) == 3
    assert result.figures.all["runs"] == Proportion.of(1, 1)
    assert result.figures.identical == 2


def test_the_command_says_what_it_ran_once_compares_and_resumes_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.plan").write_text("0 0 MOVE_RIGHT\n0 1 MOVE_RIGHT\n")
    words = [
        "validate",
        "strip",
        "--plan",
        "short.plan",
        "--drive",
        "wheels",
        "--trials",
        "3",
        "--video",
        "none",
    ]
    assert cli.main([*words, "--randomize", "none", "--out", "first"]) == 0
    figures = json.loads((tmp_path / "first" / "report.json").read_text())["figures"]["validation"]
    assert figures["all"]["runs"]["trials"] == 1
    assert "2 trials repeat another one, as nothing is drawn at random" in capsys.readouterr().out
    assert cli.main([*words, "--randomize", "none", "--out", "first", "--resume"]) == 0
    assert cli.main([*words, "--randomize", "none", "--out", "second", "--baseline", "first"]) == 0
    assert "of 1 paired trials 1 agree" in " ".join(capsys.readouterr().out.split())
    assert cli.main([*words, "--randomize", "mild", "--out", "third", "--baseline", "first"]) == 0
    assert "of 3 paired trials 3 agree" in " ".join(capsys.readouterr().out.split())
    assert cli.main(["compare", "first", "third", "--out", "both"]) == 0
    figures = json.loads((tmp_path / "both" / "report.json").read_text())["figures"]["compare"]
    assert figures["trials"]["pairs"] == 3


def test_a_margin_of_what_draws_nothing_is_of_one_trial():
    lag, noise = imperfections_of(["motor-lag", "position-noise"])
    # On rollers, where the car does not hit the ground at any lag that is tried.
    setup = setup_of("none", drive="rollers")
    fixed, drawn = (
        find_margin(
            MarginSearch(scenarios("move unloaded")[0], setup, 0, (axis,), MARGIN_TRIALS)
        ).extra
        for axis in (lag, noise)
    )
    # The probes at the nominal and at the largest value are all that is tried.
    assert fixed["tried"] == 2 * PROBES
    assert fixed["identical"]
    assert fixed["fails_at"] == fixed["upper"]
    assert not drawn["identical"]
    assert drawn["tried"] > MARGIN_TRIALS
