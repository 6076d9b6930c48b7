"""What tried nothing is no success: it is counted apart, in figures, headlines, tables and exit statuses."""

import json
from dataclasses import dataclass
from pathlib import Path

from discrete.drawn import draw
from synthetic import attempt, record

from craftsim import cli, validate
from craftsim.audit.audit import Audit, RuleVerdict, audit_rows
from craftsim.audit.audit_report import audit_report
from craftsim.audit.conformance import Checker
from craftsim.checking.attempt import Verdict
from craftsim.checking.setup import setup_of
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.kinds import Kind
from craftsim.experiments.compare import Comparison, RealityGap, compare_actions, compare_trials
from craftsim.experiments.compare_report import gap_report
from craftsim.experiments.intervals import Proportion
from craftsim.experiments.statistics import campaign_figures
from craftsim.reports.publishing import publish
from craftsim.tasks import free_play
from craftsim.validation.report import validation_report
from craftsim.validation.worlds import RandomWorlds

IN_THE_GEAR = draw((5, 3, 2), [(Kind.FSLOPE, (2, 1, 1), 2)], [(1, 1, 1, 0, Kind.BLOCK, 0, 0)])
"""A carried block where a folded slope has its gear."""
FALLEN = {"does_not_stand": "this world cannot be: block 0 and slope 0 overlap"}


def fallen(key, **changes):
    """Return the record of a trial in a world that cannot stand."""
    return record(
        key,
        agrees=False,
        extra={"ticks": 0, "forbidden": 0, "makespan_s": 0.0, **FALLEN},
        **changes,
    )


@dataclass(frozen=True)
class FallingWorlds(RandomWorlds):
    """Random worlds of which a share cannot stand: a block stands in a slope's gear."""

    share: float = 1.0

    def task(self, rng):
        """Return one that cannot stand, or else one that can."""
        if rng.random() < self.share:
            return free_play("fallen", (parse_blueprint(blueprint_text(IN_THE_GEAR), "fallen"),))
        return super().task(rng)


def run(share, trials, out):
    """Run random play in such worlds, and return the result and the exit status of its report."""
    worlds = FallingWorlds(2, None, 3, share=share)
    result = validate(worlds, trials=trials, randomize="none", drive="wheels", out=out)
    return result, publish(validation_report(result, "craftsim validate random"), out)


def test_worlds_that_cannot_stand_and_idle_runs_count_in_no_share():
    records = [
        record("a", attempt()),
        record("b"),
        fallen("c"),
        fallen("d"),
        record("e", error="late", agrees=False),
    ]
    figures = campaign_figures(records, 0)
    assert figures.all["runs"] == Proportion.of(1, 1)
    assert (figures.trials, figures.not_standing, figures.without_actions) == (5, 2, 1)
    assert figures.by_group["plan"]["runs"] == Proportion.of(1, 1)
    # Also as craftsim 0.3 wrote them.
    old = [{**one, "agrees": True} for one in (fallen("c"), fallen("d"))]
    assert campaign_figures(old, 0).all["runs"] == Proportion.of(0, 0)


def test_a_run_in_which_no_world_can_stand_is_no_success(tmp_path, capsys):
    result, status = run(1.0, 3, tmp_path)
    assert status == 1
    assert not result.agrees
    assert repr(result) == "Validation(0 of 0 runs agree, 0 of 0 actions as predicted)"
    said = " ".join(capsys.readouterr().out.split())
    assert "No action was judged. 3 more worlds cannot stand, and nothing was tried there." in said
    figures = json.loads((tmp_path / "report.json").read_text())["figures"]["validation"]
    assert figures["not_standing"] == 3
    assert figures["all"]["runs"]["trials"] == 0


def test_worlds_that_cannot_stand_are_told_beside_those_that_agree(tmp_path, capsys):
    result, status = run(0.5, 6, tmp_path)
    fallen = sum("does_not_stand" in record["extra"] for record in result.records)
    assert 0 < fallen < 6
    assert result.figures.all["runs"] == Proportion.of(6 - fallen, 6 - fallen)
    assert (result.n_agree, result.n_judged, status) == (6 - fallen, 6 - fallen, 0)
    assert result.figures.not_standing == fallen
    said = " ".join(capsys.readouterr().out.split())
    assert f"All {6 - fallen} run" in said
    assert "cannot stand, and nothing was tried there" in said
    assert f"as predicted, {fallen} without an" in said


def test_a_policy_that_asks_for_nothing_that_is_allowed_is_no_success():
    def ask_in_vain(observations):
        return {
            agent: int((~seen["action_mask"].astype(bool)).argmax())
            for agent, seen in observations.items()
        }

    result = validate("strip", policy=ask_in_vain, trials=1, randomize="none", drive="wheels")
    assert not list(result.attempts)
    assert not result.agrees
    assert result.figures.without_actions == 1


def test_a_row_of_an_audit_whose_worlds_cannot_stand_is_not_tried():
    (row,) = audit_rows(
        [fallen("s#0", group="LIFT/x", context="s"), fallen("s#1", group="LIFT/x", context="s")]
    )
    assert row.verdict == RuleVerdict.NOT_TRIED
    assert (row.trials, row.not_standing) == (0, 2)
    (none,) = audit_rows([record("LIFT/y", group="LIFT/y")])
    assert none.verdict == RuleVerdict.NO_PREDICTION


def test_a_comparison_without_pairs_is_not_one_without_a_difference():
    records = [fallen("a"), fallen("b")]
    paired, actions = compare_trials(records, records), compare_actions(records, records)
    assert paired.pairs == 0
    assert "No action is in both runs" in str(Comparison("x", {}, paired, actions, None))
    gap = RealityGap({}, paired, actions, None, {}, {}, (), None)
    assert not gap.agrees
    report = gap_report(gap, Path("first"), Path("second"), 0)
    assert (report.exit_code, report.headline.badge) == (1, "Nothing to compare")


def test_recordings_of_which_nothing_is_compared_do_not_agree(tmp_path, monkeypatch, capsys):
    recording = Path(__file__).parents[1] / "data" / "traces.jsonl.gz"
    monkeypatch.setattr(Checker, "check", lambda self, line, record: None)
    assert cli.main(["conformance", str(recording)]) == 1
    assert "nothing was compared" in capsys.readouterr().out


def test_an_audit_without_a_verdict_is_no_success():
    row = audit_rows([fallen("s#0", group="LIFT/x", context="s")])
    figures = campaign_figures([], 0)
    config = {"rules": "physical", "randomize": "none", "setup": setup_of("none")}
    report = audit_report(Audit((), tuple(row), (), figures, config, 0, {}, None), "craftsim audit")
    assert report.exit_code == 1
    assert report.headline.badge == "Not decided"


def test_an_audit_in_which_the_solver_gives_up_is_no_success():
    good = record("a#0", attempt(), group="LIFT/x")
    given_up = record("a#1", attempt(Verdict.NUMERICS), group="LIFT/x", agrees=False)
    row = audit_rows([good, given_up])
    assert (row[0].verdict, row[0].trials) == ("sound", 1)
    figures = campaign_figures([], 0)
    config = {"rules": "physical", "randomize": "none", "setup": setup_of("none")}
    report = audit_report(Audit((), tuple(row), (), figures, config, 0, {}, None), "craftsim audit")
    assert report.exit_code == 1
    assert report.headline.badge == "Not decided"
    assert "The solver gave up in 1 trial of these" in report.headline.sentence
