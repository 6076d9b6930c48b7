"""Every reason for which a skill fails has a physical cause, none raises, and what may pass is tried again."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from craftsim.compiled.jit import records
from craftsim.discrete.geometry import CELL_PITCH_M, INCLINE_RAD
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.mjcf.machines import NOMINAL
from craftsim.models.sensing import CarMeasurement, measure
from craftsim.skills.executor import Executor
from craftsim.skills.gains import RecoveryGains, load_gains
from craftsim.skills.laws import Profile
from craftsim.skills.library import BUILT_IN, Tries, begin_of
from craftsim.skills.outcome import Outcome, Reason
from craftsim.skills.setup import SkillSetup, Terrain
from craftsim.skills.skill import Command, LawSkill
from craftsim.skills.state import TASK

PERIOD_S = 0.02
FAST = load_gains("fast")
"""With them an action is tried once."""

RIGHT = Action.MOVE_RIGHT
PERFORMED = [action for action in Action if action <= Action.STOP]
CALM = CarMeasurement(
    0.0, 0.16125, 0.16125, 0.0, 0.0, 0.0, 0.0, np.zeros(4), 0.0, 0.0, 0, math.pi / 2
)
"""At rest in the middle of cell (0, 0), under a half-open slope."""


def _run(physics, action, terrain=None, observer=None, gains=None) -> Outcome:
    ground = {0: terrain} if terrain else None
    return Executor(physics, gains or FAST, observer).run({0: action}, ground)[0]


def _skill(action):
    return LawSkill(SkillSetup(NOMINAL.cars[0], NOMINAL, load_gains(), PERIOD_S), begin_of(action))


def _weaken(newtons, *actuators):
    """Return what limits the force or torque of motors, found in a physics world."""

    def limit(physics):
        for find in actuators:
            physics.model.actuator_forcerange[find(physics)] = [-newtons, newtons]

    return limit


def _lift_off(physics):
    # A declared disturbance: somebody lifts the block off with half again its weight.
    physics.data.xfrc_applied[physics.blocks[0].body, 2] = 1.5 * 0.504 * 9.81


STIFF = replace(FAST.drive, position_gain=0.5, integral_gain=1e-5, position_tolerance=1e-7)
CAR, BLOCK = (0, 0, 1, 0), Kind.BLOCK

CAUSES = {
    # With so little torque wheels stall before they lose their grip.
    "a load meets a wall": (
        *(RIGHT, Reason.BLOCKED, "behind the path", [(*CAR, BLOCK)], [(Kind.WALL, (1, 0, 1))]),
        {"weaken": _weaken(0.7, lambda physics: physics.cars[0].wheel_actuators)},
    ),
    "it lifts nothing": (Action.LIFT, Reason.LOAD_LOST, "feels", [CAR], [], {}),
    "its load is taken away": (
        RIGHT,
        Reason.LOAD_LOST,
        "feels",
        [(*CAR, BLOCK)],
        [],
        {"observer": _lift_off},
    ),
    "it folds nothing": (
        Action.FOLD,
        Reason.MISALIGNED,
        "docked",
        [CAR],
        [(Kind.FSLOPE, (1, 0, 1), 0)],
        {},
    ),
    "it rests off its target": (
        *(RIGHT, Reason.MISALIGNED, "from the target", [CAR], []),
        {"gains": replace(FAST, drive=STIFF)},
    ),
    "a board has no force": (
        *(Action.LIFT, Reason.TIMEOUT, "the board", [CAR], [(BLOCK, (0, 0, 1))]),
        {"weaken": _weaken(0.0, lambda physics: physics.cars[0].board.actuator)},
    ),
    "a hinge has no torque": (
        *(Action.FOLD, Reason.TIMEOUT, "the hinge", [(1, 0, 1, 0)], [(Kind.BODY, (1, 0, 1), 2)]),
        {"weaken": _weaken(0.0, lambda physics: physics.slopes[0].hinge.actuator)},
    ),
}


@pytest.mark.parametrize(
    ("action", "reason", "detail", "cars", "objects", "more"), CAUSES.values(), ids=CAUSES
)
def test_each_reason_has_a_physical_cause(make_site, action, reason, detail, cars, objects, more):
    physics = make_site((3, 1, 2), cars, objects)
    more.get("weaken", lambda physics: None)(physics)
    outcome = _run(physics, action, observer=more.get("observer"), gains=more.get("gains"))
    assert outcome.reason is reason
    assert detail in outcome.detail
    if reason is Reason.MISALIGNED and action is Action.FOLD:
        assert outcome.duration_s <= FAST.hinge.undocked + 2 * PERIOD_S


@pytest.mark.parametrize(
    ("action", "cars", "objects", "blocked"),
    [
        (RIGHT, [(*CAR, BLOCK)], [(Kind.WALL, (1, 0, 1))], 2),
        (RIGHT, [CAR, (1, 0, 1, 0)], [], 2),
        (Action.MOVE_FORWARD, [CAR, (0, 1, 1, 0)], [], 0),
    ],
    ids=["a load at a wall", "a car", "a car to the side"],
)
def test_a_car_that_is_strong_enough_to_spin_its_wheels_at_an_obstacle_is_blocked(
    make_site, action, cars, objects, blocked
):
    """Wheels that spin at 1 m/s chatter, so that by chance the car reports slipping, in 2 of 24 starts as these.

    To the side it pushes the other car 110 mm along, on tyres as on rollers, and both reasons are true.
    """
    outcomes = []
    for shift in np.linspace(-0.5e-3, 0.5e-3, 3):
        physics = make_site((3, 2, 2), cars, objects)
        physics.data.qpos[physics.cars[0].base.qpos] += shift
        outcomes.append(_run(physics, action))
    assert {outcome.reason for outcome in outcomes} <= {Reason.BLOCKED, Reason.SLIPPED}
    assert sum(outcome.reason is Reason.BLOCKED for outcome in outcomes) >= blocked
    assert max(outcome.duration_s for outcome in outcomes) < 1.0


@pytest.mark.parametrize(
    ("objects", "terrain"),
    [([], None), ([(Kind.BODY, (2, 0, 1), 2), (BLOCK, (3, 0, 1))], Terrain(0.0, INCLINE_RAD))],
    ids=["level", "climb"],
)
def test_rollers_without_grip_slip(make_site, objects, terrain):
    physics = make_site((4, 1, 2), [CAR], objects)
    rollers = physics.model.geom_contype == 2
    physics.model.geom_friction[rollers, 0] = 0.1 if terrain else 0.02
    physics.model.geom_priority[rollers] = 1
    assert _run(physics, RIGHT, terrain).reason is Reason.SLIPPED


def test_wheels_that_cannot_brake_time_out_a_stop():
    skill = _skill(Action.STOP)
    spinning = CALM._replace(wheel_speeds=np.full(4, 5.0))
    skill.start(spinning)
    for _ in range(200):
        skill.step(spinning)
    assert skill.outcome is not None
    assert skill.outcome.reason is Reason.TIMEOUT


def test_a_car_that_is_close_enough_brakes_while_two_wheels_slip_on_the_spot():
    """Otherwise it corrects its last fifth of a millimetre until its time is up."""
    skill = _skill(RIGHT)
    skill.start(CALM)
    slipping = CALM._replace(wheel_speeds=(0.08, 0.0, 0.0, 0.08))
    drives = True
    while drives and skill.outcome is None:
        way = Profile(*skill.task["drive"]["profile"].tolist()).distance(skill.elapsed_s)
        now = slipping._replace(x=CALM.x + way - 0.0002)
        drives = any(skill.step(now).wheels)
    assert skill.outcome is None
    assert skill.elapsed_s < 1.8
    for _ in range(2):
        skill.step(now._replace(wheel_speeds=(0.0, 0.0, 0.0, 0.0)))
    assert skill.outcome is not None
    assert skill.outcome.succeeded


NUMBERS = ["x", "y", "z", "heading", "pitch", "roll", "board_m", "board_force_n", "hinge_rad"]


def test_a_measurement_that_is_not_finite_has_diverged_at_the_start_and_on_the_way():
    wheel = {"wheel_speeds": np.array([0, 0, math.nan, 0])}
    nonsense = [
        wheel,
        *({name: value} for name in NUMBERS for value in (math.nan, math.inf, -math.inf)),
    ]
    for action in PERFORMED:
        for values in nonsense:
            for begins in (CALM, CALM._replace(**values)):
                skill = _skill(action)
                skill.start(begins)
                command = skill.step(CALM._replace(**values))
                assert skill.outcome is not None
                assert skill.outcome.reason is Reason.DIVERGED, (action, values)
                assert not np.any(command.wheels)


def test_a_leaning_car_has_tipped_commands_zeros_and_keeps_its_outcome_and_the_incline_is_no_tipping():
    for changes in (
        {"roll": 0.6},
        {"roll": -0.6},
        {"pitch": 0.6},
        {"pitch": -0.6},
        {"pitch": -INCLINE_RAD},
    ):
        for action in PERFORMED:
            skill = _skill(action)
            skill.start(CALM)
            command, first = skill.step(CALM._replace(**changes)), skill.outcome
            tipped = first is not None and first.reason is Reason.TIPPED
            assert tipped is (abs(sum(changes.values())) > 0.5)
            if tipped:
                assert command == skill.step(CALM._replace(x=1.0, board_m=0.02)) == Command()
                assert skill.outcome is first


def _apply(physics, command):
    physics.drive(0, command.wheels)
    physics.move_board(0, command.board)
    slope = measure(physics, 0).slope
    if slope is not None:
        physics.turn_hinge(slope, command.hinge)


@pytest.mark.parametrize(
    ("action", "objects"),
    [
        (RIGHT, []),
        (Action.ROTATE_LEFT, []),
        (Action.LIFT, [(Kind.BLOCK, (1, 1, 1))]),
        (Action.UNFOLD, [(Kind.FSLOPE, (1, 1, 1), 2)]),
    ],
    ids=["move", "turn", "lift", "unfold"],
)
def test_a_skill_that_is_interrupted_goes_on_and_succeeds(make_site, action, objects):
    physics = make_site((3, 3, 2), [(1, 1, 1, 0)], objects)
    skill = _skill(action)
    skill.start(measure(physics, 0))
    periods = 0
    while skill.outcome is None:
        _apply(physics, skill.step(measure(physics, 0)))
        physics.advance()
        periods += 1
        if periods in (15, 30):
            for _ in range(50):
                _apply(physics, Command())
                physics.advance()
    assert skill.outcome.succeeded, str(skill.outcome)
    assert skill.outcome.duration_s == pytest.approx(periods * PERIOD_S, abs=PERIOD_S * 1.01)
    assert not np.any(physics.data.warning.number[mujoco.mjtWarning.mjWARN_BADQACC])


def _break_plug(monkeypatch, executor, broken):
    """Let the cars of an executor feel no slope wherever ``broken()``."""
    read = executor.fleet.read

    def without():
        readings = read().copy()
        if broken():
            readings["slope"], readings["hinge_rad"] = -1, 0.0
        return readings

    monkeypatch.setattr(executor.fleet, "read", without)


def test_a_slope_that_loses_its_car_stops(make_site, monkeypatch):
    physics = make_site((3, 3, 2), [(1, 1, 1, 0)], [(Kind.FSLOPE, (1, 1, 1), 2)])
    executor = Executor(physics, FAST)
    executor.begin(0, Action.UNFOLD)
    for _ in range(20):
        executor.advance()
    hinge = physics.slopes[0].hinge.actuator
    assert physics.data.ctrl[hinge] < 0
    _break_plug(monkeypatch, executor, lambda: True)
    ended = executor.advance()
    assert physics.data.ctrl[hinge] == 0
    while not ended:
        ended = executor.advance()
    assert ended[0].reason is Reason.MISALIGNED
    assert ended[0].duration_s < 20 * PERIOD_S + 2 * FAST.hinge.undocked


def test_a_hinge_outlasts_a_plug_that_chatters(make_site, monkeypatch):
    executor = Executor(make_site((3, 3, 2), [(1, 1, 1, 0)], [(Kind.FSLOPE, (1, 1, 1), 2)]))
    felt = iter(range(10**6))
    _break_plug(monkeypatch, executor, lambda: next(felt) % 10 == 0)
    assert executor.run({0: Action.UNFOLD})[0].succeeded


CAREFUL = replace(FAST.uneven, max_tight_speed=0.3, max_tight_acceleration=0.8, shake_after=10.0)
TWICE = replace(FAST, uneven=CAREFUL, recovery=RecoveryGains(2.0))
GONE_M = 20.0


def _weaken_wheels(physics):
    for actuator in physics.cars[0].wheel_actuators:
        physics.model.actuator_forcerange[actuator] = [-1.2, 1.2]


@pytest.fixture
def blocked(make_site):
    """Two cars, the second in the first one's way."""
    physics = make_site((2, 1, 1), [(0, 0, 1, 0), (1, 0, 1, 0)])
    _weaken_wheels(physics)
    return physics


