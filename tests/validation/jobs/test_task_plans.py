"""The shipped plans build the paper's six tasks: on the grid under both rule sets, and in physics."""

from functools import cache
from itertools import permutations

import numpy as np
import pytest
from craftsim.validation.jobs.job import Job, JobResult, read_job, run_job

from craftsim.discrete.actions import Action
from craftsim.discrete.grid import CarField, Grid, Kind, beside
from craftsim.discrete.rules import Rules
from craftsim.discrete.tasks import TASK_NAMES, make_task

RULE_SETS = ("published", "physical")


@cache
def job_of(name: str) -> Job:
    return read_job(name)


def _start(job: Job) -> Grid:
    return job.drawing.grid(np.random.default_rng(0))


def _grids(job: Job, rules: Rules) -> list[Grid]:
    """Return the world before each tick and the last one; every action must be legal when its turn comes."""
    grids = [_start(job)]
    for tick, joint in enumerate(job.plan.ticks):
        after, applied = rules.tick(grids[-1], joint)
        assert applied.all(), f"tick {tick}: {joint}, applied {applied}"
        grids.append(after)
    return grids


@pytest.mark.parametrize("rule_set", RULE_SETS)
@pytest.mark.parametrize("name", TASK_NAMES)
def test_every_action_is_legal_and_the_goal_is_reached_with_nothing_left_in_the_air(name, rule_set):
    job = job_of(name)
    assert not job.succeeded(_start(job))
    last = _grids(job, Rules(rule_set))[-1]
    assert job.succeeded(last)
    assert (last.cars[:, CarField.LOAD] == Kind.AIR).all()


@pytest.mark.parametrize("name", TASK_NAMES)
def test_every_car_works_and_the_plan_fits_into_a_published_episode(name):
    job, task = job_of(name), make_task(name)
    assert {car for joint in job.plan.ticks for car, _ in joint} == set(range(job.drawing.n_cars))
    assert len(job.plan.ticks) <= task.max_steps + 2


@pytest.mark.parametrize("name", TASK_NAMES)
def test_the_actions_of_a_tick_do_not_depend_on_their_order(name):
    job, rules = job_of(name), Rules("physical")
    grids = _grids(job, rules)
    for tick, joint in enumerate(job.plan.ticks):
        for order in permutations(joint):
            after, applied = rules.tick(grids[tick], order)
            assert applied.all(), f"tick {tick}: {order}"
            assert after.same_visible(grids[tick + 1]), f"tick {tick}: {order}"


@pytest.mark.parametrize("name", ["simple_two_story", "complex_two_story"])
def test_no_block_and_no_load_is_near_where_a_flap_comes_down(name):
    job = job_of(name)
    grids = _grids(job, Rules("physical"))
    unfolds = [
        (tick, car)
        for tick, joint in enumerate(job.plan.ticks)
        for car, action in joint
        if action is Action.UNFOLD
    ]
    assert unfolds
    for tick, car in unfolds:
        for grid in grids[tick : tick + 2]:
            x, y, z, yaw = (int(v) for v in grid.cars[car, : CarField.YAW + 1])
            foot = beside((x, y, z), yaw + 2)
            beyond = beside(foot, yaw + 2)
            assert grid.kind[beyond] == Kind.AIR
            for other in grid.cars:
                near = tuple(other[:3]) in (foot, beyond)
                assert not (near and other[CarField.LOAD] != Kind.AIR), f"tick {tick}"


@pytest.fixture(scope="module", params=TASK_NAMES)
def built(request) -> JobResult:
    job = job_of(request.param)
    return run_job(job, job.site(seed=0))


def test_in_physics_every_action_does_what_the_rules_predict(built):
    assert built.agree == built.job.n_actions
    assert built.reached is True
    assert built.good
    assert built.run.final.problems == ()
    assert built.run.final.grid.same_visible(_grids(built.job, Rules("physical"))[-1])


def test_in_physics_every_action_keeps_the_bands(built):
    for record in built.run.records:
        where = f"tick {record.tick}, car {record.car} {record.action.name}"
        assert record.outcome.succeeded, f"{where}: {record.outcome}"
        assert record.car_error_m <= 1e-3, where
        assert abs(record.car_heading_error_rad) <= 3e-3, where
        assert (record.placed_error_m or 0.0) <= 2e-3, where
        assert record.bystander_displacement_m <= 1e-3, where
    assert max(placed.offset_m for placed in built.run.final.objects) <= 2e-3
