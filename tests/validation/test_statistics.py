"""Statistics of runs: shares, errors, durations, survival, ranks, and two runs compared."""

import json
from pathlib import Path

import numpy as np
import pytest
from pandas import DataFrame
from synthetic import attempt, record

from craftsim import cli
from craftsim.checking.attempt import Verdict
from craftsim.errors import InputError
from craftsim.experiments.compare import (
    _ratios,
    compare_actions,
    compare_trials,
    compare_with_reality,
)
from craftsim.experiments.compare_report import gap_report
from craftsim.experiments.intervals import (
    Proportion,
    agreement_of,
    mean_maximum_rank_violation,
    wilson,
)
from craftsim.experiments.records import Finished
from craftsim.experiments.statistics import (
    as_predicted,
    attempts_frame,
    campaign_figures,
    duration_table,
    legality_matrix,
    plan_survival,
    policy_scores,
    precision,
    survival,
    trials_frame,
    write_durations,
)
from craftsim.validation.record_schemas import read_run


def test_wilson_intervals_are_those_of_closed_forms_and_of_published_tables():
    # Wilson's score interval of 0 and of all of n has the closed forms 0 .. z^2/(n+z^2) and n/(n+z^2) .. 1.
    z2 = 1.959963984540054**2
    assert wilson(0, 20) == pytest.approx((0.0, z2 / (20 + z2)), abs=1e-9)
    assert wilson(20, 20) == pytest.approx((20 / (20 + z2), 1.0), abs=1e-9)
    assert wilson(0, 0) == (0.0, 1.0)
    assert (Proportion.of(0, 0).rate, Proportion.of(3, 4).rate) == (None, 0.75)
    # Newcombe, Statistics in Medicine 17 (1998), table I, method 3, without continuity correction.
    for successes, trials, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (1, 29, 0.0061, 0.1718),
    ):
        assert wilson(successes, trials) == pytest.approx((low, high), abs=5e-5)


def test_the_matrix_counts_results_by_legality():
    attempts = (
        [attempt()] * 5 + [attempt(Verdict.UNSAFE)] * 2 + [attempt(Verdict.FAILED, legal=False)] * 3
    )
    attempts.append(attempt(Verdict.SIDE_EFFECT, legal=False))
    attempts.append(
        attempt(Verdict.FAILED, legal=False, performed=False)
    )  # was not tried on purpose
    matrix = legality_matrix(attempts_frame([record("a", *attempts)]))
    legal, forbidden = matrix["legal"], matrix["forbidden"]
    counts = [legal.trials, legal.as_predicted, legal.failed, legal.side_effect, legal.unsafe]
    assert counts == [7, 5, 0, 0, 2]
    assert (forbidden.trials, forbidden.as_predicted, forbidden.failed, forbidden.side_effect) == (
        4,
        0,
        3,
        1,
    )
    assert legal.success.rate == pytest.approx(5 / 7)


def _runs(table):
    """Return two runs whose pairs are as often (both, only the first, only the second, neither) good as asked."""
    outcomes = [(True, True), (True, False), (False, True), (False, False)]
    pairs = [pair for pair, n in zip(outcomes, table, strict=True) for _ in range(n)]
    return tuple(
        [record(str(i), attempt(), agrees=pair[side]) for i, pair in enumerate(pairs)]
        for side in (0, 1)
    )


def test_mcnemar_of_a_published_table():
    # Agresti, Categorical Data Analysis, table 10.1: approval at two surveys; z^2 = 17.36, so p is about 3e-5.
    first, second = _runs((794, 150, 86, 570))
    paired = compare_trials(first, second)
    assert (paired.both, paired.only_first, paired.only_second, paired.neither) == (
        794,
        150,
        86,
        570,
    )
    assert (paired.first.successes, paired.second.successes) == (944, 880)
    assert paired.p_value == pytest.approx(3.1e-5, rel=0.3)


