"""How alike the actions of two runs are."""

import pytest
from synthetic import attempt, record

from craftsim.checking.attempt import Verdict
from craftsim.experiments.compare import alike


def test_actions_are_paired_in_order_for_as_long_as_both_runs_try_the_same():
    first = [record("a", attempt(tick=0), attempt(tick=1), attempt(tick=2)), record("b", attempt())]
    second = [record("a", attempt(tick=0), attempt(tick=3), attempt(tick=2)), record("c", attempt())]
    assert alike(first, second).actions == 1


def test_what_differs_is_told_by_kind_with_an_example():
    first = [record(key, attempt(slope=True)) for key in "abc"] + [record("d", attempt(Verdict.FAILED))]
    second = [record(key, attempt(Verdict.FAILED, slope=True)) for key in "ab"]
    second += [record("c", attempt(slope=True)), record("d", attempt(Verdict.UNSAFE))]
    found = alike(first, second)
    assert (found.actions, found.as_predicted_alike, found.share) == (4, 2, 0.5)
    (one,) = found.differences
    assert (one.kind, one.actions, one.example) == (
        "MOVE on a slope: as predicted there, failed here",
        2,
        "a",
    )
    assert "50.00% went as predicted" in str(found)
    assert "2 MOVE on a slope" in str(found)


def test_what_the_rules_allow_is_counted_by_itself():
    first = [record("a", attempt(), attempt(legal=False, tick=1), attempt(tick=2))]
    second = [
        record("a", attempt(), attempt(Verdict.FAILED, legal=False, tick=1), attempt(Verdict.FAILED, tick=2))
    ]
    found = alike(first, second)
    assert (found.actions, found.as_predicted_alike) == (3, 1)
    assert (found.legal.successes, found.legal.trials) == (1, 2)
    assert "and 1 of the 2 that the rules allow" in str(found)


def test_ratios_are_medians_over_actions_as_predicted_in_both():
    first = [
        record("a", attempt(duration_s=1.0), attempt(tick=1, duration_s=2.0), attempt(tick=2, duration_s=4.0))
    ]
    second = [
        record(
            "a",
            attempt(duration_s=1.1),
            attempt(tick=1, duration_s=2.4),
            attempt(Verdict.FAILED, tick=2, duration_s=40.0),
        )
    ]
    found = alike(first, second)
    assert found.duration_ratio == pytest.approx(1.15)
    assert found.error_ratio == pytest.approx(1.0)


def test_nothing_in_common_is_alike_without_ratios():
    found = alike([record("a", attempt())], [])
    assert (found.actions, found.share, found.duration_ratio) == (0, 1.0, None)