def _leaves_at(time_s):
    def hand(physics):
        if physics.time_s > time_s:
            physics.data.qpos[physics.cars[1].base.qpos] = GONE_M

    return hand


def test_what_is_gone_at_the_second_try_blocks_the_first_only(blocked):
    begun = blocked.time_s
    outcome = Executor(blocked, TWICE, _leaves_at(1.5)).run({0: Action.MOVE_RIGHT})[0]
    assert (outcome.succeeded, outcome.tries) == (True, 2)
    assert outcome.duration_s == pytest.approx(blocked.time_s - begun, abs=0.1)
    assert abs(measure(blocked, 0).x - 1.5 * CELL_PITCH_M) < 1e-3


def test_a_car_that_fails_again_has_gone_back_in_between_and_says_why_and_how_often_it_tried(
    blocked,
):
    executor, ways = Executor(blocked, TWICE), []
    executor.observers.append(
        lambda physics: ways.append(measure(physics, 0).x - 0.5 * CELL_PITCH_M)
    )
    outcome = executor.run({0: Action.MOVE_RIGHT})[0]
    assert (outcome.reason, outcome.tries) == (Reason.BLOCKED, 2)
    forth = next(i for i, way in enumerate(ways) if way > 0.05)
    back = next(i for i in range(forth, len(ways)) if ways[i] < 0.002)
    assert max(ways[back:]) > 0.05


