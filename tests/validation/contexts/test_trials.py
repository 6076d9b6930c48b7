"""Trials: equal at any number of workers, honest about failures, and a quick sample of all contexts succeeds."""

import json
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial

import pytest
from craftsim.validation.contexts.figures import GROUPS, campaign_figures, reasons, summaries, summarise
from craftsim.validation.contexts.trials import (
    NOMINAL,
    WITH_NOISE,
    Thresholds,
    Trial,
    do_trial,
    items_of,
    plan_trials,
    run_trial,
)

from craftsim import cli
from craftsim.validation.campaign import Done, Header, run_campaign
from craftsim.validation.campaign.items import Failure, make_record
from craftsim.validation.contexts.context import Verb
from craftsim.validation.contexts.survey import survey

CONTEXTS = survey().contexts


def _spread(per_verb):
    """Return contexts randomization over the actions, moves being the most varied."""
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


def test_records_are_equal_at_any_number_of_workers(tmp_path):
    trials = plan_trials([context for context in CONTEXTS if context.level == 1], 6, seed=4)
    items, work = items_of(trials, 4), partial(do_trial, seed=4, settings=WITH_NOISE)
    header = Header("trials", 4, {})
    alone, shared = (run_campaign(items, work, tmp_path / str(n), header, workers=n, batch=2) for n in (1, 2))
    assert alone == shared
    assert [record["error"] for record in alone] == [None] * 6


def test_a_trial_alone_is_the_trial_of_the_campaign(tmp_path):
    trials = plan_trials(CONTEXTS, 3, seed=5)
    work = partial(do_trial, seed=5, settings=NOMINAL)
    records = run_campaign(items_of(trials, 5), work, tmp_path, Header("trials", 5, {}))
    alone = run_trial(trials[2], 5)
    assert records[2]["context"] == trials[2].context.id == alone.context
    assert records[2]["agrees"] == alone.succeeded
    assert records[2]["extra"]["car_error_m"] == alone.car_error_m
    assert records[2]["extra"]["duration_s"] == alone.duration_s


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
    assert not do_trial(Trial(0, drop), 0, strict).agrees


def test_figures_group_trials_and_count_one_without_an_end_as_failed():
    context = CONTEXTS[0]
    done = do_trial(Trial(0, context), 0, NOMINAL)
    blocked = Done(False, extra={**done.extra, "reasons": ["blocked", "not executed"]})
    answers = (done, blocked, Failure("no answer within 120 s"))
    items = items_of([Trial(index, context) for index in range(3)], 0)
    records = [make_record(*item) for item in zip(items, range(3), answers, strict=True)]
    contexts = {context.id: context}
    figures = campaign_figures(records, contexts, survey())
    assert (figures["all"].trials, figures["all"].successes) == (3, 1)
    assert figures["failures"] == {"blocked; not executed": 1, "no answer within 120 s": 1}
    assert figures["errors"] == {"no answer within 120 s": 1}
    assert figures["all"].car_error_mm.p50 == 1e3 * done.extra["car_error_m"]
    assert set(figures["by"]) == set(GROUPS)
    good = records[:1]
    assert summaries(good, contexts, GROUPS["level"])[str(context.level)] == summarise(good)
    assert reasons(good) == {}
    assert summarise(records[2:]).car_error_mm is None


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


def test_a_killed_command_goes_on_to_the_report_of_an_undisturbed_one(tmp_path):
    words = [sys.executable, "-m", "craftsim.cli", "trials", "--trials", "16", "--actions", "STOP", "--out"]

    def results(out):
        report = json.loads((out / "report.json").read_text())
        del report["wall"]
        return report, (out / "trials.jsonl").read_bytes()

    lines = tmp_path / "killed" / "trials.jsonl"
    process = subprocess.Popen([*words, str(tmp_path / "killed")], stdout=subprocess.DEVNULL)
    end = time.monotonic() + 60
    while not (lines.exists() and lines.read_bytes().count(b"\n")):
        assert time.monotonic() < end
        time.sleep(0.01)
    process.kill()
    process.wait()
    kept = lines.read_bytes()
    assert 0 < kept.count(b"\n") < 16
    assert not (tmp_path / "killed" / "report.json").exists()
    assert (
        subprocess.run([*words, str(tmp_path / "killed")], capture_output=True, check=False).returncode == 2
    )
    assert lines.read_bytes() == kept
    assert cli.main([*words[3:], str(tmp_path / "killed"), "--resume"]) == 0
    assert cli.main([*words[3:], str(tmp_path / "whole")]) == 0
    assert results(tmp_path / "killed") == results(tmp_path / "whole")
