"""A Judge predicts, performs, reads and judges each action, and says when any of these went apart."""

import gc
import weakref

import numpy as np
import pytest
from disturbances import push
from drawn import draw

from craftsim.checking.attempt import Verdict
from craftsim.checking.episode import perform
from craftsim.checking.judge import Judge
from craftsim.checking.setup import Setup, set_up, setup_of
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.models.config import SimulationConfig
from craftsim.models.world import PhysicsWorld
from craftsim.skills.outcome import Reason

SIZE = (4, 1, 2)
RIGHT = Action.MOVE_RIGHT
REDUCED = setup_of("none", drive="reduced")


def _judge(*, block_at: int | None = None, load: Kind = Kind.AIR, setup: Setup | None = None) -> Judge:
    """Return a corridor with a car in each of its end cells; the first may carry something."""
    objects = [] if block_at is None else [(Kind.BLOCK, (block_at, 0, 1))]
    return set_up(draw(SIZE, objects, [(0, 0, 1, 0, load), (3, 0, 1, 2)]), setup or REDUCED)


def test_the_judge_does_not_believe_the_skill():
    judge = _judge()
    begin, began_s = judge.executor.begin, judge.physics.time_s
    judge.executor.begin = lambda car, action, terrain: begin(car, Action.STOP, terrain)
    attempt = judge.perform(0, RIGHT)
    assert (attempt.legal, attempt.predicted, attempt.read) == (True, "1,0,1 +x", "0,0,1 +x")
    assert attempt.start_s == pytest.approx(began_s)
    assert attempt.skill == "succeeded"
    assert attempt.finding == "not executed"
    assert attempt.differences == ("car 0: predicted 1,0,1 +x, read 0,0,1 +x",)
    assert not attempt.agrees


def test_a_bystander_that_moves_too_far_disagrees_though_the_grid_that_is_read_is_the_predicted_one():
    judge = _judge(block_at=2)
    judge.executor.observers.append(push(0, 0.004))
    attempt = judge.perform(0, RIGHT)
    assert 0.001 < attempt.bystander_displacement_m < 0.025
    assert attempt.finding == "agrees"
    assert (attempt.result, attempt.agrees) == ("side effect", False)
    assert attempt.reason.startswith("block 0 was moved by")


def test_what_a_car_carries_is_no_bystander_and_what_it_drops_is_measured():
    judge = _judge(load=Kind.BLOCK)
    moved = judge.perform(0, RIGHT)
    assert moved.bystander_displacement_m < 1e-3
    dropped = judge.perform(0, Action.DROP)
    assert dropped.placed_error_m == pytest.approx(judge.reading.objects[0].offset_m)
    assert judge.grid.kind[1, 0, 1] == Kind.BLOCK


def _queue() -> Judge:
    """Return three cars in a row, the first under a block at the row's end."""
    cars = [(2, 0, 1, 0), (1, 0, 1, 0), (0, 0, 1, 0)]
    return set_up(draw((4, 2, 2), [(Kind.BLOCK, (2, 0, 1))], cars), REDUCED)


def test_cars_that_follow_each_other_all_move_in_one_tick_and_later_ticks_start_from_the_reading():
    judge = _queue()
    predicted, _ = judge.rules.tick(judge.grid, [(0, RIGHT), (1, RIGHT), (2, RIGHT)])
    began_s = judge.physics.time_s
    attempts = judge.perform_tick([(0, RIGHT), (1, RIGHT), (2, RIGHT)])
    assert [(a.car, a.agrees) for a in attempts] == [(0, True), (1, True), (2, True)]
    assert judge.grid.same_visible(predicted)
    took_s = judge.physics.time_s - began_s
    assert took_s > max(a.duration_s for a in attempts), "cars wait for each other"
    assert judge.perform(1, Action.LIFT).agrees, "car 1 is under the block now"


