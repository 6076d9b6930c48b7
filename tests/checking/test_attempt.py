"""An attempt is judged by limits set beforehand, and says in one line what went wrong physically."""

import json
from dataclasses import asdict, fields, replace

import numpy as np
import pytest

from craftsim.checking import judge as judging
from craftsim.checking.attempt import BOUNDED_ERRORS, Attempt, Thresholds, Verdict, attempt_of, verdict_of
from craftsim.checking.contacts import Contact, impact_limit_n
from craftsim.checking.setup import Setup, set_up
from craftsim.discrete.actions import ACTIONS
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.kinds import Action
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
    return set_up(grid, Setup("published"))


def _watched(judge, *action, **options):
    """Perform an action, and return its watched, the verdict on it and the attempt that they make."""
    seen = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(judging, "attempt_of", lambda *given: seen.append(given) or attempt_of(*given))
        attempt = judge.perform(*action, **options)
    watched, verdict, _ = seen[0]
    return watched, verdict, attempt


@pytest.fixture(scope="module")
def good():
    return _watched(_unfolding(False), 0, Action.UNFOLD, tick=3)


@pytest.fixture(scope="module")
def shoved():
    return _watched(_unfolding(True), 0, Action.UNFOLD)


def test_what_goes_as_predicted_needs_no_reason(good):
    watched, _, attempt = good
    assert (attempt.result, attempt.finding, attempt.reason) == ("as predicted", "agrees", "")
    assert (attempt.tick, attempt.car, attempt.action, attempt.verb) == (3, 0, "UNFOLD", "UNFOLD")
    assert (attempt.level, attempt.load, attempt.slope, attempt.legal) == (1, "none", False, True)
    assert attempt.skill == "succeeded"
    assert attempt.duration_s > 5
    assert attempt.performed
    assert attempt.agrees
    assert watched.own == ("car 0", "slope 0")


def test_a_bystander_that_is_shoved_is_a_side_effect_and_named(shoved):
    watched, _, attempt = shoved
    assert attempt.result == Verdict.SIDE_EFFECT
    assert not attempt.agrees
    assert attempt.bystander_displacement_m > 2 * LIMITS.bystander_m
    assert "block 0 touched slope 0" in attempt.reason
    assert "block 0 was moved by" in attempt.reason
    assert [(c.first, c.second) for c in watched.contacts] == [("block 0", "slope 0")]


def test_an_attempt_is_json(shoved):
    attempt = shoved[2]
    fields = json.loads(json.dumps(asdict(attempt), allow_nan=False))
    assert Attempt.of(fields) == attempt


def _spoilt(good, cause=None, **changes):
    watched, agreed, _ = good
    errors = watched.errors | {name: changes.pop(name) for name in list(changes) if name in watched.errors}
    changed = replace(watched, errors=errors, **changes)
    return verdict_of(changed, cause or agreed, changed.exceeded(LIMITS))


def test_the_result_follows_from_effect_errors_and_verdict(good):
    for changes, result in (
        ({"outcome": Outcome(Reason.TIMEOUT, 1.0)}, Verdict.FAILED),
        ({"differences": ("car 0: predicted a, read b",)}, Verdict.FAILED),
        ({"outcome": None}, Verdict.FAILED),
        ({"car_error_m": 0.0011}, Verdict.FAILED),
        ({"heading_error_rad": 0.0031}, Verdict.FAILED),
        ({"height_error_m": 0.0021}, Verdict.FAILED),
        ({"placed_error_m": 0.0013}, Verdict.FAILED),
        ({"tilt_error_rad": 0.011}, Verdict.FAILED),
        ({"seat_error_m": 0.0013}, Verdict.FAILED),
        ({"thing_heading_rad": 0.0051}, Verdict.FAILED),
        ({"thing_tilt_rad": 0.011}, Verdict.FAILED),
        ({"thing_height_m": 0.0021}, Verdict.FAILED),
        ({"reach_m": 0.0013}, Verdict.FAILED),
        ({"bystander_turn_rad": 0.0041}, Verdict.SIDE_EFFECT),
        ({"drift_m": 0.0011}, Verdict.SIDE_EFFECT),
        ({"drift_rad": 0.0041}, Verdict.SIDE_EFFECT),
        ({"bystander_reach_m": 0.0013}, Verdict.SIDE_EFFECT),
        ({"bystander_tilt_rad": 0.011}, Verdict.SIDE_EFFECT),
        ({"drift_rad": float("nan")}, Verdict.SIDE_EFFECT),
        ({"bystander_displacement_m": 0.0011}, Verdict.SIDE_EFFECT),
        ({"bystander_displacement_m": 0.0009}, Verdict.AS_PREDICTED),
        ({"bystander_displacement_m": 0.0011, "car_error_m": 0.0011}, Verdict.FAILED),
        ({"car_error_m": float("nan")}, Verdict.FAILED),
        ({"cause": ("side effect", ("car 1: predicted a, read b",))}, Verdict.SIDE_EFFECT),
        ({"cause": ("unreadable", ("block 3 leans by 0.30 rad",))}, Verdict.SIDE_EFFECT),
        ({"cause": ("unreadable", ("slope 0 is half open: ...",))}, Verdict.FAILED),
        ({"cause": ("unreadable", ("car 0 leans: ...",))}, Verdict.FAILED),
        ({"cause": ("unsettled", ("something still moves",))}, Verdict.FAILED),
        ({"cause": ("diverged", ("the simulation broke down",))}, Verdict.SOLVER),
        ({"cause": ("numerics", ("not solved",))}, Verdict.SOLVER),
        (
            {"cause": ("unsafe", ("block 3 fell (0.8 m/s)",)), "capped_steps": 1},
            Verdict.SOLVER,
        ),
        ({"capped_steps": 3}, Verdict.AS_PREDICTED),
        ({"cause": ("unsafe", ("block 3 fell (0.8 m/s)",))}, Verdict.UNSAFE),
    ):
        assert _spoilt(good, **changes) is result


