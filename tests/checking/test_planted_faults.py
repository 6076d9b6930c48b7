"""Faults that a car or somebody else commits in physics, of which each once passed for as predicted."""

import copy
import math
import pickle
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from discrete.drawn import draw

import craftsim
from craftsim.checking.setup import Setup, set_up, setup_of
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.models.randomization import NONE
from craftsim.models.sensing import SensorNoise
from craftsim.skills.library import begin_of, own_skills
from craftsim.skills.skill import Command, LawSkill, Skill

RIGHT = Action.MOVE_RIGHT
PITCH_M = 0.3225


class _Then(Skill):
    """Perform a built-in action, and then something else for a while, or wait before it."""

    action = RIGHT
    wait_s = 0.0
    after_s = 0.0
    command = Command()

    def start(self, now):
        self.law = None
        self.ended_s = math.inf

    def step(self, now):
        if self.elapsed_s < self.wait_s:
            return Command()
        if self.law is None:
            self.law = LawSkill(self.setup, begin_of(self.action))
            self.law.start(now)
        if self.law.outcome is None:
            command = self.law.step(now)
            if self.law.outcome is None:
                return command
            self.ended_s = self.elapsed_s
        if self.elapsed_s - self.ended_s >= self.after_s:
            self.succeed()
        return self.command


class LeavesBoardUp(_Then):
    after_s = 1.0
    command = Command(board=0.02)


class Dawdles(_Then):
    wait_s = 9.5
    time_limit_s = 30.0


def _perform(skill, objects=()):
    setup = replace(setup_of("none"), skills=own_skills({RIGHT: skill}))
    return set_up(draw((4, 1, 2), objects, [(0, 0, 1, 0)]), setup).perform(0, RIGHT)


def test_a_board_that_is_left_up_is_found():
    attempt = _perform(LeavesBoardUp)
    assert attempt.result == "failed"
    assert "the board is 19." in attempt.reason
    assert "above its stop (allowed 1.25)" in attempt.reason


def test_an_action_that_takes_ten_times_as_long_is_found():
    attempt = _perform(Dawdles)
    assert attempt.result == "failed"
    assert "times as long as nominal (allowed 10.00)" in attempt.reason


@pytest.mark.parametrize(
    "noise", [SensorNoise(position_bias_m=0.02), SensorNoise(heading_bias_rad=0.1)]
)
def test_a_bias_that_the_car_cannot_see_is_found(noise):
    setup = replace(setup_of("none"), randomization=replace(NONE, sensors=noise))
    attempt = set_up(draw((4, 1, 2), [], [(0, 0, 1, 0)]), setup).perform(0, RIGHT)
    assert attempt.result == "failed"
    assert attempt.reason.startswith("the car is ")


def test_a_load_off_its_seat_is_found_under_every_preset():
    for preset in ("none", "strong", "workshop_floor"):
        judge = set_up(
            draw((4, 3, 2), [], [(0, 0, 1, 0, Kind.BLOCK), (2, 2, 1, 0)]), setup_of(preset)
        )
        physics = judge.physics
        # Somebody lifts the block and puts it onto the rim of its pocket.
        physics.data.qpos[physics.blocks[0].qpos + np.array([0, 2])] += 0.003, 0.004
        mujoco.mj_forward(physics.model, physics.data)
        attempt = judge.perform(1, Action.ROTATE_LEFT)
        assert attempt.result != "as predicted", preset
        assert "block 0" in attempt.reason


def test_a_hit_on_an_idle_car_is_found():
    """A car is sent into the cell of another one, which stays where it is."""
    judge = set_up(draw((3, 1, 2), [], [(0, 0, 1, 0), (1, 0, 1, 0)]), Setup())
    grid = judge.grid
    attempt = judge.perform(0, RIGHT, intended=grid.copy())
    assert not attempt.agrees
    assert attempt.contact_force_n > judge.thresholds.contact_n
    assert "car 1 was moved" in attempt.reason


def test_a_flap_that_is_lifted_and_put_back_is_found():
    things = [(Kind.BODY, (1, 2, 1), 0)]
    judge = set_up(draw((4, 3, 2), things, [(0, 0, 1, 0)]), Setup())
    physics = judge.physics
    (slope,) = physics.slopes
    start_s = physics.time_s
    angles = []

    def lift(world):
        share = (world.time_s - start_s) / 0.8
        world.data.xfrc_applied[:] = 0.0
        height = 0.4 * math.sin(math.pi * min(1.0, share)) ** 2
        # A hand turns the flap: a declared disturbance.
        world.data.qpos[slope.hinge.qpos] = height
        angles.append(float(world.data.qpos[slope.hinge.qpos]))

    judge.executor.observers.insert(0, lift)
    attempt = judge.perform(0, RIGHT)
    assert max(angles) == pytest.approx(0.4, abs=0.01)
    assert attempt.result == "side effect"
    assert "slope 0 was turned" in attempt.reason