def test_what_the_rules_forbid_in_the_given_order_is_not_performed():
    judge = _queue()
    attempts = judge.perform_tick([(2, RIGHT), (1, RIGHT), (0, RIGHT)])
    assert [(a.car, a.legal, a.performed, a.agrees) for a in attempts] == [
        (2, False, False, False),
        (1, False, False, False),
        (0, True, True, True),
    ]
    np.testing.assert_array_equal(judge.grid.cars[:, 0], [3, 1, 0])


def test_a_side_effect_that_is_nobodys_is_held_against_all():
    judge = _queue()
    judge.executor.observers.append(push(0, 0.06))
    attempts = judge.perform_tick([(1, Action.ROTATE_LEFT), (2, Action.ROTATE_LEFT)])
    assert [a.agrees for a in attempts] == [False, False]
    assert all("block 0 was moved by" in a.reason for a in attempts)


def test_what_turns_unsafe_ends_at_once_with_all_motors_stopped():
    """A car drives off a block, which the rules forbid: it tips long before it is where it was to go."""
    grid = draw((3, 1, 3), [(Kind.BLOCK, (0, 0, 1))], [(0, 0, 2, 0), (2, 0, 1, 0)])
    judge = set_up(grid, REDUCED)
    physics = judge.physics
    goal = grid.copy()
    goal.cars[0, 0] = 1
    attempt = judge.perform(0, RIGHT, intended=goal)
    assert (attempt.finding, attempt.result) == ("unsafe", "unsafe")
    assert attempt.skill.startswith(Reason.STOPPED)
    assert attempt.duration_s == pytest.approx(physics.time_s - physics.config.settle_s)
    assert 0.33 < judge.log.tilt_rad < 0.6 or 0.45 < judge.log.fall_m_s < 0.9
    assert not physics.data.ctrl.any()
    assert not judge.executor.busy


def test_a_world_that_nobody_uses_is_gone_at_once():
    """Python's garbage collector does not see MuJoCo's memory; a worker whose worlds wait for it grows without end."""
    gc.disable()
    try:
        judge = _judge(setup=setup_of("strong"))
        judge.perform(0, RIGHT)
        physics = weakref.ref(judge.physics)
        del judge
        assert physics() is None
    finally:
        gc.enable()


def test_what_fails_while_the_solver_gives_up_is_numerics_and_counted():
    judge = _judge(setup=Setup(simulation=SimulationConfig(solver_iterations=5)))
    begin = judge.executor.begin
    judge.executor.begin = lambda car, action, terrain: begin(car, Action.ROTATE_LEFT, terrain)
    attempt = judge.perform(0, RIGHT)
    assert attempt.capped_steps > 0
    assert (attempt.finding, attempt.result) == ("numerics", Verdict.SOLVER)
    assert attempt.reason.startswith("the solver did not converge in ")


def test_a_force_that_nothing_could_have_produced_is_numerics_and_not_unsafe():
    judge = _judge(block_at=2)
    physics, (block,) = judge.physics, judge.physics.blocks
    judge.executor.observers.append(lambda _: physics.data.xfrc_applied.__setitem__((block.body, 2), -3e4))
    attempt = judge.perform(0, RIGHT)
    assert (attempt.finding, attempt.result) == ("numerics", Verdict.SOLVER)
    assert "more than weights, motors and motion could" in attempt.reason
    assert attempt.capped_steps == 0


def test_python_performs_one_action_after_the_other_as_a_judge_does():
    judge = _judge(setup=Setup())
    physics = PhysicsWorld(judge.grid)
    assert perform(physics, 0, "MOVE_RIGHT") == judge.perform(0, RIGHT)
    second = perform(physics, 0, RIGHT)
    assert (second.agrees, second.read) == (True, "2,0,1 +x")
    for car, action, message in ((2, "LIFT", "there is no car 2"), (0, "LFIT", "did you mean 'LIFT'")):
        with pytest.raises(InputError, match=message):
            perform(physics, car, action)