def test_pairs_are_matched_by_key_and_what_tried_nothing_is_left_out():
    def tried(key, **changes):
        return record(key, attempt(), **changes)

    first = [
        tried("a"),
        tried("b", agrees=False),
        tried("c"),
        tried("only here"),
        record("nothing"),
    ]
    second = [
        tried("c"),
        tried("a", agrees=False),
        tried("b", error="killed", agrees=False),
        record("nothing"),
    ]
    paired = compare_trials(first, second)
    assert (paired.pairs, paired.unpaired, paired.both, paired.only_first) == (2, 2, 1, 1)
    nothing = compare_trials(first[:1], second[2:3])
    assert (nothing.pairs, nothing.p_value, nothing.first.rate) == (0, 1.0, None)


def _frame(attempts):
    return attempts_frame([record("a", *attempts)])


def _table(attempts):
    return duration_table(as_predicted(_frame(attempts)))


def test_errors_are_of_what_did_as_predicted_and_forces_of_all():
    attempts = [attempt(car_error_m=0.001 * i, peak_force_n=10.0 * i) for i in range(1, 5)]
    attempts.append(attempt(Verdict.UNSAFE, car_error_m=0.5, peak_force_n=900.0))
    attempts.append(attempt(Verdict.FAILED, car_error_m=None, peak_force_n=None))
    found = precision(_frame(attempts))
    assert (
        found["car_error_mm"].n,
        found["car_error_mm"].median,
        found["car_error_mm"].max,
    ) == pytest.approx((4, 2.5, 4.0))
    assert found["car_error_mm"].p95 == pytest.approx(3.85)
    assert (found["peak_force_n"].n, found["peak_force_n"].max) == (5, 900.0)
    assert found["placed_error_mm"] is None


def test_duration_errors_are_against_the_median_of_the_kind():
    quick = [attempt(duration_s=s) for s in (1.0, 1.2, 1.1)]
    slow = [attempt(verb="FOLD", duration_s=s) for s in (10.0, 11.0, 12.0)]
    found = precision(_frame([*quick, *slow]))["duration_error_s"]
    assert (found.n, found.max) == pytest.approx((6, 1.0))
    assert found.median == pytest.approx(0.1)


def test_figures_of_nothing_are_none_and_no_zero():
    found = campaign_figures(
        [record("a", attempt(Verdict.FAILED)), record("b", error="killed")], seed=0
    )
    errors = dict(found.precision)
    assert errors.pop("peak_force_n") is not None
    assert set(errors.values()) == {None}
    assert found.durations == []
    assert found.by_group["plan"]["actions"].rate == 0.0
    nothing = campaign_figures([], seed=0)
    assert (nothing.all["actions"].rate, nothing.matrix["legal"].success.rate) == (None, None)


def test_a_table_of_durations_is_written(tmp_path):
    attempts = [attempt(duration_s=s, level=2, load="block", slope=True) for s in (1.0, 2.0, 6.0)]
    table = _table(
        [*attempts, attempt(verb="LIFT", duration_s=0.7), attempt(Verdict.FAILED, duration_s=99)]
    )
    path = write_durations(tmp_path / "new", table)
    assert path.read_text().splitlines()[1] == "LIFT,none,1,False,1,0.7,0.7,0.7,0.7,0.7", (
        "no idle digits"
    )
    assert len(path.read_text().splitlines()) == 1 + len(table) == 3
    row = table[1]
    assert list(row.values())[:4] == ["MOVE", "block", 2, True]
    assert (row["n"], row["mean_s"], row["median_s"], row["max_s"]) == (3, 3.0, 2.0, 6.0)


def _survival(ended, censored):
    return survival(
        np.array([*ended, *censored], int),
        np.array([True] * len(ended) + [False] * len(censored), bool),
    )


