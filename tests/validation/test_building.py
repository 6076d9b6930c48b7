"""The shipped plans build the paper's six tasks: on the grid under both rule sets, and in physics in any order."""

import shutil
from dataclasses import replace
from functools import cache
from itertools import pairwise, permutations

import numpy as np
import pytest

from craftsim.checking.recipe import unwatched
from craftsim.checking.setup import setup_of
from craftsim.discrete.grid import CarField, Grid, Kind
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import make_schedule
from craftsim.errors import InputError
from craftsim.planning.plan_file import Plan
from craftsim.tasks import TASK_NAMES, Task, as_task
from craftsim.validation.rollout import planned_task, run_plan

RULE_SETS = ("published", "physical")
COMPLEX = "complex_two_story"
read = cache(planned_task)


def _start(task: Task) -> Grid:
    return task.draw(np.random.default_rng(0))


def _grids(task: Task, plan: Plan, rules: Rules) -> list[Grid]:
    """Return the world before each tick and the last one; every action must be legal when its turn comes."""
    grids = [_start(task)]
    for tick, joint in enumerate(plan.ticks):
        after, applied = rules.tick(grids[-1], joint)
        assert applied.all(), f"tick {tick}: {joint}, applied {applied}"
        grids.append(after)
    return grids


@pytest.mark.parametrize("rule_set", RULE_SETS)
@pytest.mark.parametrize("name", TASK_NAMES)
def test_every_action_is_legal_and_the_goal_is_reached_with_nothing_left_in_the_air(name, rule_set):
    task, plan = read(name)
    assert not task.succeeded(_start(task))
    last = _grids(task, plan, Rules(rule_set))[-1]
    assert task.succeeded(last)
    assert (last.cars[:, CarField.LOAD] == Kind.AIR).all()


def test_the_actions_of_a_tick_do_not_depend_on_their_order():
    for name in TASK_NAMES:
        task, plan = read(name)
        rules = Rules("physical")
        grids = _grids(task, plan, rules)
        for tick, joint in enumerate(plan.ticks):
            for order in permutations(joint):
                after, applied = rules.tick(grids[tick], order)
                assert applied.all(), f"tick {tick}: {order}"
                assert after.same_visible(grids[tick + 1]), f"tick {tick}: {order}"


@cache
def _built(name, order="sequential", drive="rollers"):
    """Return an episode with the world that it ends in."""
    worlds = []

    def watch(judge):
        worlds.append(judge)
        return unwatched(judge)

    episode = run_plan(*read(name), setup_of("none", drive=drive), 0, order, watch)
    return episode, worlds[0].reading


@pytest.mark.parametrize("name", [name for name in TASK_NAMES if name != "simple_two_story"])
def test_in_physics_every_action_does_what_the_rules_predict_within_the_bands(name):
    """That of the demo is held to more in tests/skills/test_demo_plan.py."""
    episode, reading = _built(name)
    assert episode.n_agree == episode.n_planned
    assert episode.reached is True
    assert episode.succeeded
    assert reading.problems == ()
    assert reading.grid.same_visible(_grids(*read(name), Rules("physical"))[-1])
    for attempt in episode.attempts:
        where = f"tick {attempt.tick}, car {attempt.car} {attempt.action}"
        assert attempt.skill == "succeeded", f"{where}: {attempt.skill}"
        assert attempt.car_error_m <= 1e-3, where
        assert attempt.heading_error_rad <= 3e-3, where
        assert (attempt.placed_error_m or 0.0) <= 2e-3, where
        assert attempt.bystander_displacement_m <= 1e-3, where
    assert max(placed.offset_m for placed in reading.objects) <= 2e-3


def test_many_cars_at_once_build_the_same_world_in_at_most_60_percent_of_the_time():
    (one_by_one, before), (at_once, after) = (
        _built(COMPLEX, order, "wheels") for order in ("sequential", "concurrent")
    )
    assert at_once.succeeded, [a for a in at_once.attempts if not a.agrees]
    assert all(attempt.performed for attempt in at_once.attempts)
    assert after.grid.same_visible(before.grid)
    assert 0.0 < at_once.makespan_s <= 0.60 * one_by_one.makespan_s


@pytest.mark.parametrize("order", ["sequential", "concurrent"])
def test_no_step_starts_before_all_that_it_waits_for_have_ended_and_cars_do_one_thing_at_a_time(
    order,
):
    episode, _ = _built(COMPLEX, order, "wheels")
    schedule = make_schedule(_start(episode.task), episode.ticks, Rules("physical"), order)
    times = [(a.start_s, a.start_s + a.duration_s) for a in episode.attempts]
    assert len(times) == len(schedule.steps)
    for index, step in enumerate(schedule.steps):
        for earlier in step.waits_for:
            assert times[earlier][1] <= times[index][0] + 1e-6
    first = min(start for start, _ in times)
    moments = np.arange(first, first + episode.makespan_s, 0.1)
    busy = [sum(start <= t < end for start, end in times) for t in moments]
    assert max(busy) == (1 if order == "sequential" else 3)
    for car in range(4):
        own = sorted(times[i] for i, step in enumerate(schedule.steps) if step.car == car)
        assert all(end <= start + 1e-6 for (_, end), (start, _) in pairwise(own))


def test_a_task_reaches_its_goal_with_noisy_sensors_and_random_physics():
    episode = run_plan(
        *read("simple_two_story"), setup_of("strong", drive="wheels"), 11, "concurrent"
    )
    assert episode.succeeded, [a for a in episode.attempts if not a.agrees]
    figures = episode.figures
    # Three standard deviations of one localisation.
    assert figures["max_car_error_mm"] < 3.0
    assert figures["max_car_heading_error_mrad"] < 9.0
    assert figures["max_placed_error_mm"] < 5.0


def test_without_noise_the_seed_changes_nothing_but_the_order_does():
    setup = setup_of("none", drive="wheels")
    one, other, slow = (
        run_plan(*read("strip"), setup, *how)
        for how in ((0, "concurrent"), (1, "concurrent"), (0, "sequential"))
    )
    assert one.figures == other.figures
    assert one.makespan_s < slow.makespan_s


def test_a_plan_that_does_not_build_the_goal_does_not_reach_it():
    task, plan = read("strip")
    short = replace(plan, ticks=plan.ticks[:1])
    episode = run_plan(task, short, setup_of("none", drive="wheels"), 0, "concurrent")
    assert (episode.reached, episode.succeeded) == (False, False)
    assert episode.n_agree == episode.n_planned


def test_a_task_of_ones_own_has_no_shipped_plan(tmp_path):
    blueprint = as_task("strip").starts[0].path
    own = shutil.copy(blueprint, tmp_path / "own.yaml")
    with pytest.raises(InputError, match=r"no shipped plan for .*own\.yaml; give one with --plan"):
        planned_task(str(own))
