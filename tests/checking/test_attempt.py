"""An attempt is judged by limits set beforehand, and says in one line what went wrong physically."""

import json
from dataclasses import asdict, replace

import pytest

from craftsim.checking.attempt import Attempt, Result, attempt_of, result_of
from craftsim.checking.contact_log import Contact
from craftsim.checking.recipe import set_up
from craftsim.checking.safety import Hazard, impact_limit_n
from craftsim.checking.settings import Thresholds
from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.rules.table import ACTIONS
from craftsim.discrete.verdict import Finding, Verdict
from craftsim.skills.outcome import Outcome, Reason

LIMITS = Thresholds()


def _unfolding(blocked: bool):
    """Return a car below a folded slope whose foot goes to (1, 1); a block beyond it, if asked for."""
    grid = Grid.empty((4, 3, 2), 1)
    grid.cars[0, :4] = 2, 1, 1, 0
    grid.kind[2, 1, 1], grid.kind[1, 1, 1] = Kind.FSLOPE, Kind.GEAR
    grid.yaw[2, 1, 1] = grid.yaw[1, 1, 1] = 2
    if blocked:
        grid.kind[0, 1, 1] = Kind.BLOCK
    grid.derive_marks()
    return set_up(grid, rules="published")


@pytest.fixture(scope="module")
def good():
    return _unfolding(False).perform(3, 0, Action.UNFOLD)


@pytest.fixture(scope="module")
def shoved():
    return _unfolding(True).perform(0, 0, Action.UNFOLD)


def test_what_goes_as_predicted_needs_no_reason(good):
    attempt = attempt_of(good, LIMITS)
    assert (attempt.result, attempt.finding, attempt.reason) == ("as predicted", "agrees", "")
    assert (attempt.tick, attempt.car, attempt.action, attempt.verb) == (3, 0, "UNFOLD", "UNFOLD")
    assert (attempt.level, attempt.load, attempt.slope, attempt.legal) == (1, "none", False, True)
    assert attempt.skill == "succeeded"
    assert attempt.duration_s > 5
    assert good.own == ("car 0", "slope 0")


def test_a_bystander_that_is_shoved_is_a_side_effect_and_named(shoved):
    attempt = attempt_of(shoved, LIMITS)
    assert attempt.result == Result.SIDE_EFFECT
    assert attempt.bystander_displacement_m > 2 * LIMITS.others_m
    assert "block 0 touched slope 0" in attempt.reason
    assert "block 0 was moved by" in attempt.reason
    assert [(c.first, c.second) for c in shoved.touched] == [("block 0", "slope 0")]


def test_an_attempt_is_json(shoved):
    attempt = attempt_of(shoved, LIMITS)
    fields = json.loads(json.dumps(asdict(attempt), allow_nan=False))
    assert Attempt(**{**fields, "differences": tuple(fields["differences"])}) == attempt


def _spoilt(good, **changes):
    return result_of(replace(good, **changes), LIMITS)


@pytest.mark.parametrize(
    ("changes", "result"),
    [
        ({"outcome": Outcome(Reason.TIMEOUT, 1.0)}, Result.FAILED),
        ({"effect": False}, Result.FAILED),
        ({"car_error_m": 0.0011}, Result.FAILED),
        ({"car_heading_error_rad": -0.0031}, Result.FAILED),
        ({"car_height_error_m": -0.0021}, Result.FAILED),
        ({"placed_error_m": 0.0021}, Result.FAILED),
        ({"bystander_displacement_m": 0.0011}, Result.SIDE_EFFECT),
        ({"bystander_displacement_m": 0.0009}, Result.AS_PREDICTED),
        ({"bystander_displacement_m": 0.0011, "car_error_m": 0.0011}, Result.FAILED),
        ({"car_error_m": float("nan")}, Result.FAILED),
        ({"verdict": Verdict(Finding.SIDE_EFFECT, ("car 1: predicted a, read b",))}, Result.SIDE_EFFECT),
        ({"verdict": Verdict(Finding.UNREADABLE, ("block 3 leans by 0.30 rad",))}, Result.SIDE_EFFECT),
        ({"verdict": Verdict(Finding.UNREADABLE, ("slope 0 is half open: ...",))}, Result.FAILED),
        ({"verdict": Verdict(Finding.UNREADABLE, ("car 0 leans: ...",))}, Result.FAILED),
        ({"verdict": Verdict(Finding.UNSETTLED, ("something still moves",))}, Result.FAILED),
        ({"verdict": Verdict(Finding.DIVERGED, ("the simulation broke down",))}, Result.FAILED),
        ({"verdict": Verdict(Finding.UNSAFE, ("block 3 fell (0.8 m/s)",))}, Result.UNSAFE),
    ],
    ids=str,
)
def test_the_result_follows_from_effect_errors_and_verdict(good, changes, result):
    assert _spoilt(good, **changes) is result