def test_a_car_that_recovers_stands_in_its_cell_after_a_failure_and_says_so(blocked):
    outcome = Executor(blocked, TWICE, recovers=True).run({0: Action.MOVE_RIGHT})[0]
    assert (outcome.reason, outcome.tries) == (Reason.BLOCKED, 2)
    assert str(outcome).endswith("; the car went back")
    assert measure(blocked, 0).x == pytest.approx(0.5 * CELL_PITCH_M, abs=1e-3)


def test_a_way_back_that_fails_is_tried_twice_and_what_had_failed_is_the_outcome():
    setup = SkillSetup(NOMINAL.cars[0], NOMINAL, FAST, 0.02)
    tries = Tries(Action.MOVE_RIGHT, setup, BUILT_IN, (0.15, 0.15, 0.0), recovers=True)
    failed = Outcome(Reason.BLOCKED, 1.0, "it is in the way")
    for _ in range(2):
        assert tries.next(failed) is not None
        failed = Outcome(Reason.TIMEOUT, 1.0)
    assert tries.next(failed) is None
    expected = "blocked: it is in the way; the car could not go back"
    assert (str(tries.outcome(failed)), tries.outcome(failed).duration_s) == (expected, 3.0)


def test_a_single_try_is_all_that_fast_gains_give(blocked):
    outcome = Executor(blocked, FAST, _leaves_at(1.5)).run({0: Action.MOVE_RIGHT})[0]
    assert (outcome.reason, outcome.tries) == (Reason.BLOCKED, 1)


