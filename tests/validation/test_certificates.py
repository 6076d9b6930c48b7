"""A certificate says yes, no or undecided, with the trials that it needed and what they are drawn from."""

import json

import numpy as np
import pytest

import craftsim
from craftsim import cli
from craftsim.errors import InputError
from craftsim.experiments.certificate import Certificate, CertificationRule, Decision


@pytest.mark.parametrize(
    ("successes", "trials", "decision"),
    [(343, 343, "yes"), (342, 342, "undecided"), (1, 3, "no"), (9, 10, "undecided")],
)
def test_decisions_at_99_percent(successes, trials, decision):
    certificate = Certificate.of("strip: planner", successes, trials, 0.99, 0.95)
    assert certificate.decision == decision
    assert certificate.repetitions["10"] == pytest.approx(certificate.at_least**10)
    assert (certificate.at_least >= 0.99) == (decision == "yes")


@pytest.mark.parametrize(("rate", "wrong"), [(0.9, Decision.NO), (0.75, Decision.YES)])
def test_runs_that_stop_by_themselves_are_rarely_wrong(rate, wrong):
    rng = np.random.default_rng(0)
    answers = []
    for _ in range(200):
        rule = CertificationRule(0.83, 0.95, lambda record: record)
        total = 0
        for size in rule.round_sizes():
            total += size
            if rule.is_decided("plan", rng.random(size) < rate) or total > 1000:
                break
        answers.append(rule.certificate_of("plan").decision)
    assert answers.count(wrong) <= 10
    assert answers.count(Decision.UNDECIDED) <= 20


def test_the_command_certifies_a_plan_and_refuses_one_that_fails(tmp_path, capsys):
    words = ["validate", "strip", "--video", "none", "--certify", "0.5", "--out"]
    assert cli.main([*words, str(tmp_path / "good")]) == 0
    printed = capsys.readouterr().out
    assert "The plan or policy succeeds in at least 50.0 % of runs" in printed
    report = json.loads((tmp_path / "good" / "report.json").read_text())
    (certificate,) = report["figures"]["certificates"]
    assert certificate["decision"] == "yes"
    assert certificate["trials"] == certificate["successes"] == 8
    assert report["config"]["certify"] == 0.5

    actions = tmp_path / "actions.txt"
    actions.write_text("0 LIFT\n")
    assert cli.main([*words, str(tmp_path / "bad"), "--actions", str(actions)]) == 1
    assert "Refused" in (tmp_path / "bad" / "report.html").read_text()


def test_bad_requests_are_refused(tmp_path, capsys):
    with pytest.raises(InputError, match="all runs are alike"):
        craftsim.validate("strip", randomize="none", certify=0.9)
    words = ["validate", "strip", "--out", str(tmp_path), "--certify"]
    assert cli.main([*words, "1"]) == 2
    assert "0.01 to 0.9999" in capsys.readouterr().err
    assert cli.main([*words, "0.9", "--backend", "grid"]) == 2


def test_undecided_after_all_trials():
    result = craftsim.validate("strip", certify=0.99, trials=2)
    (certificate,) = result.certificates
    assert certificate.decision == Decision.UNDECIDED
    assert not result.all_certified
    assert len(result.records) == 2
