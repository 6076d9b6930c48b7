"""The audit finds known unsound rules unsound and known needless ones conservative, the same way every time."""

import json
from dataclasses import replace

import pytest
from validation.campaign.sessions import put
from validation.synthetic import attempt, audit, record

from craftsim import cli
from craftsim.audit import plan as planned
from craftsim.audit.audit import (
    AuditTrial,
    RuleVerdict,
    audit_rows,
    judge,
    run_audit,
    run_trial,
    trials_of,
    verdict_counts,
)
from craftsim.audit.plan import audit_plan, corrections
from craftsim.audit.survey import survey
from craftsim.checking import judge as judging
from craftsim.checking.attempt import Attempt, Verdict
from craftsim.checking.setup import setup_of
from craftsim.checking.thresholds import thresholds_of
from craftsim.discrete.actions import ACTIONS, verbs
from craftsim.errors import InputError
from craftsim.experiments.bundle import read_bundle, replay
from craftsim.experiments.experiment import RunOptions

UNSOUND = {
    "FOLD/level=1/ground=flat/own=body-back/load=none/beyond=taken/room=free": "swinging_flap",
    "MOVE-forward/level=2+/ground=high-up/own=air/load=none/next=above-body-forward/room=free": "own_ramp",
    "UNFOLD/scene=car in the foot's cell": "swinging_flap",
    "ROTATE_LEFT/scene=car beside, block turns": "turning_load",
    "MOVE/scene=behind a load that leans": "leaning_load",
    "MOVE/scene=onto a second ramp": "second_ramp",
}
"""Rows of the published rules, and the flag that corrects each."""
CONSERVATIVE = "MOVE-back/level=2+/ground=high-up/own=air/load=none/next=air/room=free"
AT_ONCE = "MOVE+MOVE/scene=unloaded at a right angle/order=at-once"
SETUP = setup_of("mild", "published", drive="wheels")


def _audit(out, plan, setup=SETUP, **options):
    return run_audit(
        plan, setup, 2, 0, out, selection={"randomize": "mild"}, options=RunOptions(**options)
    )


@pytest.fixture(scope="module")
def plan():
    """The rows of a small audit of the published rules."""
    wanted = {
        *UNSOUND,
        CONSERVATIVE,
        AT_ONCE,
        "STOP/level=1/ground=flat/own=air/load=none/room=free",
    }
    chosen = [row for row in audit_plan("published") if row.name in wanted]
    assert {row.name for row in chosen} == wanted
    return chosen


@pytest.fixture(scope="module")
def found(plan, tmp_path_factory):
    """What it finds, with two workers."""
    return _audit(tmp_path_factory.mktemp("audit"), plan, workers=2)


def test_a_trial_alone_and_in_any_order_is_the_trial_of_the_campaign(plan, found):
    recorded = {record["key"]: record for record in found.records}
    assert all(record["error"] is None for record in found.records)
    items = [item for item in trials_of(plan, 2, 0, SETUP) if item.job][::-1]
    for item in items[::3]:
        done = run_trial(item.job)
        assert recorded[item.key]["agrees"] == done.agrees
        assert tuple(map(Attempt.of, recorded[item.key]["attempts"])) == done.attempts


def test_known_unsound_rules_are_found_unsound_with_a_reason(found):
    rows = {row.name: row for row in found.rows}
    for name in UNSOUND:
        assert rows[name].verdict == "unsound", rows[name]
        assert rows[name].reason
        assert len(rows[name].bundles) == 1
    assert rows[CONSERVATIVE].verdict == "conservative"
    assert sum(row.verdict == "sound" for row in rows.values()) == 1
    assert AT_ONCE not in rows, "what is begun at once is evidence only"
    assert (
        "begun all at once" in next(one for one in found.suspects if one["number"] == 3)["evidence"]
    )


def test_a_bundle_that_is_there_is_not_made_again_and_one_that_comes_out_otherwise_stops_the_audit(
    tmp_path,
):
    plan = [row for row in audit_plan("published") if row.name == "MOVE/scene=onto a second ramp"]
    (row,) = _audit(tmp_path, plan).rows
    kept = tmp_path / row.bundles[0] / "bundle.json"
    kept.write_text("mine")
    assert _audit(tmp_path, plan, resume=True).rows == (row,)
    assert kept.read_text() == "mine"
    kept.unlink()
    line = json.loads((tmp_path / "trials.jsonl").read_text().splitlines()[0])
    line["attempts"][0]["duration_s"] = 1e3
    put(tmp_path, 0, json.dumps(line))
    with pytest.raises(InputError, match=r"no replay bundle of .*came out otherwise.*--resume"):
        _audit(tmp_path, plan, resume=True)


def test_each_of_them_is_traced_to_the_switch_that_corrects_it_and_forbidden_by_physical():
    legal = {row.name for row in audit_plan("physical") if row.legal}
    assert legal & set(UNSOUND) == {"MOVE/scene=onto a second ramp"}, "only its effect was wrong"
    plan = [row for row in audit_plan("published") if row.name in UNSOUND]
    assert corrections(plan, "published") == {name: (flag,) for name, flag in UNSOUND.items()}
    assert corrections(plan, "physical") == dict.fromkeys(UNSOUND, ())


