"""A Judge predicts, performs, reads and judges each action, and overlooks neither turns, leans, nor what adds up."""

import gc
import math
import weakref
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from discrete.drawn import draw
from skills.disturbances import push, twist

from craftsim.checking.attempt import Verdict
from craftsim.checking.judge import Judge
from craftsim.checking.recipe import perform
from craftsim.checking.setup import Setup, set_up, setup_of
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.models.config import SimulationConfig
from craftsim.models.randomization import NONE
from craftsim.models.sensing import SensorNoise
from craftsim.models.world import PhysicsWorld
from craftsim.skills.outcome import Reason

SIZE = (4, 1, 2)
RIGHT = Action.MOVE_RIGHT
WHEELS = setup_of("none", drive="wheels")


def _judge(
    *, block_at: int | None = None, load: Kind = Kind.AIR, setup: Setup | None = None
) -> Judge:
    """Return a corridor with a car in each of its end cells; the first may carry something."""
    objects = [] if block_at is None else [(Kind.BLOCK, (block_at, 0, 1))]
    return set_up(draw(SIZE, objects, [(0, 0, 1, 0, load), (3, 0, 1, 2)]), setup or WHEELS)


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


def test_a_skill_that_fails_where_its_part_is_as_predicted_and_another_is_not_says_why():
    judge = _queue()
    begin, advance = judge.executor.begin, judge.executor.advance

    def begin_one(car, action, terrain):
        begin(car, Action.STOP if car == 2 else action, terrain)

    def advance_with_a_failure():
        outcomes = advance()
        if 1 in outcomes:
            outcomes[1] = replace(outcomes[1], reason=Reason.MISALIGNED, detail="3 mm off")
        return outcomes

    judge.executor.begin, judge.executor.advance = begin_one, advance_with_a_failure
    failed, elsewhere = judge.perform_tick([(1, Action.ROTATE_LEFT), (2, Action.ROTATE_LEFT)])
    assert failed.differences == ("misaligned: 3 mm off",)
    assert "misaligned: 3 mm off" in failed.reason
    assert elsewhere.differences[0].startswith("car 2: predicted")


def test_what_does_not_come_to_rest_is_unsettled_and_says_how_fast_it_is():
    judge = _judge()
    judge._drift.speed_m_s = lambda: 0.02
    attempt = judge.perform(0, RIGHT)
    assert (attempt.finding, attempt.agrees) == ("unsettled", False)
    assert attempt.differences == ("something still moves with 20 mm/s",)


def test_a_simulation_that_breaks_down_is_diverged():
    judge = _judge()

    def break_down(_):
        judge.physics.data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number += 1

    judge.executor.observers.append(break_down)
    attempt = judge.perform(0, RIGHT)
    assert (attempt.finding, attempt.result) == ("diverged", Verdict.NUMERICS)
    assert attempt.differences == ("the simulation broke down and started over",)


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
    return set_up(draw((4, 2, 2), [(Kind.BLOCK, (2, 0, 1))], cars), WHEELS)


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
    judge = set_up(grid, WHEELS)
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
    assert (attempt.finding, attempt.result) == ("numerics", Verdict.NUMERICS)
    assert attempt.reason.startswith("the solver did not converge in ")


def test_a_force_that_nothing_could_have_produced_is_numerics_and_not_unsafe():
    judge = _judge(block_at=2)
    physics, (block,) = judge.physics, judge.physics.blocks
    judge.executor.observers.append(
        lambda _: physics.data.xfrc_applied.__setitem__((block.body, 2), -3e4)
    )
    attempt = judge.perform(0, RIGHT)
    assert (attempt.finding, attempt.result) == ("numerics", Verdict.NUMERICS)
    assert "more than weights, motors and motion could" in attempt.reason
    assert attempt.capped_steps == 0


def test_python_performs_one_action_after_the_other_as_a_judge_does():
    judge = _judge(setup=Setup())
    physics = PhysicsWorld(judge.grid)
    assert perform(physics, 0, "MOVE_RIGHT") == judge.perform(0, RIGHT)
    second = perform(physics, 0, RIGHT)
    assert (second.agrees, second.read) == (True, "2,0,1 +x")
    for car, action, message in (
        (2, "LIFT", "there is no car 2"),
        (0, "LFIT", "did you mean 'LIFT'"),
    ):
        with pytest.raises(InputError, match=message):
            perform(physics, car, action)
    with pytest.raises(InputError, match="on a PhysicsWorld, not on a Grid"):
        perform(judge.grid, 0, RIGHT)


LEFT = Action.ROTATE_LEFT


def _beside(objects=(), cars=((0, 0, 1, 0),), size=(5, 1, 2), setup=None):
    return set_up(draw(size, objects, cars), setup or WHEELS)


def _bump(begin_s, length_s, *most):
    """Return a way that leads to a turn and back, within a time, and then lets go."""

    def way(time_s):
        share = (time_s - begin_s) / length_s
        return (
            None
            if share > 1
            else [math.sin(math.pi * max(share, 0.0)) ** 2 * value for value in most]
        )

    return way


def _ramp(begin_s, length_s, *most):
    """Return a way that leads to a turn, holds it for as long, and lets go."""

    def way(time_s):
        share = (time_s - begin_s) / length_s
        return None if share > 2 else [max(0.0, min(share, 1.0)) * value for value in most]

    return way


