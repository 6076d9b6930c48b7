"""Objectives: ratios count, failures cost more than speed brings, and a front holds what nothing dominates."""

import math

import numpy as np
import pytest

from craftsim.errors import InputError
from craftsim.tuning.goal import (
    DEFAULT_WEIGHTS,
    LEAST_SHARE,
    OBJECTIVES,
    TuningGoal,
    TuningScore,
    knee,
    spread_out,
    undominated,
    weightings,
)


def _score(*trials):
    """Return the score of trials, each a duration, or with the shares of own and all errors, and whether it agrees."""
    names = "duration_s", "error_share", "used_share", "agrees"
    full = [(one, 0.2, 0.2, True) if isinstance(one, float) else one for one in trials]
    return TuningScore.of(
        [
            {**dict(zip(names, one, strict=False)), "energy_j": 2.0, "peak_force_n": 100.0}
            for one in full
        ]
    )


def test_ratios_of_durations_and_of_weights_count_and_the_worst_trial_is_the_margin():
    short, long = _score(0.5, 8.0), _score(1.0, 16.0)
    assert long.values["time"] / short.values["time"] == pytest.approx(2)
    assert long.log_cost({"time": 1.0}) - short.log_cost({"time": 1.0}) == pytest.approx(
        math.log(2)
    )
    double = {name: 2 * weight for name, weight in DEFAULT_WEIGHTS.items()}
    assert short.log_cost(double) == pytest.approx(short.log_cost(DEFAULT_WEIGHTS))
    score = _score(*((1.0, 1e-6, used, True) for used in (0.1, 0.7, 0.2)))
    assert score.margin_left == pytest.approx(0.3)


def test_an_error_below_a_twentieth_of_its_limit_wins_nothing():
    assert LEAST_SHARE == 1 / 20
    small = _score(*((1.0, share, share, True) for share in (1e-6, 0.04, 0.02)))
    assert small.values["error"] == small.values["margin"] == 0.05
    larger = _score((1.0, 0.06, 0.07, True), (1.0, 0.08, 0.06, True))
    assert larger.values["error"] == pytest.approx(0.07)
    assert larger.values["margin"] == pytest.approx(0.07)


def test_one_failure_in_a_hundred_costs_more_than_a_fifth_of_the_time():
    quick = _score(*((0.8, 0.2, 0.2, n > 0) for n in range(100)))
    assert quick.log_cost({"time": 1.0}) > _score(*[1.0] * 100).log_cost({"time": 1.0})


def test_a_front_its_knee_and_its_spread():
    costs = np.array([[1, 3], [2, 2], [3, 1], [3, 3], [2, 2], [1, 4]], float)
    assert undominated(costs) == [0, 1, 2]
    elbow = np.array([[0.0, 1.0], [0.1, 0.12], [1.0, 0.0], [0.5, 0.1]])
    assert knee(elbow) == knee(elbow * [1000, 1] + [5, 7]) == 1
    line = np.column_stack([np.linspace(0, 1, 21), np.linspace(1, 0, 21)])
    assert spread_out(line, 3) == [0, 20, 10]
    assert sorted(spread_out(line[:4], 9)) == [0, 1, 2, 3]


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_weightings_sum_to_one_and_leave_no_objective_out(n):
    found = [[*weights.values()] for weights in weightings(tuple(OBJECTIVES)[:n])]
    assert all(sum(weights) == pytest.approx(1) and min(weights) > 0.01 for weights in found)
    assert max(found[0]) == min(map(max, found))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"words": ["tme=1"]}, "unknown objective 'tme'; did you mean 'time'?"),
        ({"words": ["time=fast"]}, "the weight of time is 'fast'; allowed: 0.001 to 1000"),
        ({"words": ["time=0"]}, "the weight of time is '0'"),
        ({"words": ["time=nan"]}, "the weight of time is 'nan'"),
        ({"words": ["time="]}, "the weight of time is ''"),
        (
            {"objectives": ["time"]},
            "a front has at least two objectives; for one give --weights time=1",
        ),
        ({"objectives": ["time", "time"]}, "a front has at least two"),
        ({"words": ["time=1"], "objectives": ["time", "margin"]}, "exclude each other"),
        ({"choice": "time"}, "--choose is for a front"),
        (
            {"objectives": ["time", "margin"], "choice": "force"},
            "allowed on this front: knee, time, margin",
        ),
    ],
)
def test_a_goal_that_makes_no_sense_is_refused(options, message):
    with pytest.raises(InputError) as caught:
        TuningGoal.of(**options)
    assert message in str(caught.value)


def test_a_goal_says_what_it_is():
    assert str(TuningGoal.of()) == "time=1, error=0.2, margin=0.2"
    assert str(TuningGoal.of(["time", "force=0.5"])) == "time=1, force=0.5"
    assert str(TuningGoal.of(objectives=["time", "margin"])) == "knee of the front of time, margin"
