"""What is found of an action follows from prediction, reading and limits; and is said in one line."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from discrete.drawn import draw

from craftsim.checking import judge as judging
from craftsim.checking.attempt import (
    Attempt,
    Cause,
    Verdict,
    attempt_of,
    compare_reading,
    verdict_of,
)
from craftsim.checking.contacts import Contact
from craftsim.checking.setup import Setup, set_up
from craftsim.checking.thresholds import thresholds_of
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import Reading, describe_car, describe_differences, own_differences
from craftsim.skills.outcome import Outcome, Reason

LIMITS = thresholds_of()


def _unfolding(blocked: bool):
    """Return a car below a folded slope whose foot goes to (1, 1); a block beyond it, if asked for."""
    objects = [(Kind.FSLOPE, (2, 1, 1), 2), *([(Kind.BLOCK, (0, 1, 1))] if blocked else [])]
    return set_up(draw((4, 3, 2), objects, [(2, 1, 1, 0)]), Setup("published"))


def _watched(judge, *action, **options):
    """Perform an action, and return its watched, the cause of the verdict and the attempt that they make."""
    seen = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            judging, "attempt_of", lambda *given: seen.append(given) or attempt_of(*given)
        )
        attempt = judge.perform(*action, **options)
    watched, cause, _ = seen[0]
    return watched, cause, attempt


@pytest.fixture(scope="module")
def good():
    return _watched(_unfolding(False), 0, Action.UNFOLD, tick=3)


@pytest.fixture(scope="module")
def shoved():
    return _watched(_unfolding(True), 0, Action.UNFOLD)


def test_what_goes_as_predicted_needs_no_reason(good):
    watched, _, attempt = good
    assert (attempt.result, attempt.finding, attempt.reason) == ("as predicted", "agrees", "")
    assert (attempt.tick, attempt.verb, attempt.level, attempt.load) == (3, "UNFOLD", 1, "none")
    assert (attempt.skill, attempt.slope, attempt.legal) == ("succeeded", False, True)
    assert attempt.performed
    assert attempt.agrees
    assert attempt.duration_s > 5
    assert watched.names == ("car 0", "slope 0")


def test_a_bystander_that_is_shoved_is_a_side_effect_and_named(shoved):
    watched, _, attempt = shoved
    assert (attempt.result, attempt.agrees) == (Verdict.SIDE_EFFECT, False)
    assert attempt.bystander_displacement_m > 2 * LIMITS.place_m
    assert "block 0 touched slope 0" in attempt.reason
    assert "block 0 was moved by" in attempt.reason
    assert [(c.first, c.second) for c in watched.contacts] == [("block 0", "slope 0")]


def test_an_attempt_is_json(shoved):
    written = json.dumps(asdict(shoved[2]), allow_nan=False)
    assert Attempt.of(json.loads(written)) == shoved[2]


FAILED, SIDE_EFFECT, SOLVER = Verdict.FAILED, Verdict.SIDE_EFFECT, Verdict.NUMERICS


def test_the_result_follows_from_effect_errors_and_cause(good):
    watched, agreed, _ = good

    def verdict(cause=agreed, measured=None, **changes):
        changed = replace(watched, measured=watched.measured | (measured or {}), **changes)
        return verdict_of(changed, cause, LIMITS)

    assert verdict(measured={"car_error_m": 0.0013}) is FAILED
    assert verdict(measured={"bystander_displacement_m": 0.0013}) is SIDE_EFFECT
    assert verdict(measured={"bystander_displacement_m": 0.0013, "car_error_m": 0.0013}) is FAILED
    assert verdict(outcome=Outcome(Reason.TIMEOUT, 1.0)) is FAILED
    assert verdict(outcome=None) is FAILED
    assert verdict(differences=("car 0: predicted a, read b",)) is FAILED
    for finding, line, result in (
        ("side effect", "car 1: predicted a, read b", SIDE_EFFECT),
        ("unreadable", "block 3 leans by 0.30 rad", SIDE_EFFECT),
        ("unreadable", "slope 0 is half open: ...", FAILED),
        ("unreadable", "car 0 leans: ...", FAILED),
        ("unsettled", "something still moves", FAILED),
        ("diverged", "the simulation broke down", SOLVER),
        ("numerics", "not solved", SOLVER),
        ("unsafe", "block 3 fell (0.8 m/s)", Verdict.UNSAFE),
    ):
        assert verdict(Cause(finding, (line,))) is result
        assert verdict(Cause(finding, (line,)), {"capped_steps": 1}) is SOLVER, (
            "what follows is held against the solver"
        )
    assert verdict(measured={"capped_steps": 3}) is Verdict.AS_PREDICTED
    assert verdict(measured={"tries": 2}) is Verdict.RETRIED
    assert verdict(measured={"tries": 2, "car_error_m": 0.0013}) is FAILED
    assert verdict(measured={"contact_force_n": 60.0}) is SIDE_EFFECT


def test_a_reason_names_first_what_was_broken_then_what_was_touched(good):
    watched, agreed, _ = good
    touched = (Contact("car 0", "block 1", 1.0, 20.0, False),)
    hazards, blocked = (
        ((("block 1",), "block 1 fell (0.8 m/s)"),),
        Outcome(Reason.BLOCKED, 1.0, "41 mm behind"),
    )
    for cause, changes, measured, reason in (
        (
            ("unsafe", ("block 1 fell (0.8 m/s)",)),
            {"hazards": hazards, "contacts": touched, "outcome": blocked},
            {},
            "block 1 fell (0.8 m/s); blocked: 41 mm behind; car 0 touched block 1 (20 N)",
        ),
        (
            agreed,
            {"contacts": touched},
            {"heading_error_rad": 0.00801},
            "the car is turned by 8.01 mrad (allowed 7.75); car 0 touched block 1 (20 N)",
        ),
        (
            agreed,
            {},
            {"car_error_m": 0.0034, "way_m": 0.0052},
            "the car is 3.40 mm off (allowed 1.25); the car strayed 5.2 mm from its path",
        ),
    ):
        changed = replace(watched, measured=watched.measured | measured, **changes)
        assert attempt_of(changed, Cause(*cause), LIMITS).reason == reason


def test_what_the_rules_forbid_is_not_performed_unless_it_is_said_what_it_should_lead_to():
    judge = _unfolding(False)
    before = judge.physics.data.qpos.copy()
    attempt = judge.perform(0, Action.DROP)
    assert (attempt.result, attempt.skill, attempt.legal) == ("failed", "not performed", False)
    assert (attempt.performed, attempt.agrees, attempt.duration_s) == (False, False, 0.0)
    assert attempt.finding == "not executed"
    assert (
        attempt.reason
        == f"the rules forbid it: {judge.rules.explain(judge.grid, 0, Action.DROP).why}"
    )
    np.testing.assert_array_equal(judge.physics.data.qpos, before)
    stays = judge.perform(0, Action.DROP, judge.grid.copy(), tick=1)
    assert (stays.legal, stays.performed, stays.skill) == (False, True, "succeeded")
    assert (stays.finding, stays.result, stays.tick) == ("agrees", Verdict.AS_PREDICTED, 1)
    intended = judge.grid.copy()
    intended.cars[0, 0] = 3
    assert judge.perform(0, Action.MOVE_RIGHT, intended).legal


def test_a_simulation_that_breaks_down_has_diverged():
    judge = _unfolding(False)
    physics = judge.physics
    judge.executor.observers.append(lambda _: physics.data.xfrc_applied.__setitem__((1, 2), 1e30))
    attempt = judge.perform(0, Action.UNFOLD)
    assert (attempt.finding, attempt.result) == ("diverged", Verdict.NUMERICS)
    assert "the simulation broke down" in judge.problems
    physics.reset()
    assert not physics.diverged


def test_what_still_moves_when_all_motors_rest_is_unsettled():
    judge = _unfolding(True)
    push = judge.physics.data.xfrc_applied[judge.physics.blocks[0].body]
    # A declared disturbance: somebody pulls the block up, gently and for ever.
    judge.executor.observers.append(lambda _: push.__setitem__(2, 5.4))
    attempt = judge.perform(0, Action.STOP)
    assert attempt.finding == "unsettled"
    assert "still moves with" in attempt.differences[0]


BEFORE = draw(
    (4, 4, 3), [(Kind.BLOCK, (1, 2, 1)), (Kind.FSLOPE, (2, 2, 1), 0)], [(0, 0, 1, 0), (3, 3, 1, 2)]
)
"""Two cars, a block and a folded slope."""


def _changed(grid: Grid, *, cars=(), cells=()) -> Grid:
    after = grid.copy()
    for car, field, value in cars:
        after.cars[car, field] = value
    for cell, kind in cells:
        after.kind[cell] = kind
    return after


STEP = _changed(BEFORE, cars=[(0, CarField.X, 1)])
TURNED, REMARKED = STEP.copy(), STEP.copy()
TURNED.yaw[2, 2, 1] = 1
REMARKED.occupant[:], REMARKED.landing[:] = 7, True
LOADED = _changed(BEFORE, cars=[(0, CarField.LOAD, Kind.FLAG)])
DROPPED = _changed(BEFORE, cells=[((0, 0, 1), Kind.FLAG)])
LEANS = "car 0 leans: pitch +0.30 rad, roll 0.00 rad"
GONE = [((1, 2, 1), Kind.AIR)]
FOUND = (
    (BEFORE, STEP, STEP, "agrees", None),
    (BEFORE, BEFORE, BEFORE, "agrees", None),
    (BEFORE, STEP, REMARKED, "agrees", None),
    (BEFORE, STEP, BEFORE, "not executed", "car 0: predicted 1,0,1 +x, read 0,0,1 +x"),
    *(
        (BEFORE, STEP, _changed(BEFORE, cars=[(0, *change)]), "wrong place", None)
        for change in ((CarField.Y, 1), (CarField.YAW, 1), (CarField.LOAD, Kind.BLOCK))
    ),
    (
        *(LOADED, DROPPED, _changed(BEFORE, cells=[((0, 0, 1), Kind.BLOCK)]), "wrong place"),
        "cell (0, 0, 1): predicted flag yaw 0, read block yaw 0",
    ),
    *(
        (BEFORE, STEP, _changed(STEP, cars=cars, cells=cells), "side effect", None)
        for cars, cells in (
            ([(1, CarField.Y, 2)], ()),
            ([(1, CarField.YAW, 0)], ()),
            ((), [*GONE, ((1, 3, 1), Kind.BLOCK)]),
            ((), [((2, 2, 1), Kind.BODY), ((3, 2, 1), Kind.FOOT)]),
        )
    ),
    (BEFORE, STEP, _changed(BEFORE, cells=GONE), "side effect", None),
    (
        BEFORE,
        STEP,
        TURNED,
        "side effect",
        "cell (2, 2, 1): predicted fslope yaw 0, read fslope yaw 1",
    ),
)
"""Before, predicted, read; what is found, and in which words if one difference is all."""


def test_what_is_found_follows_from_what_is_predicted_and_read():
    for before, predicted, read, found, words in FOUND:
        cause = compare_reading(before, predicted, Reading(read, (), ()))
        assert cause.finding == found, cause
        assert bool(cause.differences) == (found != "agrees")
        assert words is None or cause.differences == (words,)
    assert compare_reading(BEFORE, STEP, Reading(STEP, (), (), (LEANS,))) == (
        "unreadable",
        (LEANS,),
    )


def test_every_difference_gets_its_line():
    read = _changed(STEP, cars=[(0, CarField.X, 2), (1, CarField.YAW, 3)], cells=GONE)
    assert describe_differences(STEP, read) == [
        "cell (1, 2, 1): predicted block yaw 0, read air yaw 0",
        "car 0: predicted 1,0,1 +x, read 2,0,1 +x",
        "car 1: predicted 3,3,1 -x, read 3,3,1 -y",
    ]


def test_a_car_is_described_in_brief():
    for row, text in (
        ((2, 3, 1, 1, Kind.AIR, 0, 0), "2,3,1 +y"),
        ((0, 1, 2, 2, Kind.FSLOPE, 0, 2), "0,1,2 -x fslope+x high"),
        ((0, 1, 1, 3, Kind.FLAG, 0, 1), "0,1,1 -y flag low"),
    ):
        grid = Grid.empty((4, 4, 3), 1)
        grid.cars[0] = row
        assert describe_car(grid, 0) == text


def test_an_action_has_its_effect_whatever_else_happened_and_not_without_its_car_and_cell():
    dropped = _changed(STEP, cells=[((1, 0, 1), Kind.BLOCK)])
    pushed = _changed(dropped, cars=[(1, CarField.Y, 2)], cells=GONE)
    for read, has in (
        (dropped, True),
        (pushed, True),
        (BEFORE, False),
        (STEP, False),
        (_changed(BEFORE, cells=[((1, 0, 1), Kind.BLOCK)]), False),
    ):
        assert bool(own_differences(BEFORE, dropped, read, car=0)) is not has
