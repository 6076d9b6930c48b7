"""The audit finds known unsound rules unsound and known needless ones conservative, the same way every time."""

import json

import pytest
from sessions import put

from craftsim import cli
from craftsim.audit import plan as planned
from craftsim.audit.plan import audit_plan, corrections
from craftsim.checking.attempt import Attempt
from craftsim.checking.setup import setup_of
from craftsim.errors import InputError
from craftsim.experiments.bundle import read_bundle
from craftsim.experiments.experiment import Experiment, RunOptions
from craftsim.experiments.replay import replay
from craftsim.experiments.session import open_session, run_experiment
from craftsim.validation.audit.results import Results, bundle_disagreements
from craftsim.validation.audit.trial import BATCH, items_of, try_it

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


def _items(plan):
    return items_of(plan, 2, 0, setup_of("mild", "published"))


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    """What a small audit of the published rules records, with one and with two workers."""
    wanted = {*UNSOUND, CONSERVATIVE, AT_ONCE, "STOP/level=1/ground=flat/own=air/load=none/room=free"}
    plan = [row for row in audit_plan("published") if row.name in wanted]
    assert {row.name for row in plan} == wanted
    items = _items(plan)
    return [
        run_experiment(
            Experiment("audit", 0, {}, items, try_it, batch=BATCH),
            tmp_path_factory.mktemp("audit"),
            RunOptions(n),
        )
        for n in (1, 2)
    ]


def test_records_are_equal_at_one_and_at_two_workers(records):
    assert records[0] == records[1]
    assert all(record["error"] is None for record in records[0])


def test_a_trial_alone_is_the_trial_of_the_campaign(records):
    (row,) = [row for row in audit_plan("published") if row.name == CONSERVATIVE]
    for item in _items([row]):
        done = try_it(item.job)
        (recorded,) = [record for record in records[0] if record["key"] == item.key]
        assert recorded["agrees"] == done.agrees
        assert tuple(map(Attempt.of, recorded["attempts"])) == done.attempts


def test_what_was_tried_before_changes_no_trial():
    items = [item for item in _items(audit_plan("published", ("STOP",))[::3]) if item.job][:6]
    found = {item.key: try_it(item.job) for item in reversed(items)}
    for item in items:
        assert try_it(item.job) == found[item.key]


def test_known_unsound_rules_are_found_unsound_with_a_reason(records):
    rows = {f"{row.action}/{row.context}": row for row in Results.of(records[0]).rows}
    for name in UNSOUND:
        assert rows[name].verdict == "unsound", rows[name]
        assert rows[name].reason
    assert rows[CONSERVATIVE].verdict == "conservative"
    assert sum(row.verdict == "sound" for row in rows.values()) == 1


def test_what_is_begun_at_once_is_evidence_only(records):
    results = Results.of(records[0])
    assert [f"{row.action}/{row.context}" for row in results.at_once] == [AT_ONCE]
    assert not any("at-once" in row.context for row in results.rows)
    third = next(finding for finding in results.suspects if finding.number == 3)
    assert "begun all at once" in third.evidence


def test_a_bundle_that_is_there_is_not_made_again_and_one_that_comes_out_otherwise_stops_the_audit(
    records, tmp_path
):
    name = "MOVE/scene=onto a second ramp"
    items = [item for item in _items(audit_plan("published")) if item.group == name]
    experiment = Experiment("audit", 0, {}, items, try_it, batch=BATCH)
    path = tmp_path / "audit"
    first = next(n for n, record in enumerate(run_experiment(experiment, path)) if not record["agrees"])
    kept = path / "bundles" / f"{first:05d}" / "bundle.json"
    kept.parent.mkdir(parents=True)
    kept.write_text("mine")
    with open_session(experiment, path, RunOptions(resume=True)) as session:
        assert bundle_disagreements(session, session.run()) == {first: f"bundles/{first:05d}"}
    assert kept.read_text() == "mine"
    kept.unlink()
    record = json.loads((path / "trials.jsonl").read_text().splitlines()[first])
    record["attempts"][0]["duration_s"] = 1e3
    put(path, first, json.dumps(record))
    with (
        open_session(experiment, path, RunOptions(resume=True)) as session,
        pytest.raises(InputError, match=r"no replay bundle of .*came out otherwise.*--resume"),
    ):
        bundle_disagreements(session, session.run())


def test_physical_forbids_each_of_them():
    legal = {row.name: row.legal for row in audit_plan("physical")}
    for name in UNSOUND:
        if name != "MOVE/scene=onto a second ramp":  # only its effect was wrong
            assert not any(allowed for row, allowed in legal.items() if row == name), name


def test_each_of_them_is_traced_to_the_switch_that_corrects_it():
    plan = [row for row in audit_plan("published") if row.name in UNSOUND]
    assert corrections(plan, "published") == {name: (flag,) for name, flag in UNSOUND.items()}
    assert corrections(plan, "physical") == dict.fromkeys(UNSOUND, ())


def test_the_command_reports_and_bundles_each_disagreement_and_finds_physical_sound(tmp_path, capsys):
    words = ["--situations", "MOVE/scene=on* a second ramp", "--trials", "2", "--out"]
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
        assert "1 row is judged by fewer than 20 trials: provisional." in place
    assert report["figures"]["audit"]["provisional"] == 1
    assert report["figures"]["audit"]["corrections"] == {"second_ramp": 1}
    assert row["corrections"] == ["second_ramp"]
    (bundle,) = row["bundles"]
    assert replay(read_bundle(tmp_path / "published" / bundle)).reproduced
    words += [str(tmp_path / "physical"), "--rules", "physical", "--baseline", str(tmp_path / "published")]
    assert cli.main(["audit", *words]) == 0
    printed = capsys.readouterr().out
    assert "0 of 1 row that the rules allow are unsound" in printed
    assert "of 2 paired trials 0 agree with the rules in both, 0 only there, 2 only here" in printed
    paired = json.loads((tmp_path / "physical" / "report.json").read_text())["figures"]["paired"]
    changed = ["published", "physical"]
    assert paired["changed"] == {"config.rules": changed, "config.setup.rules": changed}
    assert paired["trials"]["p_value"] == 0.5
    assert "this run alone" in (tmp_path / "physical" / "report.html").read_text()


def test_the_command_refuses_wrong_input(tmp_path, capsys):
    assert cli.main(["audit", "--trials", "0", "--out", str(tmp_path)]) == 2
    assert cli.main(["audit", "--situations", "nothing like it", "--out", str(tmp_path)]) == 2
    assert "no row matches 'nothing like it'" in capsys.readouterr().err


def test_the_files_of_the_physics_are_read_before_contexts_are_looked_for(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(planned, "audit_plan", lambda *args: pytest.fail("contexts are looked for"))
    assert cli.main(["audit", "--gains", "gone.yaml", "--out", str(tmp_path)]) == 2
    assert "gone.yaml: no such file" in capsys.readouterr().err
