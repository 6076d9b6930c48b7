"""A plan under way is what the rules make of it."""

import numpy as np

from craftsim.discrete.grid import Kind, Piece
from craftsim.discrete.kinds import Action
from craftsim.discrete.move_graph import MoveGraphs
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import make_task
from craftsim.planning.assembly import Assembly, Placing, without_things
from craftsim.planning.joint_plan import JointPlan

RULES = Rules("physical")


def start():
    return make_task("strip").draw(np.random.default_rng(0))


def test_the_worlds_are_those_of_the_rules():
    grid = start()
    plan = JointPlan(grid, MoveGraphs(RULES))
    rng = np.random.default_rng(1)
    for tick in range(90):
        joint = []
        for car in range(grid.n_cars):
            legal = np.flatnonzero(RULES.mask(grid)[car])
            action = int(rng.choice(legal[legal != Action.STOP]))
            if RULES.tick(grid, [*joint, (car, action)])[1].all():
                joint.append((car, action))
                plan.write(car, tick, [action])
        grid, _ = RULES.tick(grid, joint)
    assert plan.replay(0) is None
    assert plan.grid(90).same_visible(grid)
    assert [len(joint) for joint in plan.ticks()] == [2] * 90


def test_what_is_forbidden_is_found_and_without_a_car_the_others_do_as_before():
    plan = JointPlan(start(), MoveGraphs(RULES))
    plan.write(1, 0, [Action.MOVE_RIGHT, Action.LIFT])
    others = plan.without(0, 0)
    assert (others.cars[2, 1] == plan.grid(2).cars[1]).all()
    assert (others.cars[2, 0, :3] < 0).all()
    plan.write(0, 0, [Action.MOVE_RIGHT, Action.DROP])
    assert plan.replay(0) == 1


def test_what_bears_something_is_not_taken():
    low, high = Piece(Kind.BLOCK, (1, 1, 1)), Piece(Kind.BLOCK, (1, 1, 2))
    assembly = Assembly(without_things(start()), RULES)
    assert assembly.possible(frozenset({low}), Placing(low, taken=True))
    assert not assembly.possible(frozenset({low, high}), Placing(low, taken=True))
    assert not assembly.possible(frozenset({high}), Placing(low))