def test_a_block_that_is_set_down_turned_by_five_degrees_is_not_as_predicted():
    judge = _beside(cars=[(1, 0, 1, 0, Kind.BLOCK)])
    physics, (block,) = judge.physics, judge.physics.blocks
    stands_s = []

    def way(time_s):
        # From when it stands on its feet and the boss is out of its pocket.
        if not stands_s and physics.data.qpos[physics.cars[0].board.qpos] > 0.02:
            return None
        stands_s.append(time_s)
        return _ramp(stands_s[0], 0.1, 0, 0, math.radians(5))(time_s)

    twist(judge.executor, block, way)
    attempt = judge.perform(0, Action.DROP)
    assert (attempt.finding, attempt.result) == ("agrees", Verdict.FAILED)
    assert attempt.placed_error_m < 0.001
    assert attempt.thing_heading_rad == pytest.approx(math.radians(5), abs=0.02)
    assert attempt.reason.startswith("the thing is turned by ")


def test_a_bystander_that_is_twisted_by_six_degrees_is_a_side_effect():
    judge = _beside([(Kind.BLOCK, (3, 0, 1))])
    start_s = judge.physics.time_s
    twist(judge.executor, judge.physics.blocks[0], _ramp(start_s, 0.3, 0, 0, math.radians(6)))
    attempt = judge.perform(0, LEFT)
    assert (attempt.finding, attempt.result) == ("agrees", Verdict.SIDE_EFFECT)
    assert attempt.bystander_displacement_m < 0.001
    assert attempt.bystander_turn_rad == pytest.approx(math.radians(6), abs=0.02)
    assert attempt.reason.startswith("block 0 was turned by ")


def test_a_bystander_car_that_is_tipped_and_stands_again_is_a_side_effect():
    judge = _beside(cars=[(0, 0, 1, 0), (3, 0, 1, 0)])
    base = judge.physics.cars[1].base
    twist(judge.executor, base, _bump(judge.physics.time_s, 1.2, 0, -math.radians(16), 0))
    attempt = judge.perform(0, LEFT)
    assert (attempt.finding, attempt.result) == ("agrees", Verdict.SIDE_EFFECT)
    assert attempt.bystander_turn_rad < 0.003
    assert attempt.drift_rad == pytest.approx(math.radians(16), abs=0.06)
    assert "car 1 was turned " in attempt.reason


def test_what_is_pressed_harder_than_weights_and_motors_can_is_unsafe():
    """A car of 101 N is pressed down with 400 N more: 502 N."""
    judge = _beside(cars=[(0, 0, 1, 0), (3, 0, 1, 0)])
    physics, base = judge.physics, judge.physics.cars[1].base
    judge.executor.observers.append(
        lambda _: physics.data.xfrc_applied.__setitem__((base.body, 2), -400.0)
    )
    attempt = judge.perform(0, LEFT)
    assert 461 < attempt.peak_force_n < 627
    assert attempt.result == Verdict.UNSAFE
    assert attempt.reason.startswith("ground and car 1 hit each other (")
    assert "N, allowed 461)" in attempt.reason


def test_many_small_movements_add_up_and_are_held_against_one_action():
    """A block creeps by half a millimetre with each action, which is allowed once and twice."""
    judge = _beside([(Kind.BLOCK, (2, 0, 1))])
    attempts = []
    for _ in range(5):
        judge.executor.observers.append(push(0, 0.0003))
        attempts.append(judge.perform(0, LEFT))
    assert max(attempt.bystander_displacement_m for attempt in attempts) < 0.001
    results = [str(attempt.result) for attempt in attempts]
    wrong = attempts[results.index("side effect")]
    assert 0 < results.index("side effect") < 4
    assert (
        wrong.reason
        == f"block 0 was {1e3 * wrong.drift_m:.2f} mm away from where it was left (allowed 1.25)"
    )


def test_a_bystander_may_not_come_too_near_to_its_neighbour_however_little_it_was_moved():
    """A block that was set down 0.8 mm off, as is allowed, is moved by half a millimetre later, as is allowed too."""
    judge = _beside(cars=[(0, 0, 1, 0), (3, 0, 1, 0, Kind.BLOCK)], setup=Setup())
    judge.executor.observers.append(push(0, 0.0008))
    dropped = judge.perform(1, Action.DROP)
    assert dropped.agrees
    judge.executor.observers.append(push(0, 0.0004))
    attempt = judge.perform(0, LEFT)
    assert attempt.bystander_displacement_m < 0.001
    assert attempt.result == Verdict.SIDE_EFFECT
    assert attempt.reason == (
        f"block 0 is {1e3 * attempt.bystander_reach_m:.2f} mm too near to a neighbouring cell (allowed 1.25)"
    )
    assert judge.perform(0, LEFT).agrees, "it is held against one action alone"


def test_a_failure_names_its_limit_and_no_contact_of_another_car():
    """Both cars are localised 9 mrad off: one turns by so much less or more, the other lifts its block as it should."""
    biased = replace(NONE, sensors=SensorNoise(heading_bias_rad=0.009))
    cars = [(0, 0, 1, 0), (3, 0, 1, 0)]
    judge = _beside([(Kind.BLOCK, (3, 0, 1))], cars, setup=replace(WHEELS, randomization=biased))
    turns, lifts = judge.perform_tick([(0, LEFT), (1, Action.LIFT)])
    assert lifts.agrees
    assert turns.heading_error_rad > 0.00775
    assert (
        turns.reason
        == f"the car is turned by {1e3 * turns.heading_error_rad:.2f} mrad (allowed 7.75)"
    )


def test_on_an_uneven_floor_a_failure_says_how_far_the_car_was_from_its_path():
    judge = _beside(setup=setup_of("lab_floor", drive="wheels"))
    judge.thresholds = replace(judge.thresholds, place_m=1e-9)
    attempt = judge.perform(0, RIGHT)
    assert attempt.reason.startswith("the car is ")
    assert "; the car strayed " in attempt.reason
    assert float(attempt.reason.split("strayed ")[1].split(" mm")[0]) < 10
