"""Objectives: ratios count, failures cost more than speed brings, and a front holds what nothing dominates."""

import math

import numpy as np
import pytest

from craftsim.errors import InputError
from craftsim.tuning.goal import (
    DEFAULT_WEIGHTS,
    LEAST_SHARE,
    OBJECTIVES,
    Goal,
    Score,
    knee,
    spread,
    undominated,
    weightings,
)


def _trial(duration=1.0, share=0.2, agrees=True, used=None):
    return {
        "agrees": agrees,
        "duration_s": duration,
        "error_share": share,
        "used_share": share if used is None else used,
        "energy_j": 2.0,
        "peak_force_n": 100.0,
    }


def test_doubling_each_duration_doubles_the_time_whatever_the_actions_take():
    short = Score.of([_trial(0.5), _trial(8.0)])
    long = Score.of([_trial(1.0), _trial(16.0)])
    assert long.values["time"] / short.values["time"] == pytest.approx(2)
    assert long.log_cost({"time": 1.0}) - short.log_cost({"time": 1.0}) == pytest.approx(math.log(2))


def test_the_worst_trial_alone_decides_the_margin():
    score = Score.of([_trial(used=0.1), _trial(used=0.7), _trial(used=0.2)])
    assert score.margin_left == pytest.approx(0.3)


def test_an_error_far_within_its_limit_counts_as_the_least_share():
    assert Score.of([_trial(share=1e-6)]).values["error"] == LEAST_SHARE


def test_only_ratios_of_weights_count():
    score = Score.of([_trial(0.7, 0.3), _trial(1.3, 0.1)])
    double = {name: 2 * weight for name, weight in DEFAULT_WEIGHTS.items()}
    assert score.log_cost(double) == pytest.approx(score.log_cost(DEFAULT_WEIGHTS))


def test_one_failure_in_a_hundred_costs_more_than_a_fifth_of_the_time():
    quick = Score.of([_trial(0.8, agrees=n > 0) for n in range(100)])
    slow = Score.of([_trial(1.0) for _ in range(100)])
    assert quick.log_cost({"time": 1.0}) > slow.log_cost({"time": 1.0})


def test_a_front_holds_each_row_that_no_other_dominates_once():
    costs = np.array([[1, 3], [2, 2], [3, 1], [3, 3], [2, 2], [1, 4]], float)
    assert undominated(costs) == [0, 1, 2]


def test_the_knee_is_the_corner_of_an_elbow():
    elbow = np.array([[0.0, 1.0], [0.1, 0.12], [1.0, 0.0], [0.5, 0.1]])
    assert knee(elbow) == 1
    assert knee(elbow * [1000, 1] + [5, 7]) == 1


def test_spread_takes_the_ends_of_a_front_first():
    line = np.column_stack([np.linspace(0, 1, 21), np.linspace(1, 0, 21)])
    assert spread(line, 3) == [0, 20, 10]
    assert sorted(spread(line[:4], 9)) == [0, 1, 2, 3]


def test_weightings_sum_to_one_and_leave_no_objective_out():
    for n in [2, 3, 4, 5]:
        found = weightings(tuple(OBJECTIVES)[:n])
        for weights in found:
            assert sum(weights.values()) == pytest.approx(1)
            assert min(weights.values()) > 0.01
        assert max(found[0].values()) == min(max(weights.values()) for weights in found)


def test_a_goal_that_makes_no_sense_is_refused():
    for options, message in [
        ({"words": ["tme=1"]}, "unknown objective 'tme'; did you mean 'time'?"),
        ({"words": ["time=fast"]}, "the weight of time is 'fast'; allowed: 0.001 to 1000"),
        ({"words": ["time=0"]}, "the weight of time is '0'"),
        ({"words": ["time=nan"]}, "the weight of time is 'nan'"),
        ({"words": ["time="]}, "the weight of time is ''"),
        ({"objectives": ["time"]}, "a front has at least two objectives; for one give --weights time=1"),
        ({"objectives": ["time", "time"]}, "a front has at least two"),
        ({"words": ["time=1"], "objectives": ["time", "margin"]}, "exclude each other"),
        ({"choice": "time"}, "--choose is for a front"),
        ({"objectives": ["time", "margin"], "choice": "force"}, "allowed on this front: knee, time, margin"),
    ]:
        with pytest.raises(InputError) as caught:
            Goal.of(**options)
        assert message in str(caught.value)


def test_a_goal_says_what_it_is():
    assert str(Goal.of()) == "time=1, error=0.2, margin=0.2"
    assert str(Goal.of(["time", "force=0.5"])) == "time=1, force=0.5"
    assert str(Goal.of(objectives=["time", "margin"])) == "knee of the front of time, margin"
