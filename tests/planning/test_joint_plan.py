"""A plan under way is what the rules make of it; and its neighbours."""

import numpy as np
import pytest

from craftsim.discrete.grid import Kind, Piece
from craftsim.discrete.kinds import Action
from craftsim.discrete.move_graph import MoveGraphs
from craftsim.discrete.rules import Rules
from craftsim.planning import plan_building
from craftsim.planning.assembly import Assembly, Placing, without_things
from craftsim.planning.joint_plan import JointPlan, Turn
from craftsim.planning.planner import vary
from craftsim.tasks import make_task

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
    assert assembly.possible(frozenset({low}), Placing(low, removes=True))
    assert not assembly.possible(frozenset({low, high}), Placing(low, removes=True))
    assert not assembly.possible(frozenset({high}), Placing(low))


BLOCKS = tuple(Piece(Kind.BLOCK, (x, 0, 1)) for x in range(5))
TURNS = [Turn(x % 2, BLOCKS[x], Piece(Kind.BLOCK, (x, 3, 1)), x) for x in range(4)]


def neighbours(n=300, critical=()):
    return [vary(TURNS, critical, BLOCKS, 2, np.random.default_rng(seed)) for seed in range(n)]


def test_a_neighbour_keeps_the_beginning_and_brings_things_to_places_of_the_plan():
    found = neighbours()
    for n_kept, others in found:
        assert 0 <= n_kept <= len(TURNS)
        assert others != TURNS[n_kept:] or n_kept == len(TURNS)
        turns = [turn for turn in others if turn]
        assert {turn.target for turn in turns} <= {turn.target for turn in TURNS}
        assert len({turn.source for turn in turns}) == len(turns)
    # What nobody used may be used.
    assert any(turn.source == BLOCKS[4] for _, others in found for turn in others if turn)


def test_what_the_makespan_depends_on_changes_more_often():
    first = [kept == 0 for kept, _ in neighbours(critical=(0,))]
    assert np.mean(first) > np.mean([kept == 0 for kept, _ in neighbours(critical=(3,))]) + 0.2


def test_a_search_around_plans_finds_what_the_shipped_barrier_plan_takes():
    task = make_task("breaking_barrier")
    planned = plan_building(task.draw(np.random.default_rng(0)), task, RULES, rounds=150, time_s=60)
    assert planned.makespan_s < 15.76
    acts = planned.schedule.critical()
    steps = [i for i, step in enumerate(planned.schedule.steps) if (step.tick, step.car) in acts]
    times = planned.schedule.times()[steps]
    assert (times[:, 1] - times[:, 0]).sum() == pytest.approx(planned.makespan_s)