def test_hazards_come_first_then_contacts_of_its_own_then_what_the_skill_says(good):
    contact = Contact("block 1", "block 2", 1.0, 90.0, False), Contact("car 0", "block 1", 1.0, 20.0, False)
    record = replace(
        good,
        hazards=(Hazard(("block 1",), "block 1 fell (0.8 m/s)"),),
        touched=contact,
        outcome=Outcome(Reason.BLOCKED, 1.0, "41 mm behind the path"),
        verdict=Verdict(Finding.UNSAFE, ("block 1 fell (0.8 m/s)",)),
    )
    assert attempt_of(record, LIMITS).reason == (
        "block 1 fell (0.8 m/s); car 0 touched block 1 (20 N); block 1 touched block 2 (90 N); "
        "blocked: 41 mm behind the path"
    )
    alone = replace(good, car_error_m=0.0034)
    assert attempt_of(alone, LIMITS).reason == "the car is 3.4 mm off (allowed 1.0)"


def test_what_the_rules_forbid_is_not_performed_and_says_so():
    checked = _unfolding(False)
    attempt = attempt_of(checked.perform(0, 0, Action.DROP), LIMITS)
    assert (attempt.result, attempt.skill, attempt.legal) == ("failed", "not performed", False)
    assert attempt.reason == "the rules forbid DROP to car 0 here"


def test_what_the_rules_forbid_is_performed_where_it_is_said_what_it_should_lead_to():
    checked = _unfolding(False)
    intended = checked.reading.grid.copy()
    intended.cars[0, 0] = 3
    record = checked.perform(0, 0, Action.MOVE_RIGHT, intended)
    assert record.legal
    before = checked.reading.grid
    assert not checked.rules.legal(before, 0, Action.DROP)
    stays = checked.perform(1, 0, Action.DROP, before.copy())
    assert (stays.legal, stays.outcome.succeeded, stays.verdict.agrees) == (False, True, True)
    assert attempt_of(stays, LIMITS).result == Result.AS_PREDICTED


def test_many_cars_at_once_get_a_record_each():
    grid = Grid.empty((4, 3, 2), 3)
    grid.cars[:, :4] = [[0, 0, 1, 0], [0, 2, 1, 0], [3, 1, 1, 0]]
    grid.derive_marks()
    checked = set_up(grid)
    checked.site.model.actuator_forcerange[checked.site.cars[1].wheel_actuators] = 0.0
    acts = [(0, Action.MOVE_RIGHT), (1, Action.MOVE_RIGHT), (2, Action.LIFT)]
    records = checked.perform_together(4, acts)
    attempts = [attempt_of(record, LIMITS) for record in records]
    assert [(a.tick, a.car, a.legal) for a in attempts] == [(4, 0, True), (4, 1, True), (4, 2, False)]
    assert [a.result for a in attempts] == ["as predicted", "failed", "failed"]
    assert attempts[1].skill.startswith("blocked")
    assert attempts[2].reason == "the rules forbid LIFT to car 2 here"


def test_a_simulation_that_breaks_down_has_diverged():
    checked = _unfolding(False)
    site = checked.site
    checked.executor.observers.append(lambda _: site.data.xfrc_applied.__setitem__((1, 2), 1e30))
    record = checked.perform(0, 0, Action.UNFOLD)
    assert record.verdict.finding is Finding.DIVERGED
    assert attempt_of(record, LIMITS).result == Result.FAILED
    site.reset()
    assert not site.diverged


def test_what_still_moves_when_all_motors_rest_is_unsettled():
    checked = _unfolding(True)
    site = checked.site

    def hand(_):
        # A declared disturbance: somebody pulls the block up, gently and for ever.
        site.data.xfrc_applied[site.blocks[0].body, 2] = 5.4

    checked.executor.observers.append(hand)
    record = checked.perform(0, 0, Action.STOP)
    assert record.verdict.finding is Finding.UNSETTLED
    assert "still moves with" in record.verdict.differences[0]


def test_the_impact_limit_is_above_what_a_loaded_car_and_its_motors_do():
    assert 400 < impact_limit_n() < 700


def test_verbs_forget_the_direction():
    assert ACTIONS[Action.MOVE_BACK].verb == "MOVE"
    assert ACTIONS[Action.ROTATE_LEFT].verb == "ROTATE_LEFT"
