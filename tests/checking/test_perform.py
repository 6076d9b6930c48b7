"""``craftsim.perform``: one action on a PhysicsWorld, judged as everywhere, and the PhysicsWorld goes on from there."""

import pytest
from drawn import draw

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


def test_wrong_arguments_are_refused():
    for car, action, message in ((1, "LIFT", "there is no car 1"), (0, "LFIT", "did you mean 'LIFT'")):
        with pytest.raises(InputError, match=message):
            perform(PhysicsWorld(GRID), car, action)
