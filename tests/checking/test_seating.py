"""A block that was knocked off its seat, or stands beside its cell's middle, is lifted from below its own middle."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from craftsim.checking.recipe import perform_step, start
from craftsim.checking.recovery import loads_to_seat
from craftsim.checking.seating import load_offset
from craftsim.checking.setup import set_up, setup_of
from craftsim.discrete.files.blueprint import blueprint_text, parse_blueprint
from craftsim.discrete.files.design import ANY_YAW, Design
from craftsim.discrete.geometry import CELL_PITCH_M
from craftsim.discrete.grid import CarField, Grid, Kind, Piece
from craftsim.discrete.kinds import Action
from craftsim.discrete.readback import SEAT_TOLERANCE_M, TILT_TOLERANCE_RAD
from craftsim.discrete.schedule import make_schedule
from craftsim.envs import parallel_env
from craftsim.tasks import free_play
from craftsim.validation.replanning import Replanning
from craftsim.validation.rollout import EpisodeJob, run_job

SETUP = setup_of(drive="wheels")
AWAY = (0.06, 0.0, 0.5)
"""Metres and radians by which a hand knocks a load off its seat, so far that it leans on the boss."""


def _grid(size=(3, 1, 1), block=(0, 0, 1), car=(0, 0)):
    grid = Grid.empty(size, n_cars=1)
    grid.kind[block] = Kind.BLOCK
    grid.cars[0, [CarField.X, CarField.Y]] = car
    grid.derive_marks()
    return grid


def _knock(physics):
    x, y, turn = AWAY
    place = physics.blocks[0].qpos
    physics.data.qpos[place : place + 3] += x, y, 0.006
    physics.data.qpos[place + 3 : place + 7] = math.cos(turn / 2), 0, 0, math.sin(turn / 2)


class Hand:
    """Knocks a load that has been driven so far, once."""

    def __init__(self, after_m):
        self.after_m = after_m
        self.done = False

    def __call__(self, physics):
        position, _ = physics.free_body_state(physics.blocks[0])
        way_m = math.hypot(*(position[:2] - 0.5 * CELL_PITCH_M))
        if not self.done and position[2] > 0.02 and way_m > self.after_m:
            self.done = True
            _knock(physics)


@pytest.mark.parametrize("recovers", [False, True])
def test_a_car_that_recovers_is_told_to_which_side_its_load_has_room(monkeypatch, recovers):
    grid = _grid((3, 2, 1), block=(1, 1, 1))
    grid.cars[0, CarField.LOAD] = Kind.BLOCK
    grid.derive_marks()
    judge = set_up(grid, replace(SETUP, recovers=recovers))
    told = []
    monkeypatch.setattr(judge.executor, "begin", lambda car, action, terrain: told.append(terrain))
    (step,) = make_schedule(judge.grid, [[(0, Action.MOVE_RIGHT)]], judge.rules).steps
    judge.begin(step)
    assert [terrain.free_side for terrain in told] == [(0, -1) if recovers else (0, 0)]


@pytest.mark.parametrize("recovers", [False, True])
def test_a_load_off_its_seat_is_lifted_again_from_below_its_middle(recovers):
    judge = set_up(_grid(), replace(SETUP, recovers=recovers))
    judge.perform(0, Action.LIFT)
    _knock(judge.physics)
    for _ in range(20):
        judge.executor.advance()
    judge.look()
    assert judge.reading.objects[0].tilt_rad > TILT_TOLERANCE_RAD
    assert loads_to_seat(judge) == {0: (Action.DROP, Action.LIFT)}
    drop = judge.perform(0, Action.DROP)
    assert loads_to_seat(judge) == {0: (Action.LIFT,)}
    lift = judge.perform(0, Action.LIFT)
    assert not drop.agrees
    assert lift.skill == "succeeded"
    (block,) = judge.reading.objects
    assert block.carrier == 0
    seated = block.offset_m < 1e-3 and abs(block.heading_rad) < 0.01
    assert seated == recovers
    assert bool(judge.problems) != recovers
    assert judge.reading.cars[0].offset_m < 2e-3


def test_what_the_boss_catches_is_lifted_from_the_middle_of_the_cell():
    judge = set_up(_grid(), SETUP)
    assert load_offset(judge.poses, judge.reading, 0) is None
    reading = judge.reading
    for x, beside in ((0.002, None), (0.0111, (0.012, 0.0, 0.0)), (0.09, None)):
        fit = reading.objects[0]._replace(offset_m=x)
        moved = replace(judge.poses, positions=judge.poses.positions + np.array([x, 0, 0]))
        read = replace(reading, objects=(fit,))
        assert load_offset(moved, read, 0) == (beside and pytest.approx(beside))


@pytest.mark.parametrize("execution", ["synchronous", "asynchronous"])
def test_an_episode_goes_on_after_its_load_was_knocked_off_its_seat(execution):
    lane = parse_blueprint(blueprint_text(_grid()), "lane")
    hand = Hand(0.5 * CELL_PITCH_M)
    env = parallel_env(
        free_play("lane", (lane,)),
        drive="wheels",
        execution=execution,
        recovers=True,
        observers=(hand,),
    )
    env.reset(seed=0)
    for action in (Action.LIFT, Action.MOVE_RIGHT, Action.MOVE_RIGHT):
        *_, infos = env.step({"car_0": int(action)})
    backend = env.core.backend
    assert hand.done
    assert (backend.n_seated, infos["car_0"]["problems"]) == (1, ())
    assert backend.judge.reading.objects[0].offset_m < SEAT_TOLERANCE_M
    verbs = [attempt.verb for tick in backend.ticks for attempt in tick]
    assert verbs == ["LIFT", "MOVE", "DROP", "LIFT", "MOVE"]
    again = start(backend.recipe)
    again.executor.observers.append(Hand(0.5 * CELL_PITCH_M))
    for step in backend.recipe.steps:
        perform_step(again, step)
    assert np.array_equal(again.physics.data.qpos, backend.judge.physics.data.qpos)


def test_a_building_goes_on_after_its_load_was_knocked_off_its_seat():
    task = free_play("lane", (parse_blueprint(blueprint_text(_grid()), "lane"),))
    design = Design(Path("goal.yaml"), (Piece(Kind.BLOCK, (2, 0, 1), ANY_YAW),))
    done = run_job(
        EpisodeJob(
            key="one",
            world=replace(task, design=design, success="built"),
            behaviour=Replanning(3, 3),
            seed=0,
            setup=SETUP,
            observers=(Hand(0.5 * CELL_PITCH_M),),
        )
    )
    assert (done.extra["ended"], done.extra["seated"]) == ("built", 1), done.extra