def test_a_reason_names_first_what_was_broken_then_what_was_touched(good):
    contact = Contact("car 0", "block 1", 1.0, 20.0, False)
    watched, verdict, _ = good
    other = replace(
        watched,
        hazards=((("block 1",), "block 1 fell (0.8 m/s)"),),
        contacts=(contact,),
        outcome=Outcome(Reason.BLOCKED, 1.0, "41 mm behind the path"),
    )
    unsafe = ("unsafe", ("block 1 fell (0.8 m/s)",))
    assert attempt_of(other, unsafe, LIMITS).reason == (
        "block 1 fell (0.8 m/s); blocked: 41 mm behind the path; car 0 touched block 1 (20 N)"
    )
    turned = replace(watched, errors=watched.errors | {"heading_error_rad": 0.00301}, contacts=(contact,))
    assert attempt_of(turned, verdict, LIMITS).reason == (
        "the car is turned by 3.01 mrad (allowed 3.00); car 0 touched block 1 (20 N)"
    )
    strayed = replace(watched, errors=watched.errors | {"car_error_m": 0.0034}, strayed_m=0.0052)
    assert attempt_of(strayed, verdict, LIMITS).reason == (
        "the car is 3.40 mm off (allowed 1.00); the car strayed 5.2 mm from its path"
    )


def test_every_limit_is_that_of_an_error_and_every_error_is_held_against_one():
    limits = {measure.limit for measure in BOUNDED_ERRORS} | {"force"}  # which the contact log holds
    assert limits == {f.name for f in fields(Thresholds)}
    errors = {f.name for f in fields(Attempt) if f.name.endswith(("_m", "_rad"))}
    assert errors == {measure.field for measure in BOUNDED_ERRORS}


def test_what_the_rules_forbid_is_not_performed_and_says_which_rule():
    judge = _unfolding(False)
    before = judge.physics.data.qpos.copy()
    attempt = judge.perform(0, Action.DROP)
    assert (attempt.result, attempt.skill, attempt.legal) == ("failed", "not performed", False)
    assert (attempt.performed, attempt.agrees, attempt.duration_s) == (False, False, 0.0)
    assert attempt.finding == "not executed"
    assert attempt.reason == f"the rules forbid it: {judge.rules.explain(judge.grid, 0, Action.DROP).why}"
    np.testing.assert_array_equal(judge.physics.data.qpos, before)


def test_what_the_rules_forbid_is_performed_where_it_is_said_what_it_should_lead_to():
    judge = _unfolding(False)
    intended = judge.grid.copy()
    intended.cars[0, 0] = 3
    assert judge.perform(0, Action.MOVE_RIGHT, intended).legal
    before = judge.grid
    assert not judge.rules.legal(before, 0, Action.DROP)
    stays = judge.perform(0, Action.DROP, before.copy(), tick=1)
    assert (stays.legal, stays.performed, stays.skill) == (False, True, "succeeded")
    assert (stays.finding, stays.result, stays.tick) == ("agrees", Verdict.AS_PREDICTED, 1)


def test_many_cars_at_once_get_an_attempt_each():
    grid = Grid.empty((4, 3, 2), 3)
    grid.cars[:, :4] = [[0, 0, 1, 0], [0, 2, 1, 0], [3, 1, 1, 0]]
    grid.derive_marks()
    judge = set_up(grid, Setup())
    judge.physics.model.actuator_forcerange[judge.physics.cars[1].wheel_actuators] = 0.0
    acts = [(0, Action.MOVE_RIGHT), (1, Action.MOVE_RIGHT), (2, Action.LIFT)]
    attempts = judge.perform_tick(acts, tick=4)
    assert [(a.tick, a.car, a.legal) for a in attempts] == [(4, 0, True), (4, 1, True), (4, 2, False)]
    assert [a.result for a in attempts] == ["as predicted", "failed", "failed"]
    assert attempts[1].skill.startswith("blocked")
    assert attempts[2].reason.startswith("the rules forbid it: ")


def test_a_simulation_that_breaks_down_has_diverged():
    judge = _unfolding(False)
    physics = judge.physics
    judge.executor.observers.append(lambda _: physics.data.xfrc_applied.__setitem__((1, 2), 1e30))
    attempt = judge.perform(0, Action.UNFOLD)
    assert (attempt.finding, attempt.result) == ("diverged", Verdict.SOLVER)
    assert "the simulation broke down" in judge.problems
    physics.reset()
    assert not physics.diverged


def test_what_still_moves_when_all_motors_rest_is_unsettled():
    judge = _unfolding(True)
    physics = judge.physics

    def hand(_):
        # A declared disturbance: somebody pulls the block up, gently and for ever.
        physics.data.xfrc_applied[physics.blocks[0].body, 2] = 5.4

    judge.executor.observers.append(hand)
    attempt = judge.perform(0, Action.STOP)
    assert attempt.finding == "unsettled"
    assert "still moves with" in attempt.differences[0]


def test_the_impact_limit_is_above_what_a_loaded_car_and_its_motors_do():
    assert 420 < impact_limit_n() < 500


def test_verbs_forget_the_direction():
    assert ACTIONS[Action.MOVE_BACK].verb == "MOVE"
    assert ACTIONS[Action.ROTATE_LEFT].verb == "ROTATE_LEFT"