def test_kaplan_meier_of_published_data():
    # Remission in weeks under 6-MP: Freireich et al., Blood 21 (1963), as in Kaplan-Meier tables of many textbooks.
    ended = [6, 6, 6, 7, 10, 13, 16, 22, 23]
    censored = [6, 9, 10, 11, 17, 19, 20, 25, 32, 32, 34, 35]
    curve = _survival(ended, censored)
    share = dict(zip(curve["actions"], curve["share"], strict=True))
    published = {6: 0.857, 7: 0.807, 10: 0.753, 13: 0.690, 16: 0.627, 22: 0.538, 23: 0.448}
    assert {n: share[n] for n in published} == pytest.approx(published, abs=5e-4)
    # The log-log band at 23 weeks, as by R's survfit(..., conf.type = "log-log").
    at = curve["actions"].index(23)
    assert (curve["low"][at], curve["high"][at]) == pytest.approx((0.188, 0.680), abs=5e-4)
    assert (curve["runs"], curve["ended"]) == (21, 9)
    whole, none_left = _survival([], [5, 7]), _survival([1, 2], [])
    assert (whole["actions"], whole["share"], whole["low"]) == ([5, 7], [1.0, 1.0], [None, None])
    assert (none_left["share"], none_left["low"][-1], _survival([], [])["runs"]) == (
        [0.5, 0.0],
        None,
        0,
    )


@pytest.mark.parametrize(
    ("attempts", "without_resync", "with_resync"),
    [
        (("good", "failed", "good"), (2, 1), (3, 0)),
        (("failed", "forbidden"), (1, 1), (2, 1)),
        (("unsafe", "good"), (1, 1), (1, 1)),
        (("unreadable",), (1, 1), (1, 1)),
        (("good",), (1, 0), (1, 0)),
        ((), (0, 0), (0, 0)),
    ],
)
def test_a_run_without_resync_ends_with_its_first_disagreement_and_with_it_when_it_cannot_go_on(
    attempts, without_resync, with_resync
):
    known = {
        "good": attempt(),
        "failed": attempt(Verdict.FAILED),
        "unsafe": attempt(Verdict.UNSAFE),
    }
    known |= {"forbidden": attempt(legal=False)}
    known |= {"unreadable": attempt(Verdict.FAILED, finding="unreadable")}
    records = [record("b", error="killed"), record("a", *map(known.get, attempts))]
    found = plan_survival(trials_frame(records), attempts_frame(records))
    for name, (actions, ended) in {
        "without_resync": without_resync,
        "with_resync": with_resync,
    }.items():
        curve = found[name]
        assert (curve["runs"], curve["actions"], curve["ended"]) == (1, [actions], ended)


def test_mmrv_by_hand():
    # Physics orders policies 0 and 1 the other way round, 0.2 apart; policy 2 is in its place.
    assert mean_maximum_rank_violation([0.5, 0.6, 0.9], [0.4, 0.2, 0.8]) == pytest.approx(
        (0.2 + 0.2 + 0.0) / 3
    )
    assert mean_maximum_rank_violation([0.1, 0.5, 0.9], [0.0, 0.1, 0.2]) == 0.0
    # All reversed: each policy's furthest is 1, 0.5 and 1 away.
    assert mean_maximum_rank_violation([1.0, 0.5, 0.0], [0.0, 0.5, 1.0]) == pytest.approx(
        (1 + 0.5 + 1) / 3
    )
    # Of two that the grid world cannot tell apart, the definition counts the one that does worse in physics.
    assert mean_maximum_rank_violation([0.5, 0.5], [0.3, 0.6]) == pytest.approx(0.3 / 2)


def test_correlations_by_hand_and_their_intervals():
    found = agreement_of([0, 0.5, 0.6, 1], [0.1, 0.2, 0.9, 0.8], seed=0)
    assert found.spearman.value == pytest.approx(0.8)  # 1 - 6 * 2 / (4 * 15)
    assert found.pearson.value == pytest.approx(0.39 / (0.5075 * 0.5) ** 0.5)
    assert (found.pearson.low, found.pearson.high) == pytest.approx(
        (-1, 1)
    )  # four policies prove little

    many = [x / 12 for x in range(13)], [(x + (x * 7) % 5) / 16 for x in range(13)]
    found = agreement_of(*many, seed=0)
    assert 0.5 < found.pearson.low < found.pearson.value < found.pearson.high < 1
    assert agreement_of(*many, seed=0) == found
    assert agreement_of(*many, seed=1).pearson != found.pearson