def test_a_board_of_a_bystander_that_rises_is_found():
    judge = set_up(draw((4, 2, 2), [], [(0, 0, 1, 0), (3, 1, 1, 0)]), Setup())
    board = judge.physics.cars[1].board.qpos

    def lift(world):
        world.data.qpos[board] = 0.02

    judge.executor.observers.insert(0, lift)
    attempt = judge.perform(0, RIGHT)
    assert attempt.result == "side effect"
    assert "car 1 was 2" in attempt.reason
    # It is left so, and reported once.
    assert judge.perform(0, RIGHT).agrees


def test_an_action_that_is_not_performed_has_no_way():
    judge = set_up(draw((4, 2, 2), [], [(2, 1, 1, 0)]), Setup())
    attempt = judge.perform(0, Action.LIFT)
    assert (attempt.performed, attempt.way_m, attempt.way_lean_rad) == (False, 0.0, 0.0)


@pytest.mark.parametrize(("axis", "shift_m"), [(1, 0.15), (0, -0.15), (0, 0.9)])
def test_a_car_that_leaves_its_way_for_a_moment_is_found(axis, shift_m):
    judge = set_up(draw((6, 3, 2), [], [(0, 1, 1, 0)]), Setup())
    place = judge.physics.cars[0].base.qpos + axis
    moments = iter(range(10**6))

    def shove(world):
        moment = next(moments)
        if moment == 10:
            world.data.qpos[place] += shift_m
        elif moment == 11:
            world.data.qpos[place] -= shift_m

    judge.executor.observers.insert(0, shove)
    attempt = judge.perform(0, RIGHT)
    assert attempt.result == "failed"
    assert "off its way (allowed 51.25)" in attempt.reason


def test_perform_keeps_its_judge_so_that_creep_adds_up():
    physics = craftsim.PhysicsWorld(draw((5, 1, 2), [(Kind.BLOCK, (3, 0, 1))], [(0, 0, 1, 0)]))
    reasons = []
    for _ in range(6):
        physics.data.qpos[physics.blocks[0].qpos] += 0.0003
        reasons.append(craftsim.perform(physics, 0, "ROTATE_LEFT").reason)
    assert reasons[:4] == [""] * 4
    assert any("away from where it was left" in reason for reason in reasons[4:])
    physics.reset()
    assert craftsim.perform(physics, 0, "ROTATE_LEFT").agrees


def test_perform_goes_on_from_what_others_have_done_meanwhile():
    physics = craftsim.PhysicsWorld(draw((5, 2, 2), [], [(0, 0, 1, 0), (0, 1, 1, 0)]))
    assert craftsim.perform(physics, 0, RIGHT).agrees
    craftsim.Executor(physics).run({1: RIGHT})
    assert craftsim.perform(physics, 0, "ROTATE_LEFT").agrees
    assert craftsim.perform(physics, 1, "ROTATE_LEFT").agrees
    for car in physics.cars:
        physics.data.qpos[car.base.qpos] += PITCH_M
        attempt = craftsim.perform(physics, 0, "ROTATE_LEFT")
        assert attempt.agrees, attempt.reason
    physics.data.qpos[physics.cars[1].base.qpos] += 0.003
    assert "car 1 was 3" in craftsim.perform(physics, 0, "ROTATE_LEFT").reason


def test_perform_goes_on_after_an_interrupt():
    physics = craftsim.PhysicsWorld(draw((5, 2, 2), [], [(0, 0, 1, 0), (0, 1, 1, 0)]))
    assert craftsim.perform(physics, 1, RIGHT).agrees

    def interrupt(world):
        raise KeyboardInterrupt

    physics.judge.judge.executor.observers.append(interrupt)
    with pytest.raises(KeyboardInterrupt):
        craftsim.perform(physics, 0, "ROTATE_LEFT")
    attempt = craftsim.perform(physics, 1, RIGHT)
    assert (attempt.car, attempt.action, attempt.result) == (1, "MOVE_RIGHT", "as predicted")


def test_a_world_that_has_a_judge_can_be_copied():
    physics = craftsim.PhysicsWorld(draw((3, 1, 2), [], [(0, 0, 1, 0)]))
    craftsim.perform(physics, 0, RIGHT)
    copies = copy.copy(physics), copy.deepcopy(physics), pickle.loads(pickle.dumps(physics))
    for other in copies:
        assert other.judge is None
        assert craftsim.perform(other, 0, RIGHT).read == "2,0,1 +x"
    assert craftsim.perform(physics, 0, "MOVE_LEFT").read == "0,0,1 +x"


def test_a_second_try_is_counted_apart():
    judge = set_up(draw((4, 1, 2), [], [(0, 0, 1, 0)]), Setup())
    executor = judge.executor
    advance = executor.advance

    def retried():
        ended = advance()
        return {car: replace(outcome, tries=2) for car, outcome in ended.items()}

    executor.advance = retried
    attempt = judge.perform(0, RIGHT)
    assert (attempt.result, attempt.agrees, attempt.tries) == ("as predicted, retried", True, 2)
