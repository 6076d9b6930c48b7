"""Trials: equal at any number of workers, honest about failures, and a quick sample of all contexts succeeds."""

import json
from dataclasses import replace

import pytest

from craftsim import cli
from craftsim.validation.contexts.figures import GROUPS, campaign_figures, grouped, reasons, summarise
from craftsim.validation.contexts.survey import Verb, survey
from craftsim.validation.contexts.trials import (
    NOMINAL,
    WITH_NOISE,
    Thresholds,
    Trial,
    plan_trials,
    run_trial,
    run_trials,
)

CONTEXTS = survey().contexts


def _spread(per_verb):
    """Return contexts spread over the actions, moves being the most varied."""
    chosen = []
    for verb in Verb:
        mine = [context for context in CONTEXTS if context.verb is verb]
        wanted = 3 * per_verb if verb is Verb.MOVE else per_verb
        chosen += mine[:: max(1, len(mine) // wanted)][:wanted]
    return chosen


SAMPLE = _spread(4)


@pytest.mark.parametrize("index", range(len(SAMPLE)), ids=lambda index: SAMPLE[index].id)
def test_a_quick_sample_of_the_contexts_succeeds(index):
    record = run_trial(Trial(index, SAMPLE[index]), seed=1)
    assert record.succeeded, record


def test_records_are_equal_at_any_number_of_workers():
    trials = plan_trials([context for context in CONTEXTS if context.level == 1], 6, seed=4)
    alone = [record.line() for record in run_trials(trials, 4, WITH_NOISE, workers=1)]
    shared = [record.line() for record in run_trials(trials, 4, WITH_NOISE, workers=2)]
    assert alone == shared


def test_a_trial_alone_is_the_trial_of_the_campaign():
    trials = plan_trials(CONTEXTS, 3, seed=5)
    records = list(run_trials(trials, 5))
    assert run_trial(trials[2], 5) == records[2]


def test_trials_are_spread_evenly_and_reproducibly():
    chosen = CONTEXTS[:7]
    trials = plan_trials(chosen, 17, seed=0)
    counts = [sum(trial.context == context for trial in trials) for context in chosen]
    assert sorted(counts) == [2, 2, 2, 2, 3, 3, 3]
    assert [trial.index for trial in trials] == list(range(17))
    assert trials == plan_trials(chosen, 17, seed=0) != plan_trials(chosen, 17, seed=1)
    assert plan_trials([], 5, seed=0) == []


def test_errors_beyond_a_threshold_are_failures_with_a_reason():
    strict = replace(NOMINAL, thresholds=Thresholds(-1.0, -1.0, -1.0, -1.0))
    drop = next(context for context in CONTEXTS if context.verb is Verb.DROP)
    record = run_trial(Trial(0, drop), 0, strict)
    assert not record.succeeded
    assert record.reasons == ("car error", "heading error", "placed error", "others moved")
    assert json.loads(record.line())["succeeded"] is False


def test_figures_group_trials():
    good = run_trial(Trial(0, CONTEXTS[0]), 0)
    bad = replace(good, index=1, reasons=("blocked", "not executed"))
    contexts = {CONTEXTS[0].id: CONTEXTS[0]}
    figures = campaign_figures([good, bad], contexts, survey())
    assert (figures["all"].trials, figures["all"].successes) == (2, 1)
    assert figures["failures"] == {"blocked; not executed": 1}
    assert set(figures["by"]) == set(GROUPS)
    assert grouped([good], contexts, GROUPS["level"])[str(CONTEXTS[0].level)] == summarise([good])
    assert reasons([good]) == {}


def test_the_command_writes_a_report_and_a_line_for_each_trial(tmp_path, capsys):
    words = ["trials", "--trials", "4", "--actions", "STOP", "LIFT", "--contexts", "*level=1*room=free"]
    assert cli.main([*words, "--out", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    lines = [json.loads(line) for line in (tmp_path / "trials.jsonl").read_text().splitlines()]
    assert [line["index"] for line in lines] == [0, 1, 2, 3]
    assert all(line["context"].split("/")[0] in ("STOP", "LIFT") for line in lines)
    assert report["figures"]["all"]["trials"] == 4
    assert report["figures"]["contexts"] == len(CONTEXTS)
    assert "reaches the bar of 99.90 %" in capsys.readouterr().out


def test_the_command_fails_below_its_bar_and_refuses_wrong_input(tmp_path, capsys, monkeypatch):
    from craftsim.validation.contexts import trials as module

    strict = replace(NOMINAL, thresholds=Thresholds(car_m=-1.0))
    monkeypatch.setattr(module, "NOMINAL", strict)
    words = ["trials", "--actions", "STOP", "--out", str(tmp_path)]
    assert cli.main([*words, "--trials", "2"]) == 1
    assert "does NOT reach" in capsys.readouterr().out
    assert cli.main([*words, "--trials", "0"]) == 2
    assert cli.main([*words, "--at-least", "2"]) == 2
    assert cli.main([*words, "--contexts", "nothing like it"]) == 2
    assert "no context matches 'nothing like it'" in capsys.readouterr().err