def test_the_command_reports_and_bundles_each_disagreement_and_finds_physical_sound(
    tmp_path, capsys
):
    words = [
        "--situations",
        "MOVE/scene=on* a second ramp",
        "--trials",
        "2",
        "--drive",
        "wheels",
        "--out",
    ]
    assert cli.main(["audit", *words, str(tmp_path / "published")]) == 1
    printed = capsys.readouterr().out
    assert "1 of 1 row that the rules allow are unsound" in printed
    assert "second_ramp 1" in printed
    report = json.loads((tmp_path / "published" / "report.json").read_text())
    (row,) = report["figures"]["audit"]["rows"]
    assert (row["trials"], row["as_predicted"], row["contexts"]) == (2, 0, 1)
    page = (tmp_path / "published" / "report.html").read_text()
    assert "second ramp" in page
    for place in (printed, page):
        assert "provisional" not in place, "two failures of two trials settle a row"
    assert report["figures"]["audit"]["provisional"] == 0
    assert report["figures"]["audit"]["corrections"] == {"second_ramp": 1}
    assert row["corrections"] == ["second_ramp"]
    (bundle,) = row["bundles"]
    assert replay(read_bundle(tmp_path / "published" / bundle)).reproduced
    words += [
        str(tmp_path / "physical"),
        "--rules",
        "physical",
        "--baseline",
        str(tmp_path / "published"),
    ]
    assert cli.main(["audit", *words]) == 0
    printed = capsys.readouterr().out
    assert "0 of 1 row that the rules allow are unsound" in printed
    assert "1 row is judged by too few trials: provisional." in printed
    assert "of 2 paired trials 0 agree with the rules in both, 0 only there, 2 only here" in printed
    paired = json.loads((tmp_path / "physical" / "report.json").read_text())["figures"]["paired"]
    changed = ["published", "physical"]
    assert paired["changed"] == {"config.rules": changed, "config.setup.rules": changed}
    assert paired["trials"]["p_value"] == 0.5
    assert "this run alone" in (tmp_path / "physical" / "report.html").read_text()


def test_the_command_refuses_wrong_input(tmp_path, capsys, monkeypatch):
    assert cli.main(["audit", "--situations", "nothing like it", "--out", str(tmp_path)]) == 2
    assert "no row matches 'nothing like it'" in capsys.readouterr().err
    monkeypatch.setattr(planned, "audit_plan", lambda *args: pytest.fail("contexts are looked for"))
    for words, message in {
        "--trials 0": "--trials",
        "--gains gone.yaml": "gone.yaml: no such file",
    }.items():
        assert cli.main(["audit", *words.split(), "--out", str(tmp_path)]) == 2
        assert message in capsys.readouterr().err


def _of(verb):
    return [one for one, legal in survey() if legal and ACTIONS[one.acts[0]].verb == verb]


@pytest.mark.parametrize("verb", verbs())
def test_a_sample_of_what_physical_allows_succeeds_on_rollers(verb):
    mine, wanted = _of(verb), 6 if verb == "MOVE" else 2
    for situation in mine[:: max(1, len(mine) // wanted)][:wanted]:
        done = run_trial(AuditTrial(situation, True, 0, 1, setup_of("none")))
        assert done.agrees, (situation.id, done)
        assert done.attempts[0].agrees


def test_an_error_beyond_its_limit_is_a_failure_with_a_reason(monkeypatch):
    strict = replace(thresholds_of(), place_m=-1.0)
    monkeypatch.setattr(judging, "thresholds_of", lambda _: strict)
    done = run_trial(AuditTrial(_of("DROP")[0], True, 0, 0, SETUP))
    (attempt,) = done.attempts
    assert (done.agrees, attempt.result, attempt.finding) == (False, "failed", "agrees")
    assert attempt.reason.startswith("the car is ")


def test_each_trial_of_a_situation_has_its_own_noise_and_physics():
    setup, stop = setup_of("strong", drive="wheels"), _of("STOP")[0]
    first, second, again = (
        run_trial(AuditTrial(stop, True, number, 0, setup)).attempts[0] for number in (0, 1, 0)
    )
    assert first == again
    assert first.car_error_m != second.car_error_m


def test_verdicts():
    for legal, has_prediction, trials, good, verdict in [
        (True, True, 20, 19, "sound"),
        (True, True, 20, 18, "unsound"),
        (False, True, 20, 19, "conservative"),
        (False, True, 20, 0, "rightly forbidden"),
        (False, False, 0, 0, "no prediction"),
        (True, True, 0, 0, "not tried"),
    ]:
        assert judge(legal, has_prediction, trials, good) == verdict


def test_a_row_counts_its_trials_by_their_worst_attempt_and_tells_the_commonest_kind_of_reason():
    failed = attempt(Verdict.FAILED, reason="block 3 was moved by 12.4 mm")
    trials = [
        *([attempt(), failed | {"reason": f"block {n} was moved by {n}.5 mm"}] for n in (1, 2)),
        [attempt(Verdict.UNSAFE, reason="car 0 tipped"), failed],
        [attempt()],
        [attempt(Verdict.NUMERICS)],
    ]
    records = [
        record(f"a#{n}", *some, group="MOVE/a", bundle=f"bundles/{n}")
        for n, some in enumerate(trials)
    ]
    records.append(record("late", group="MOVE/a", error="TimeoutError", agrees=False))
    (row,) = audit_rows(records)
    assert (row.action, row.context, row.verdict, row.provisional) == (
        "MOVE",
        "a",
        "unsound",
        False,
    )
    assert (row.trials, row.as_predicted, row.failed, row.unsafe) == (4, 1, 2, 1)
    assert (row.numerics, row.errors, len(row.bundles)) == (1, 1, 5)
    assert row.reason == "block 1 was moved by 1.5 mm (2 of 4)"


def test_no_record_is_lost():
    records = audit()
    rows = audit_rows(records)
    counts = verdict_counts(rows)
    assert len(rows) == sum(counts.values()) == len({r["group"] for r in records})
    assert all(counts[verdict] for verdict in RuleVerdict if verdict is not RuleVerdict.NOT_TRIED)
    assert all(not row.has_prediction for row in rows if row.verdict == RuleVerdict.NO_PREDICTION)
