"""Errors, durations, and all figures of a campaign together."""

import json
from dataclasses import asdict

import pytest
from synthetic import attempt, audit, episodes, record

from craftsim.checking.attempt import Verdict
from craftsim.errors import InputError
from craftsim.experiments.durations import DurationKey, duration_table, read_durations, write_durations
from craftsim.experiments.statistics import as_predicted, attempts_frame, campaign_figures, precision
from craftsim.reports.json_file import write_report
from craftsim.validation.audit import Judgement, audit_rows, judge, provisional_note, verdict_counts


def _frame(attempts):
    return attempts_frame([record("a", *attempts)])


def _table(attempts):
    return duration_table(as_predicted(_frame(attempts)))


def test_errors_are_of_what_did_as_predicted_and_forces_of_all():
    attempts = [attempt(car_error_m=0.001 * i, peak_force_n=10.0 * i) for i in range(1, 5)]
    attempts.append(attempt(Verdict.UNSAFE, car_error_m=0.5, peak_force_n=900.0))
    attempts.append(attempt(Verdict.FAILED, car_error_m=None, peak_force_n=None))
    found = precision(_frame(attempts))
    assert (found.car_error_mm.n, found.car_error_mm.median, found.car_error_mm.max) == pytest.approx(
        (4, 2.5, 4.0)
    )
    assert found.car_error_mm.p95 == pytest.approx(3.85)
    assert (found.peak_force_n.n, found.peak_force_n.max) == (5, 900.0)
    assert found.placed_error_mm is None


def test_duration_errors_are_against_the_median_of_the_kind():
    quick = [attempt(duration_s=s) for s in (1.0, 1.2, 1.1)]
    slow = [attempt(verb="FOLD", duration_s=s) for s in (10.0, 11.0, 12.0)]
    found = precision(_frame([*quick, *slow])).duration_error_s
    assert (found.n, found.max) == pytest.approx((6, 1.0))
    assert found.median == pytest.approx(0.1)


def test_the_file_of_durations_has_no_digits_that_say_nothing(tmp_path):
    seconds = (1.01, 1.02, 1.03, 1.0200000000000005)
    path = write_durations(tmp_path, _table([attempt(duration_s=s) for s in seconds]))
    assert path.read_text().splitlines()[1] == "MOVE,none,1,False,4,1.02,1.0115,1.02,1.0285,1.03"


def test_figures_of_nothing_are_none_and_no_zero():
    found = campaign_figures([record("a", attempt(Verdict.FAILED)), record("b", error="killed")], seed=0)
    errors = asdict(found.precision)
    assert errors.pop("peak_force_n") is not None
    assert set(errors.values()) == {None}
    assert found.durations == []
    assert found.by_group["plan"].actions.rate == 0.0
    nothing = campaign_figures([], seed=0)
    assert nothing.all.actions.rate is None
    assert nothing.matrix.legal.success.rate is None


def test_what_was_not_tried_is_not_counted_as_tried_on_purpose():
    told = attempt(Verdict.FAILED, legal=False, performed=False)
    tried = attempt(Verdict.FAILED, legal=False)
    matrix = campaign_figures([record("a", told, tried, attempt())], seed=0).matrix
    assert (matrix.legal.trials, matrix.forbidden.trials, matrix.forbidden.failed) == (1, 1, 1)


def test_a_table_of_durations_survives_its_file(tmp_path):
    attempts = [attempt(duration_s=s, level=2, load="block", slope=True) for s in (1.0, 2.0, 6.0)]
    table = _table([*attempts, attempt(verb="LIFT", duration_s=0.7), attempt(Verdict.FAILED, duration_s=99)])
    known = read_durations(write_durations(tmp_path / "new", table))
    row = known[DurationKey("MOVE", "block", 2, True)]
    assert (row.n, row.mean_s, row.median_s, row.max_s) == (3, 3.0, 2.0, 6.0)
    assert list(known.values()) == table
    assert len(known) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n", "line 1: the columns must be verb, load"),
        (
            "verb,load,level,slope,n,mean_s,p05_s,median_s,p95_s,max_s\nLIFT,none,one,True,1,1,1,1,1,1\n",
            "line 2",
        ),
        (
            "verb,load,level,slope,n,mean_s,p05_s,median_s,p95_s,max_s\nLIFT,none,1,yes,1,1,1,1,1,1\n",
            "slope is True",
        ),
        ("verb,load,level,slope,n,mean_s,p05_s,median_s,p95_s,max_s\nLIFT,none,1,True,1\n", "line 2"),
    ],
)
def test_a_bad_table_of_durations_is_refused_with_its_line(tmp_path, text, message):
    path = tmp_path / "durations.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_durations(path)


