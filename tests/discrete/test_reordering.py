"""Conflicting actions change places: before a plan is executed, and on the way with what is known then."""

import numpy as np
import pytest
from discrete.test_schedule import PLENTY, SEEDS, random_plan
from discrete.worldgen import conflict
from hypothesis import given, settings

from craftsim.checking.episode import Recipe, do, run_up, start
from craftsim.checking.setup import Seed, setup_of
from craftsim.discrete.files.blueprint import blueprint_text
from craftsim.discrete.files.plan import read_plan
from craftsim.discrete.files.shipped import shipped_plan
from craftsim.discrete.reordering import reordered, reordered_rest
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.discrete.tasks import make_task
from craftsim.validation.rollout import steps_of

RULES = Rules("physical")


def _shipped(name):
    grid = make_task(name).draw(np.random.default_rng(0))
    return grid, read_plan(shipped_plan(name), grid.n_cars).ticks


def _nominal(plan):
    return {(step.tick, step.car): step.duration_s for step in plan.steps}


def _seconds(plan, by_act):
    return [by_act[step.tick, step.car] for step in plan.steps]


def _simulate(grid, plan, actual_s, reorders=True):
    """Return (step, start, end) in the order in which the steps of a plan begin, and how often their order changes."""
    left, waiting, now, now_s, changes = plan, dict(enumerate(plan.steps)), grid, 0.0, 0
    ended, running, begun = [], {}, []
    while True:
        since = [(step, now_s - began_s) for step, began_s in running.values()]
        new = reordered_rest(now, left, ended, since, RULES) if reorders else left
        if new is not left:
            left, waiting, changes = new, dict([*enumerate(new.steps)][len(running) :]), changes + 1
        number = {(step.tick, step.car): index for index, step in enumerate(left.steps)}
        done = {number.get((step.tick, step.car), -1) for step, _ in ended}
        for index, step in list(waiting.items()):
            if step.waits_for <= done and step.car not in running:
                running[step.car] = waiting.pop(index), now_s
                begun.append((step, now_s, now_s + actual_s[step.tick, step.car]))
        if not running:
            return begun, changes
        now_s = min(began_s + actual_s[step.tick, step.car] for step, began_s in running.values())
        for car, (step, began_s) in list(running.items()):
            if began_s + actual_s[step.tick, step.car] <= now_s:
                del running[car]
                ended.append((step, actual_s[step.tick, step.car]))
                now = RULES.apply(now, car, step.action)


def test_the_best_order_by_given_durations_is_found():
    grid, ticks = _shipped("block")
    plan = make_schedule(grid, ticks, RULES)
    better = reordered(grid, plan, _nominal(plan), RULES)
    assert better.makespan() < 0.9 * plan.makespan()
    assert not better.forbidden
    assert better.final.same_visible(plan.final)
    for car in range(2):
        own = [step.tick for step in better.steps if step.car == car]
        assert own == sorted(own)
    slow = {(step.tick, step.car): 20.0 if step.car else 1.0 for step in plan.steps}
    again = reordered(grid, plan, slow, RULES)
    best = min((plan, better, again), key=lambda one: one.makespan(_seconds(one, slow)))
    assert again.makespan(_seconds(again, slow)) == best.makespan(_seconds(best, slow))


def test_the_order_constraints_of_a_plan_hold():
    grid, ticks = _shipped("block")
    plan = make_schedule(grid, ticks, RULES, after=make_schedule(grid, ticks, RULES).constraints())
    assert plan.after
    assert reordered(grid, plan, _nominal(plan), RULES) is plan


@settings(PLENTY, max_examples=60)
@given(SEEDS)
def test_what_is_left_of_a_plan_is_legal_in_any_order_that_it_gets_and_ends_in_the_same_world(seed):
    rng = np.random.default_rng(seed)
    grid, ticks = random_plan(rng)
    plan = make_schedule(grid, ticks, RULES)
    actual_s = {act: seconds * rng.choice((1.0, 1.0, 6.0)) for act, seconds in _nominal(plan).items()}
    begun, _ = _simulate(grid, plan, actual_s)
    assert sorted((s.tick, s.car) for s, _, _ in begun) == sorted((s.tick, s.car) for s in plan.steps)
    world = grid
    for number, (step, began_s, _) in enumerate(begun):
        assert RULES.legal(world, step.car, step.action)
        world = RULES.apply(world, step.car, step.action)
        running = [other for other, _, end_s in begun[:number] if began_s < end_s - 1e-9]
        assert not any(conflict(step.footprint, other.footprint) for other in running)
    assert world.same_visible(plan.final)


def test_on_the_way_a_late_car_is_overtaken_and_where_all_goes_as_predicted_nothing_changes():
    grid, ticks = _shipped("complex_two_story")
    plan = make_schedule(grid, ticks, RULES)
    best = reordered(grid, plan, _nominal(plan), RULES)
    begun, changes = _simulate(grid, best, _nominal(plan))
    assert (changes, max(end for _, _, end in begun)) == (0, pytest.approx(best.makespan()))
    slow = {act: seconds * (2.0 if act[1] == 1 else 1.0) for act, seconds in _nominal(plan).items()}
    begun, changes = _simulate(grid, best, slow)
    assert changes
    assert max(end for _, _, end in begun) < best.makespan(_seconds(best, slow)) - 1.0


def _episode(name, order, after=None):
    grid, ticks = _shipped(name)
    (step,) = steps_of(ticks, order, after)
    recipe = Recipe(blueprint_text(grid), (step,), setup_of("mild", drive="wheels"), Seed((0,)))
    judge = start(recipe)
    return recipe, judge, do(judge, step)


def _end_s(attempts):
    return max(attempt.start_s + attempt.duration_s for attempt in attempts)


def test_in_physics_a_plan_ends_earlier_as_predicted_and_is_repeated_bit_for_bit():
    recipe, judge, attempts = _episode("block", "reordered")
    assert all(attempt.agrees for attempt in attempts)
    _, _, planned = _episode("block", "concurrent")
    assert [(a.tick, a.car) for a in attempts] == [(a.tick, a.car) for a in planned]
    assert _end_s(attempts) < _end_s(planned) - 1.0
    again = run_up(recipe)
    assert do(again, recipe.steps[0]) == attempts
    np.testing.assert_array_equal(judge.physics.data.qpos, again.physics.data.qpos)


def test_constraints_that_footprints_impose_anyway_do_not_prevent_it_and_others_do():
    grid, ticks = _shipped("block")
    plan = make_schedule(grid, ticks, RULES)
    _, _, free = _episode("block", "reordered")
    _, _, written = _episode("block", "reordered", plan.constraints())
    assert written == free
    last = {step.car: (step.tick, step.car) for step in plan.steps}
    _, _, asked = _episode("block", "reordered", {last[0]: [last[1]]})
    ends = {(a.tick, a.car): a for a in asked}
    assert ends[last[0]].start_s >= ends[last[1]].start_s + ends[last[1]].duration_s


def test_a_plan_that_cannot_be_shortened_is_executed_as_ever():
    _, judge, attempts = _episode("strip", "reordered")
    _, other, planned = _episode("strip", "concurrent")
    assert attempts == planned
    np.testing.assert_array_equal(judge.physics.data.qpos, other.physics.data.qpos)