def test_lifting_nothing_is_tried_again_with_the_board_lowered_in_between(make_site):
    physics, heights = make_site((1, 1, 2), [(0, 0, 1, 0)]), []
    executor = Executor(physics, TWICE, lambda physics: heights.append(measure(physics, 0).board_m))
    outcome = executor.run({0: Action.LIFT})[0]
    assert (outcome.reason, outcome.tries) == (Reason.LOAD_LOST, 2)
    up = [height > 0.04 for height in heights]
    lowered = heights[up.index(True) : len(up) - up[::-1].index(True)]
    assert min(lowered) < 0.002


def test_a_load_that_is_lost_on_the_way_is_not_tried_again(make_site):
    physics = make_site((3, 1, 2), [(0, 0, 1, 0, Kind.BLOCK)])

    def hand(physics):
        physics.data.qpos[physics.blocks[0].qpos] = GONE_M

    outcome = Executor(physics, TWICE, hand).run({0: Action.MOVE_RIGHT})[0]
    assert (outcome.reason, outcome.tries) == (Reason.LOAD_LOST, 1)


def test_a_car_that_recovers_goes_back_without_its_load_and_lowers_the_board(make_site):
    physics = make_site((3, 1, 2), [(0, 0, 1, 0, Kind.BLOCK)])

    def hand(physics):
        if measure(physics, 0).x > 0.7 * CELL_PITCH_M:
            physics.data.qpos[physics.blocks[0].qpos] = GONE_M

    outcome = Executor(physics, TWICE, hand, recovers=True).run({0: Action.MOVE_RIGHT})[0]
    assert (outcome.reason, outcome.tries) == (Reason.LOAD_LOST, 1)
    assert str(outcome).endswith("; the car went back")
    assert measure(physics, 0).x == pytest.approx(0.5 * CELL_PITCH_M, abs=1e-3)
    assert measure(physics, 0).board_m < 0.002