def test_a_missing_table_of_durations_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"durations\.csv: no such file"):
        read_durations(tmp_path / "durations.csv")


@pytest.mark.parametrize(
    ("legal", "has_prediction", "trials", "good", "verdict"),
    [
        (True, True, 20, 19, Judgement.SOUND),
        (True, True, 20, 18, Judgement.UNSOUND),
        (False, True, 20, 19, Judgement.CONSERVATIVE),
        (False, True, 20, 10, Judgement.RIGHTLY_FORBIDDEN),
        (False, False, 0, 0, Judgement.NO_PREDICTION),
        (True, True, 0, 0, Judgement.NOT_TRIED),
    ],
)
def test_verdicts_on_rules(legal, has_prediction, trials, good, verdict):
    assert judge(legal, has_prediction, trials, good) == verdict


def test_a_row_counts_the_worst_attempt_of_each_trial_and_tells_the_commonest_reason():
    touched = [attempt(Verdict.FAILED, reason=f"slope 0 touched block {i} ({20 + i} N)") for i in range(3)]
    records = [record(str(i), attempt(), bad, group="FOLD/level=1") for i, bad in enumerate(touched)]
    records += [
        record(
            "3", attempt(Verdict.FAILED), attempt(Verdict.UNSAFE, reason="car 0 tipped"), group="FOLD/level=1"
        ),
        record("4", attempt(), attempt(), group="FOLD/level=1"),
        record("5", group="FOLD/level=1", error="TimeoutError", agrees=False),
    ]
    records[1]["bundle"] = "bundles/1"
    (row,) = audit_rows(records)
    assert (row.action, row.context, row.legal) == ("FOLD", "level=1", True)
    assert (row.trials, row.as_predicted, row.failed, row.side_effect, row.unsafe, row.errors) == (
        5,
        1,
        3,
        0,
        1,
        1,
    )
    assert (row.verdict, row.bundles) == ("unsound", ("bundles/1",))
    assert row.reason == "slope 0 touched block 0 (20 N) (3 of 4)"
    assert row.provisional


def test_an_audit_has_rows_of_every_verdict_and_none_are_lost():
    records = audit()
    rows = audit_rows(records)
    counts = verdict_counts(rows)
    assert len(rows) == sum(counts.values()) == len({r["group"] for r in records})
    assert all(counts[verdict] for verdict in Judgement if verdict is not Judgement.NOT_TRIED)
    assert all(not row.has_prediction for row in rows if row.verdict == Judgement.NO_PREDICTION)


@pytest.mark.parametrize(
    ("trials", "note"), [(0, ""), (19, "1 row is judged by fewer than 20 trials: provisional."), (20, "")]
)
def test_a_verdict_of_few_trials_is_told_as_provisional(trials, note):
    rows = audit_rows(
        [record("nothing", group="LIFT/a"), *(record(str(i), attempt()) for i in range(trials))]
    )
    assert provisional_note(rows) == note


def test_figures_have_a_place_in_a_report_and_errors_count_apart(tmp_path):
    records = episodes()
    figures = campaign_figures(records, seed=0)
    report = write_report(tmp_path, {"all": figures}, command="validate").read_text(encoding="utf-8")
    read = json.loads(report)["figures"]["all"]
    failed = [r for r in records if r["error"]]
    assert read["trials"] == len(records)
    assert read["errors"] == {"TimeoutError: longer than 60 s": len(failed)}
    assert read["all"]["runs"]["trials"] == len(records) - len(failed)
    assert read["all"]["actions"]["successes"] == sum(row["n"] for row in read["durations"])
    assert set(read["by_group"]) == {"random", "planner", "ippo", "qmix"}
    assert read["rank_agreement"]["policies"] == 4


def test_figures_of_nothing_are_no_figures():
    figures = campaign_figures([], seed=0)
    assert (figures.trials, figures.all.runs.rate, figures.precision.car_error_mm) == (0, None, None)