def test_scores_are_shares_of_episodes_by_policy():
    def episode(policy, grid, physics, **changes):
        extra = {"grid_success": grid, "physics_success": physics}
        return record(policy, group=policy, extra=extra, **changes)

    records = [episode("b", True, False), episode("b", True, True), episode("a", False, False)]
    records += [record("c", group="c"), episode("a", True, True, error="timeout")]
    assert policy_scores(trials_frame(records)) == [
        {"policy": "a", "grid": 0.0, "physics": 0.0, "episodes": 1},
        {"policy": "b", "grid": 1.0, "physics": 0.5, "episodes": 2},
    ]


def test_actions_are_paired_in_order_for_as_long_as_both_runs_try_the_same():
    first = [record("a", attempt(tick=0), attempt(tick=1), attempt(tick=2)), record("b", attempt())]
    second = [
        record("a", attempt(tick=0), attempt(tick=3), attempt(tick=2)),
        record("c", attempt()),
    ]
    assert compare_actions(first, second).actions == 1
    nothing = compare_actions(first, [])
    assert (nothing.actions, nothing.share, nothing.duration_ratio) == (0, 1.0, None)


def test_what_differs_is_told_by_kind_with_an_example():
    first = [record(key, attempt(slope=True)) for key in "abc"] + [
        record("d", attempt(Verdict.FAILED))
    ]
    second = [record(key, attempt(Verdict.FAILED, slope=True)) for key in "ab"]
    second += [record("c", attempt(slope=True)), record("d", attempt(Verdict.UNSAFE))]
    found = compare_actions(first, second)
    assert (found.actions, found.as_predicted_alike, found.share) == (4, 2, 0.5)
    (one,) = found.differences
    assert (one["kind"], one["actions"], one["example"]) == (
        "MOVE on a slope: as predicted there, failed here",
        2,
        "a",
    )
    assert "50.00% went as predicted" in str(found)
    assert "2 MOVE on a slope" in str(found)


def test_what_the_rules_allow_is_counted_by_itself_and_ratios_are_medians_over_what_is_good_in_both():
    def run(good, *seconds):
        results = [Verdict.AS_PREDICTED] * good + [Verdict.FAILED] * (4 - good)
        pairs = enumerate(zip(results, seconds, strict=True))
        return [
            record("a", *(attempt(r, tick=n, legal=n < 3, duration_s=s) for n, (r, s) in pairs))
        ]

    found = compare_actions(run(4, 1.0, 2.0, 4.0, 1.0), run(2, 1.1, 2.4, 40.0, 1.0))
    assert (found.actions, found.as_predicted_alike) == (4, 2)
    assert (found.legal.successes, found.legal.trials) == (2, 3)
    assert found.duration_ratio == pytest.approx(1.15)
    assert found.error_ratio == pytest.approx(1.0)


def _plans(tmp_path, share, seconds=1.0):
    """Return a run of three plans, ten trials each, of which some succeed, by plan."""
    results = {True: Verdict.AS_PREDICTED, False: Verdict.FAILED}
    made = [
        record(f"{plan}#{n}", attempt(results[n < good], duration_s=seconds), group=plan)
        for plan, good in share.items()
        for n in range(10)
    ]
    return Finished(tmp_path, {"config": {}, "versions": {}}, made)