def test_a_car_that_has_leant_goes_back_and_one_that_still_leans_does_not():
    setup = SkillSetup(NOMINAL.cars[0], NOMINAL, TWICE, 0.02)
    tries = Tries(Action.MOVE_RIGHT, setup, BUILT_IN, (0.15, 0.15, 0.0), recovers=True)
    tipped = Outcome(Reason.TIPPED, 1.0, "pitch +0.60 rad")
    assert tries.next(tipped) is not None
    assert tries.next(tipped) is None
    assert str(tries.outcome(tipped)).endswith("rad; the car could not go back")
    alone = Tries(Action.MOVE_RIGHT, setup, BUILT_IN, (0.15, 0.15, 0.0))
    assert alone.next(tipped) is None


def test_a_stopped_action_says_what_had_failed_before_and_how_long_all_tries_took(blocked):
    begun = blocked.time_s
    executor = Executor(blocked, TWICE)
    executor.begin(0, Action.MOVE_RIGHT)
    tries = executor._tries[0]
    executor.guard = lambda: tries.failed is not None
    outcomes = {}
    while executor.busy:
        outcomes = executor.advance()
    outcome = outcomes[0]
    assert (outcome.reason, outcome.tries) == (Reason.STOPPED, 1)
    assert outcome.detail.startswith("after blocked: ")
    assert outcome.duration_s == pytest.approx(blocked.time_s - begun, abs=0.05)
    assert outcome.duration_s > 0.3


def test_a_turn_that_failed_is_undone_by_a_turn_and_not_by_a_jump():
    setup = SkillSetup(NOMINAL.cars[0], NOMINAL, TWICE, 0.02)
    middle = 0.5 * CELL_PITCH_M
    tries = Tries(Action.ROTATE_LEFT, setup, BUILT_IN, (middle, middle, 0.0))
    back, setup = tries.next(Outcome(Reason.TIMEOUT, 1.0))
    now = CarMeasurement(
        0.0, middle + 1e-3, middle, 0.0, math.pi / 2, 0.0, 0.0, (0.0,) * 4, 0.0, 0.0, None, None
    )
    task = records(1, TASK)[0]
    back(setup, now, task)
    quickest_s = math.sqrt(1.5 * math.pi / 2 / setup.gains.drive.max_turn_acceleration)
    assert task["drive"]["profile"]["duration_s"] > quickest_s
    assert task["drive"]["delta"].item() == pytest.approx((-1e-3, 0.0, -math.pi / 2))
