"""Many cars at once in physics: the same end as one by one, sooner; and what happens when a car fails."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from craftsim.checking.scheduled_run import ScheduledRun, run_schedule
from craftsim.validation.jobs.job import read_job

from craftsim.discrete.actions import Action
from craftsim.discrete.grid import Grid, Kind
from craftsim.discrete.rules import Rules
from craftsim.discrete.schedule import Schedule, make_schedule
from craftsim.models.site import Site
from craftsim.skills.executor import Executor
from craftsim.skills.outcome import Reason

RULES = Rules("physical")
RIGHT, FORWARD = Action.MOVE_RIGHT, Action.MOVE_FORWARD


@cache
def _built(order) -> tuple[Schedule, ScheduledRun]:
    """Return the complex two-story building, built by four cars."""
    job = read_job("complex_two_story")
    schedule = make_schedule(job.drawing.grid(np.random.default_rng(0)), job.plan.ticks, RULES, order)
    return schedule, run_schedule(Executor(job.site(0)), schedule)


@pytest.mark.parametrize("order", ["sequential", "concurrent"])
def test_the_complex_building_is_built_in_either_order(order):
    schedule, run = _built(order)
    assert run.agrees, [r for r in run.records if not r.outcome.succeeded or not r.in_place]
    assert run.not_run == ()
    assert run.final.grid.same_visible(schedule.final)
    assert read_job("complex_two_story").succeeded(run.final.grid)
    assert sorted(record.index for record in run.records) == list(range(len(schedule.steps)))


def test_many_cars_at_once_take_at_most_60_percent_of_the_time_for_the_same_world():
    one_by_one, at_once = _built("sequential")[1], _built("concurrent")[1]
    assert at_once.final.grid.same_visible(one_by_one.final.grid)
    assert at_once.makespan_s <= 0.60 * one_by_one.makespan_s


@pytest.mark.parametrize("order", ["sequential", "concurrent"])
def test_no_step_starts_before_all_that_it_waits_for_have_ended_and_cars_do_one_thing_at_a_time(order):
    schedule, run = _built(order)
    times = {record.index: record for record in run.records}
    for index, step in enumerate(schedule.steps):
        for earlier in step.waits_for:
            assert times[earlier].end_s <= times[index].start_s + 1e-9
    busy = [sum(r.start_s <= t < r.end_s for r in run.records) for t in np.arange(0.0, run.makespan_s, 0.1)]
    assert max(busy) == (1 if order == "sequential" else 3)
    for car in range(4):
        own = sorted((r.start_s, r.end_s) for r in run.records if schedule.steps[r.index].car == car)
        assert all(end <= start + 1e-9 for (_, end), (start, _) in pairwise(own))


def _yard() -> Grid:
    """Return a yard in which car 0 makes way for car 1, and car 2 carries a block about far away."""
    grid = Grid.empty((5, 4, 2), 3)
    grid.cars[:, :4] = [(1, 0, 1, 0), (0, 0, 1, 0), (1, 3, 1, 0)]
    grid.kind[1, 3, 1] = Kind.BLOCK
    grid.derive_marks()
    return grid


PLAN = [
    [(0, RIGHT), (1, RIGHT), (2, Action.LIFT)],
    [(0, RIGHT), (1, Action.ROTATE_LEFT), (2, RIGHT)],
    [(2, Action.DROP)],
]
STEPS_OF = {0: [0, 3], 1: [1, 4], 2: [2, 5, 6]}


def _run(disable=lambda site: None, order="concurrent") -> tuple[Site, Schedule, ScheduledRun]:
    grid = _yard()
    site = Site(grid)
    disable(site)
    schedule = make_schedule(grid, PLAN, RULES, order)
    assert [step.car for step in schedule.steps] == [0, 1, 2, 0, 1, 2, 2]
    return site, schedule, run_schedule(Executor(site), schedule)


def _unpower(car):
    """Return a fault: the wheel motors of a car give no torque."""

    def fault(site):
        site.model.actuator_forcerange[site.cars[car].wheel_actuators] = 0.0

    return fault


def _polish(car):
    """Return a fault: the rollers of a car and the ground under it have next to no friction."""

    def fault(site):
        own = site.model.geom_bodyid
        of_car = site.model.body_rootid[own] == site.cars[car].base.body
        site.model.geom_friction[of_car] = 1e-4
        site.model.geom_priority[of_car] = 1

    return fault


def test_with_all_cars_sound_everything_runs():
    _, _, run = _run()
    assert run.agrees
    assert len(run.records) == 7


@pytest.mark.parametrize("fault", [_unpower, _polish])
def test_a_car_that_fails_stops_with_all_that_depends_on_it_and_the_others_finish(fault):
    _, schedule, run = _run(fault(0))
    outcomes = {record.index: record for record in run.records}
    assert outcomes[0].outcome.reason in (Reason.BLOCKED, Reason.SLIPPED)
    assert not outcomes[0].in_place
    assert run.not_run == tuple(sorted([1, 3, 4]))
    for index in STEPS_OF[2]:
        assert outcomes[index].outcome.succeeded
        assert outcomes[index].in_place
    assert run.final.problems == ()
    assert run.final.grid.kind[2, 3, 1] == Kind.BLOCK
    assert not run.agrees
    assert not run.verdict.agrees
    start = schedule.steps[0].before
    np.testing.assert_array_equal(run.final.grid.cars[:2], start.cars[:2])


def test_the_failure_of_a_car_that_nobody_waits_for_concerns_nobody_else():
    _, _, run = _run(_unpower(1))
    assert run.not_run == (4,)
    assert {r.index for r in run.records if r.outcome.succeeded and r.in_place} == {0, 2, 3, 5, 6}


def test_one_by_one_a_failure_ends_everything():
    _, _, run = _run(_unpower(0), "sequential")
    assert [record.index for record in run.records] == [0]
    assert run.not_run == (1, 2, 3, 4, 5, 6)


def test_a_step_whose_skill_boasts_is_not_in_place_and_says_what_reads_otherwise():
    grid = _yard()
    schedule = make_schedule(grid, [[(0, RIGHT)]], RULES)
    executor = Executor(Site(grid))
    begin = executor.begin
    executor.begin = lambda car, action, terrain: begin(car, Action.STOP, terrain)
    run = run_schedule(executor, schedule)
    assert run.records[0].outcome.succeeded
    assert not run.records[0].in_place
    assert run.records[0].difference == "car 0: predicted 2,0,1 +x, read 1,0,1 +x"
    assert not run.agrees


def test_two_runs_are_equal_bit_for_bit():
    (one, _, first), (two, _, second) = _run(), _run()
    np.testing.assert_array_equal(one.data.qpos, two.data.qpos)
    np.testing.assert_array_equal(one.data.qvel, two.data.qvel)
    assert first.records == second.records
    assert first.makespan_s == second.makespan_s


def test_an_empty_schedule_takes_no_time_and_agrees():
    grid = _yard()
    site = Site(grid)
    before = site.data.qpos.copy()
    run = run_schedule(Executor(site), make_schedule(grid, [], RULES))
    assert run.agrees
    assert run.makespan_s == 0.0
    np.testing.assert_array_equal(site.data.qpos, before)


def test_the_listener_hears_every_change_of_what_runs():
    grid = _yard()
    heard = []
    run_schedule(
        Executor(Site(grid)),
        make_schedule(grid, [[(0, RIGHT), (1, RIGHT)]], RULES),
        lambda running: heard.append({car: step.action for car, step in running.items()}),
    )
    assert heard == [{0: RIGHT}, {}, {1: RIGHT}, {}]