def test_ranks_durations_and_outcomes_are_those_of_reality_by_the_simulation(tmp_path):
    sim, real = (
        _plans(tmp_path, {"a": 9, "b": 7, "c": 2}),
        _plans(tmp_path, {"a": 3, "b": 7, "c": 1}, 1.5),
    )
    gap = compare_with_reality(sim, real)
    # Plans a and b change places: the distance in reality, 0.4, counts for both of them.
    assert gap.ranks.mmrv == pytest.approx(0.8 / 3)
    assert [(plan["sim"], plan["real"]) for plan in gap.plans] == [
        (0.9, 0.3),
        (0.7, 0.7),
        (0.2, 0.1),
    ]
    ratio = gap.by_verb["MOVE"]["duration_ratio"]
    assert (ratio.value, ratio.low, ratio.high) == (1.5, 1.5, 1.5)
    assert gap.by_verb["MOVE"]["agreement"].successes == 30 - 6 - 1
    assert gap.by_verb["MOVE"]["sim"].successes == 18
    assert gap.trials.only_first == 7


def _timed(tmp_path, trials, longer=0.0, actions=1):
    """Return a run of trials that take each another time."""
    records = []
    for trial in range(trials):
        seconds = 1 + 0.01 * trial + longer
        attempts = (attempt(tick=tick, duration_s=seconds) for tick in range(actions))
        records.append(record(f"a#{trial}", *attempts))
    return Finished(tmp_path, {"config": {}, "versions": {}}, records)


def test_two_runs_differ_where_only_durations_do(tmp_path):
    first, slower = _timed(tmp_path, 10), _timed(tmp_path, 10, longer=0.02)
    gap = compare_with_reality(first, slower)
    assert gap.trials.p_value == 1
    assert gap.by_verb["MOVE"]["duration_p"] == pytest.approx(2 / 2**10)
    assert gap.other_durations == ["MOVE"]
    report = gap_report(gap, Path("first"), Path("second"), 0)
    assert (report.exit_code, report.headline.badge) == (1, "Differs")
    assert report.headline.sentence.endswith("Other durations: MOVE.")
    assert compare_with_reality(first, first).agrees


def test_a_trial_counts_once_however_many_of_its_actions_take_longer(tmp_path):
    runs = (_timed(tmp_path, 2, longer, actions=50) for longer in (0.0, 0.02))
    gap = compare_with_reality(*runs)
    assert gap.by_verb["MOVE"]["duration_p"] == 0.5
    assert gap.agrees


def test_runs_without_a_common_trial_are_refused(tmp_path):
    with pytest.raises(InputError, match="no trial in common"):
        compare_with_reality(*(_plans(tmp_path, {plan: 1}) for plan in "ab"))
    with pytest.raises(InputError, match="holds no run"):
        read_run(tmp_path)


def test_a_hidden_delay_shows_in_the_outcomes(tmp_path, capsys):
    """The same plan on two sets of machines; what differs is told, and that there are too few plans to rank."""
    plan = tmp_path / "fetch.plan"
    plan.write_text(
        "0 0 MOVE_RIGHT\n0 1 MOVE_RIGHT\n1 0 LIFT\n1 1 LIFT\n2 0 MOVE_RIGHT\n2 1 MOVE_RIGHT\n"
    )
    late = tmp_path / "late.yaml"
    late.write_text("{min_delay_s: 0.1, max_delay_s: 0.1}")
    words = [
        "validate",
        "strip",
        "--plan",
        str(plan),
        "--drive",
        "wheels",
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
    said = capsys.readouterr().out
    assert "6 only in the first run, 0 only in the second" in said
    assert "at least three plans" in said
    assert (
        cli.main(["compare", str(tmp_path), str(tmp_path / "real"), "--out", str(tmp_path / "gap")])
        == 2
    )


def test_a_ratio_of_what_only_the_first_run_has_is_left_out():
    """Contacts are not looked at in every run: a nan among the ratios made their median nan."""
    pairs = DataFrame(
        {"force_a": [1.0, 2.0, 4.0, 0.0, np.nan], "force_b": [2.0, 2.0, np.nan, 1.0, 1.0]}
    )
    assert _ratios(pairs, "force") == [2.0, 1.0]
