"""How long plans survive, and whether two worlds rank policies alike."""

import numpy as np
import pytest
from synthetic import attempt, episodes, record

from craftsim.checking.attempt import Verdict
from craftsim.experiments.intervals import mean_maximum_rank_violation
from craftsim.experiments.statistics import (
    PolicyScore,
    attempts_frame,
    plan_survival,
    policy_scores,
    rank_agreement,
    survival,
    trials_frame,
)


def _survival(ended, censored):
    return survival(
        np.array([*ended, *censored], int), np.array([True] * len(ended) + [False] * len(censored), bool)
    )


def test_kaplan_meier_of_published_data():
    # Remission in weeks under 6-MP: Freireich et al., Blood 21 (1963), as in Kaplan-Meier tables of many textbooks.
    ended = [6, 6, 6, 7, 10, 13, 16, 22, 23]
    censored = [6, 9, 10, 11, 17, 19, 20, 25, 32, 32, 34, 35]
    curve = _survival(ended, censored)
    share = dict(zip(curve.actions, curve.share, strict=True))
    published = {6: 0.857, 7: 0.807, 10: 0.753, 13: 0.690, 16: 0.627, 22: 0.538, 23: 0.448}
    assert {n: share[n] for n in published} == pytest.approx(published, abs=5e-4)
    # The log-log band at 23 weeks, as by R's survfit(..., conf.type = "log-log").
    at = curve.actions.index(23)
    assert (curve.low[at], curve.high[at]) == pytest.approx((0.188, 0.680), abs=5e-4)
    assert (curve.runs, curve.ended) == (21, 9)


def test_where_nothing_or_everything_ended_there_is_no_band():
    whole = _survival([], [5, 7])
    assert (whole.actions, whole.share, whole.low) == ([5, 7], [1.0, 1.0], [None, None])
    none_left = _survival([1, 2], [])
    assert none_left.share == [0.5, 0.0]
    assert none_left.low[-1] is None
    assert _survival([], []).runs == 0


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
        "forbidden": attempt(legal=False),
        "unsafe": attempt(Verdict.UNSAFE),
        "unreadable": attempt(Verdict.FAILED, finding="unreadable"),
    }
    records = [record("b", error="killed"), record("a", *map(known.get, attempts))]
    found = plan_survival(trials_frame(records), attempts_frame(records))
    for curve, (actions, ended) in ((found.without_resync, without_resync), (found.with_resync, with_resync)):
        assert (curve.runs, curve.actions, curve.ended) == (1, [actions], ended)


def test_mmrv_by_hand():
    # Physics orders policies 0 and 1 the other way round, 0.2 apart; policy 2 is in its place.
    assert mean_maximum_rank_violation([0.5, 0.6, 0.9], [0.4, 0.2, 0.8]) == pytest.approx(
        (0.2 + 0.2 + 0.0) / 3
    )
    assert mean_maximum_rank_violation([0.1, 0.5, 0.9], [0.0, 0.1, 0.2]) == 0.0
    # All reversed: each policy's furthest is 1, 0.5 and 1 away.
    assert mean_maximum_rank_violation([1.0, 0.5, 0.0], [0.0, 0.5, 1.0]) == pytest.approx((1 + 0.5 + 1) / 3)
    # Of two that the grid world cannot tell apart, the definition counts the one that does worse in physics.
    assert mean_maximum_rank_violation([0.5, 0.5], [0.3, 0.6]) == pytest.approx(0.3 / 2)


def test_correlations_by_hand_and_their_intervals():
    scores = [
        PolicyScore(str(i), x, y, 10) for i, (x, y) in enumerate([(0, 0.1), (0.5, 0.2), (0.6, 0.9), (1, 0.8)])
    ]
    found = rank_agreement(scores, seed=0)
    assert found.spearman.value == pytest.approx(0.8)  # 1 - 6 * 2 / (4 * 15)
    assert found.pearson.value == pytest.approx(0.39 / (0.5075 * 0.5) ** 0.5)
    assert (found.pearson.low, found.pearson.high) == pytest.approx((-1, 1))  # four policies prove little

    many = [PolicyScore(str(x), x / 12, (x + (x * 7) % 5) / 16, 10) for x in range(13)]
    found = rank_agreement(many, seed=0)
    assert 0.5 < found.pearson.low < found.pearson.value < found.pearson.high < 1
    assert rank_agreement(many, seed=0) == found
    assert rank_agreement(many, seed=1).pearson != found.pearson


def test_correlations_of_policies_that_are_all_the_same_are_not_defined():
    found = rank_agreement([PolicyScore(str(i), 0.5, 0.1 * i, 5) for i in range(4)], seed=0)
    assert (found.pearson.value, found.pearson.low) == (None, None)
    assert rank_agreement([PolicyScore("a", 1, 1, 5)] * 2, seed=0) is None


def test_scores_are_shares_of_episodes_by_policy():
    def episode(policy, grid, physics, **changes):
        return record(
            policy, group=policy, extra={"grid_success": grid, "physics_success": physics}, **changes
        )

    records = [
        episode("b", True, False),
        episode("b", True, True),
        episode("a", False, False),
        record("c", group="c"),
    ]
    records.append(episode("a", True, True, error="timeout"))
    assert policy_scores(trials_frame(records)) == [
        PolicyScore("a", 0.0, 0.0, 1),
        PolicyScore("b", 1.0, 0.5, 2),
    ]
    assert [score.policy for score in policy_scores(trials_frame(episodes()))] == [
        "ippo",
        "planner",
        "qmix",
        "random",
    ]
