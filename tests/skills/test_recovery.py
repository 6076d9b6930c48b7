"""A car that failed for a reason that may pass goes back and tries again, and says so."""

import math
from dataclasses import replace

import pytest

from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import Kind
from craftsim.discrete.kernel.jit import records
from craftsim.discrete.kinds import Action
from craftsim.mjcf.parameters import NOMINAL
from craftsim.models.sensing import CarMeasurement, measure
from craftsim.skills.executor import Executor
from craftsim.skills.gains import RecoveryGains, load_gains
from craftsim.skills.library import BUILT_IN, Tries
from craftsim.skills.outcome import Outcome, Reason
from craftsim.skills.skill import SkillSetup
from craftsim.skills.state import TASK

FAST = load_gains("fast")
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


def test_a_car_that_fails_again_has_gone_back_in_between_and_says_why_and_how_often_it_tried(blocked):
    executor, ways = Executor(blocked, TWICE), []
    executor.observers.append(lambda physics: ways.append(measure(physics, 0).x - 0.5 * CELL_PITCH_M))
    outcome = executor.run({0: Action.MOVE_RIGHT})[0]
    assert (outcome.reason, outcome.tries) == (Reason.BLOCKED, 2)
    forth = next(i for i, way in enumerate(ways) if way > 0.05)
    back = next(i for i in range(forth, len(ways)) if ways[i] < 0.002)
    assert max(ways[back:]) > 0.05


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
