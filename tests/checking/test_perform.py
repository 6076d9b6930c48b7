"""``craftsim.perform``: one action on a PhysicsWorld, judged as everywhere, and the PhysicsWorld goes on from there."""

import pytest
from disturbances import pushed
from drawn import draw

from craftsim.checking import setup
from craftsim.checking.attempt import Thresholds
from craftsim.checking.episode import perform
from craftsim.checking.setup import Setup, set_up
from craftsim.discrete.grid import Kind
from craftsim.discrete.kinds import Action
from craftsim.errors import InputError
from craftsim.models.world import PhysicsWorld

GRID = draw((4, 2, 2), [(Kind.BLOCK, (3, 1, 1))], [(0, 0, 1, 0)])


def test_calls_follow_each_other_and_are_the_attempts_of_a_world_that_was_set_up():
    physics, judge = PhysicsWorld(GRID), set_up(GRID, Setup())
    assert perform(physics, 0, "MOVE_RIGHT") == judge.perform(0, Action.MOVE_RIGHT)
    second = perform(physics, 0, Action.MOVE_RIGHT)
    assert second.agrees
    assert second.read == "2,0,1 +x"


def test_a_bystander_that_moves_too_far_disagrees_though_the_reading_is_as_predicted(monkeypatch):
    monkeypatch.setattr(setup, "Executor", pushed(0, 0.004))
    attempt = perform(PhysicsWorld(GRID), 0, Action.MOVE_RIGHT)
    assert 0.001 < attempt.bystander_displacement_m < 0.025
    assert (attempt.finding, attempt.result, attempt.agrees) == ("agrees", "side effect", False)


def test_a_car_beyond_its_limit_disagrees_though_the_reading_is_as_predicted():
    attempt = perform(PhysicsWorld(GRID), 0, Action.MOVE_RIGHT, thresholds=Thresholds(car_m=1e-9))
    assert (attempt.finding, attempt.result, attempt.agrees) == ("agrees", "failed", False)


def test_what_the_rules_forbid_is_not_performed():
    physics = PhysicsWorld(GRID)
    before = physics.data.qpos.copy()
    attempt = perform(physics, 0, Action.MOVE_LEFT)
    assert (attempt.legal, attempt.performed) == (False, False)
    assert (physics.data.qpos == before).all()


@pytest.mark.parametrize(
    ("car", "action", "message"), [(1, "LIFT", "there is no car 1"), (0, "LFIT", "did you mean 'LIFT'")]
)
def test_wrong_arguments_are_refused(car, action, message):
    with pytest.raises(InputError, match=message):
        perform(PhysicsWorld(GRID), car, action)
